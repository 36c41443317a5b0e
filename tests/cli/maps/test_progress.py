"""How far a command is, shown to people and written into logs."""

from __future__ import annotations

import io
import time
from pathlib import Path

import pytest
from rich.console import Console

from companion.cli import main as cli
from companion.cli.maps import progress as progress_module
from companion.cli.maps.progress import LINE_PERIOD_S, PATIENCE_S, Progress


def test_opening_a_large_map_shows_progress(
    mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Protects from silence before the first figure: to open a map every byte of it is read, and that may take long."""
    monkeypatch.setattr(progress_module, "PATIENCE_S", 0.0)
    for source, target in ((mission, "a.ot"), (tmp_path / "a.ot", "b.ot")):
        with pytest.raises(SystemExit):
            cli.main(["map", "export", str(source), str(tmp_path / target)])
        assert f"opening {'map.journal' if source == mission else source.name}: " in capsys.readouterr().err


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_progress_is_silent_when_it_is_quick_and_has_lines_in_a_log() -> None:
    """Protects logs: nothing for what is over at once, then a line now and then, and no control characters."""
    clock = Clock()
    log = io.StringIO()
    with Progress("writing a.ply", Console(file=log), clock) as progress:
        progress(0.1)
        clock.now_s += PATIENCE_S
        progress(0.2)
        clock.now_s += 0.9 * LINE_PERIOD_S
        progress(0.5)
        clock.now_s += 0.1 * LINE_PERIOD_S
        progress(None)
    assert log.getvalue() == "writing a.ply: 20%\nwriting a.ply: still at it\n"


def test_progress_is_a_bar_on_a_terminal(tmp_path: Path) -> None:
    """Protects the terminal: a bar with the task and its share, which is taken away at the end."""
    clock = Clock()
    with (tmp_path / "tty").open("w", encoding="utf-8") as terminal:
        console = Console(file=terminal, force_terminal=True, width=80)
        with Progress("writing a.ply", console, clock) as progress:
            clock.now_s += PATIENCE_S
            progress(0.25)
            progress(0.5)
            time.sleep(0.15)  # the bar draws itself ten times a second, in a thread of rich's own
    shown = (tmp_path / "tty").read_text()
    assert "writing a.ply" in shown
    assert "\x1b[2K" in shown
