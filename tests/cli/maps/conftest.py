"""A mission with a map, and the command itself."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from companion.cli import main as cli
from companion.cli.maps import progress as progress_module
from tests.cli.maps.missions import Run, journal_at


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs `companion map ...` and gives its exit code, stdout and stderr, without progress on a slow machine."""
    monkeypatch.setattr(progress_module, "PATIENCE_S", math.inf)

    def run_command(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            cli.main(["map", *map(str, arguments)])
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    return run_command


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    """A mission's folder with a journal."""
    folder = tmp_path / "mission"
    folder.mkdir()
    journal_at(folder / "map.journal")
    return folder
