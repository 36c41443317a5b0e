"""How far a command is, and what is left when it is broken off."""

from __future__ import annotations

import errno
import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rich.console import Console

from companion.cli import main as cli
from companion.cli.maps import export as convert
from companion.cli.maps import progress as progress_module
from companion.cli.maps.progress import LINE_PERIOD_S, PATIENCE_S, Progress
from tests.cli.maps.conftest import Run, journal_at, tree
from tests.shared.clocks import HandClock


def test_opening_a_large_map_shows_progress(
    mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Protects from silence before the first figure: to open a map every byte of it is read, and that may take long."""
    monkeypatch.setattr(progress_module, "PATIENCE_S", 0.0)
    for source, target in ((mission, "a.ot"), (tmp_path / "a.ot", "b.ot")):
        with pytest.raises(SystemExit):
            cli.main(["map", "export", str(source), str(tmp_path / target)])
        assert f"opening {'map.journal' if source == mission else source.name}: " in capsys.readouterr().err


def test_progress_is_silent_when_it_is_quick_and_has_lines_in_a_log() -> None:
    """Protects logs: nothing for what is over at once, then a line now and then, and no control characters."""
    clock = HandClock()
    log = io.StringIO()
    with Progress("writing a.ply", Console(file=log), clock.now_s) as progress:
        progress(0.1)
        clock.advance(PATIENCE_S)
        progress(0.2)
        clock.advance(0.9 * LINE_PERIOD_S)
        progress(0.5)
        clock.advance(0.1 * LINE_PERIOD_S)
        progress(None)
    assert log.getvalue() == "writing a.ply: 20%\nwriting a.ply: still at it\n"


def test_progress_is_a_bar_on_a_terminal(tmp_path: Path) -> None:
    """Protects the terminal: a bar with the task and its share, which is taken away at the end."""
    clock = HandClock()
    with (tmp_path / "tty").open("w", encoding="utf-8") as terminal:
        console = Console(file=terminal, force_terminal=True, width=80)
        with Progress("writing a.ply", console, clock.now_s) as progress:
            clock.advance(PATIENCE_S)
            progress(0.25)
            progress(0.5)
            time.sleep(0.15)  # the bar draws itself ten times a second, in a thread of rich's own
    shown = (tmp_path / "tty").read_text()
    assert "writing a.ply" in shown
    assert "\x1b[2K" in shown


# Nothing half is left by a full disk or by Ctrl-C.


def test_a_full_disk(run: Run, mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from half a file and from a traceback: one line, exit code 1, and what was there still is."""
    (tmp_path / "a.ply").write_bytes(b"old")
    before = tree(tmp_path)

    def full(*_: object, **_named: object) -> None:
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
