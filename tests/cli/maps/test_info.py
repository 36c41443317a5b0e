"""`companion map info`, and `view` and the help, as far as they need no picture and no page."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from companion.cli.maps import view as look
from companion.cli.maps.clouds import CloudOptions
from companion.cli.maps.extra import EXTRA
from tests.cli.maps.conftest import Run, journal_at, tree


def test_info_says_what_the_map_holds(run: Run, mission: Path) -> None:
    """Protects the figures at a glance, for a mission's folder as for its journal."""
    code, printed, errors = run("info", mission)
    assert (code, errors) == (0, "")
    rows = {line[:13].strip(): line[14:] for line in printed.splitlines()}
    assert rows["voxel"] == "0.1 m"
    assert rows["frame"] == "east-north-up"
    assert rows["voxels"] == f"{32 * 22 * 12 - 6000:,} occupied, 6,000 free, 0 undecided"
    assert rows["free space"] == "6.0 m³"
    assert rows["bounds"] == "x -0.10 to 3.10, y -0.10 to 2.10, z -0.10 to 1.10 m"
    assert rows["extent"] == "3.20 x 2.20 x 1.20 m"
    assert "occupied from 0.70 on, clamps 0.12 and 0.97" in rows["sensor model"]
    assert rows["damage"] == "none found"
    assert run("info", mission / "map.journal")[1] == printed


def test_info_for_programs(run: Run, mission: Path) -> None:
    """Protects scripts: the JSON holds the same as the table, and every name has its unit."""
    found = json.loads(run("info", mission, "--json")[1])
    assert found["facts"]["free"] == 6000
    assert found["facts"]["surface_m2"] == pytest.approx(2 * (3 * 2 + 3 * 1 + 2 * 1), rel=0.02)
    assert found["extent_m"] == pytest.approx([3.2, 2.2, 1.2])
    assert found["header"]["voxel_m"] == 0.1
    assert found["bytes_on_disk"] == sum(file.stat().st_size for file in (mission / "map.journal").iterdir())
    assert (found["losses"], found["lost_bytes"], found["torn_bytes"]) == (0, 0, 0)


def test_info_of_an_octomap_file(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects maps of other programs: what their file does not say is not made up."""
    run("export", mission, tmp_path / "map.ot")
    code, printed, _ = run("info", tmp_path / "map.ot")
    assert code == 0
    assert "frame         not said in the file" in printed
    assert "6,000 free" in printed


def test_info_counts_what_is_damaged(run: Run, mission: Path) -> None:
    """Protects from a damaged map that looks whole: one flipped byte costs one record, and is said."""
    segment = max((mission / "map.journal").iterdir(), key=lambda file: file.stat().st_size)
    data = bytearray(segment.read_bytes())
    data[len(data) * 3 // 4] ^= 0xFF
    segment.write_bytes(data)
    before = tree(mission)
    code, printed, _ = run("info", mission)
    assert code == 0
    assert "1 place cannot be read" in printed
    assert json.loads(run("info", mission, "--json")[1])["losses"] == 1
    assert tree(mission) == before


def test_what_is_lost_is_said_by_every_command(run: Run, mission: Path, tmp_path: Path) -> None:
    """Protects whoever never asks for info: a file with holes where the journal is damaged must not look whole."""
    other = journal_at(tmp_path / "other.journal")
    segment = max((mission / "map.journal").iterdir(), key=lambda file: file.stat().st_size)
    data = bytearray(segment.read_bytes())
    data[len(data) * 3 // 4] ^= 0xFF
    segment.write_bytes(data)
    for arguments in (
        ("export", mission, tmp_path / "a.ply"),
        ("merge", mission, other, "-o", tmp_path / "both.journal"),
        ("view", mission, "--picture", tmp_path / "a.png"),
    ):
        code, _, errors = run(*arguments)
        assert (code, errors.count("\n")) == (0, 1), errors
        assert errors.startswith(f"{mission / 'map.journal'}: 1 place cannot be read: ")
        assert errors.endswith("of the map are lost\n")
    assert run("info", mission)[2] == ""


def test_info_says_that_the_end_is_torn(run: Run, mission: Path) -> None:
    """Protects the report after a crash: a torn end is no damage. But a copy that was cut short looks the same."""
    segment = max((mission / "map.journal").iterdir(), key=lambda file: file.stat().st_size)
    segment.write_bytes(segment.read_bytes()[:-3])
    _, printed, _ = run("info", mission)
    assert "its end is missing" in printed
    assert "or it was not copied whole" in printed
    assert "cannot be read" not in printed


# `companion map view` and the help, as far as they need no picture and no page.


def test_the_help_waits_for_nothing() -> None:
    """Protects the help from the seconds that compiled code and a web server take to load."""
    program = (
        "import sys; from companion.cli import main as cli\n"
        "try: cli.main(['map', 'view', '--help'])\n"
        "except SystemExit:\n"
        "    print(sorted({'numba', 'viser', 'matplotlib', 'numpy'} & set(sys.modules)), file=sys.stderr)"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ended.stderr.strip() == "[]"
    assert "--picture" in ended.stdout


def test_a_missing_extra_is_named(run: Run, mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the user of a plain installation: what to install, and exit code 1."""
    for name in ("matplotlib", "viser"):
        monkeypatch.setitem(sys.modules, name, None)
    for module in ("page", "picture"):
        monkeypatch.delitem(sys.modules, f"companion.viewer.{module}", raising=False)
    for arguments in ((mission,), (mission, "--picture", tmp_path / "a.png")):
        code, _, errors = run("view", *arguments)
        assert code == 1
        assert f"needs pip install '{EXTRA}'" in errors
        assert errors.count("\n") == 1


@pytest.mark.parametrize(
    ("host", "typed"),
    [("127.0.0.1", "localhost"), ("0.0.0.0", socket.gethostname()), ("10.1.2.3", "10.1.2.3")],  # noqa: S104
)
def test_the_address_can_be_typed_into_a_browser(
    mission: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], host: str, typed: str
) -> None:
    """Protects whoever opens the map from another machine: 0.0.0.0 is listened at, but leads nowhere."""
    pytest.importorskip("viser", reason="pip install mine-companion[ground]")
    page = SimpleNamespace(port=8080, note="", wait=lambda: None)
    monkeypatch.setattr("companion.viewer.page.serve", lambda *_: nullcontext(page))
    look.show_in_browser(mission, host, 8080, 1000, CloudOptions())
    assert capsys.readouterr().out == f"{mission}: open http://{typed}:8080; Ctrl-C ends it\n"
