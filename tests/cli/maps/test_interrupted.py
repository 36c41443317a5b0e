"""Nothing half is left by a full disk or by Ctrl-C."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from companion.cli import main as cli
from companion.cli.maps import export as convert
from tests.cli.maps.missions import Run, journal_at, tree


def test_a_full_disk(run: Run, mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from half a file and from a traceback: one line, exit code 1, and what was there still is."""
    (tmp_path / "a.ply").write_bytes(b"old")
    before = tree(tmp_path)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(convert, "write", full)
    code, _, errors = run("export", mission, tmp_path / "a.ply", "--overwrite")
    assert (code, errors) == (1, f"{tmp_path / 'a.ply'}: No space left on device; nothing was written there\n")
    assert tree(tmp_path) == before


def test_a_full_disk_while_maps_are_merged(
    run: Run, mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects the same for a merged map: the line names the target, not the temporary folder beside it."""
    other = journal_at(tmp_path / "other.journal", shift=10)
    before = tree(tmp_path)

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    code, _, errors = run("merge", mission, other, "-o", tmp_path / "out.journal")
    assert (code, errors) == (1, f"{tmp_path / 'out.journal'}: No space left on device; nothing was written there\n")
    assert tree(tmp_path) == before


@pytest.mark.parametrize("arguments", [("export", "out.ot"), ("merge", "other.journal", "-o", "out.journal")])
def test_ctrl_c_leaves_nothing_half(mission: Path, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    """Protects the folder: interrupted in the midst of writing, the exit code is 130 and no file is left of it."""
    journal_at(tmp_path / "other.journal", shift=10)
    before = tree(tmp_path)
    command, *rest = arguments
    # Stops for good when some of it is written, and says so: then comes the Ctrl-C.
    program = (
        "import sys, time\n"
        "from companion.cli import main as cli\n"
        "from companion.cli.maps.progress import Progress\n"
        "def stuck(self, share):\n"
        "    if share and self._what.startswith('writing'):\n"
        "        print('writing', flush=True)\n"
        "        time.sleep(60)\n"
        "Progress.__call__ = stuck\n"
        "cli.main(sys.argv[1:])\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, "map", command, str(mission), *rest],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path(cli.__file__).parents[2])},
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "writing\n"
            assert len(list(tmp_path.iterdir())) > 2, "something is being written, or this would show nothing"
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert tree(tmp_path) == before
    assert {path.name for path in tmp_path.iterdir()} == {"mission", "other.journal"}
