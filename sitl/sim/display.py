"""What the operator sees while a simulated mission flies."""

from __future__ import annotations

import time
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table

from companion.model import Mode
from sitl.sim.simulation import COMPLETE_SHARE, Progress

PLAIN_PERIOD_S = 10.0
"""Without a terminal one line is printed this often."""

MODE_MEANS = {
    Mode.CIRCLE: "R1 initial circle",
    Mode.TANGENT: "R2 along a tangent",
    Mode.BOUNDARY: "R3 along the wall",
    Mode.HOLD: "hold, something is missing",
}
"""What the vehicle is at, for people."""


class Display:
    """A live table in a terminal, lines elsewhere. Used as a context manager and called with every `Progress`."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, refresh_per_second=4, transient=True) if console.is_terminal else None
        self._began_s = time.perf_counter()
        self._next_line_s = 0.0

    def __enter__(self) -> Self:
        self._began_s = time.perf_counter()
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def __call__(self, progress: Progress) -> None:
        """Show how the mission stands."""
        wall_s = time.perf_counter() - self._began_s
        pace = progress.t_s / wall_s if wall_s > 0.0 else 0.0
        if self._live is not None:
            self._live.update(_table(progress, pace))
        elif wall_s >= self._next_line_s:
            self._next_line_s = wall_s + PLAIN_PERIOD_S
            self._console.print(_line(progress, pace), highlight=False, soft_wrap=True)


def _table(progress: Progress, pace: float) -> Table:
    outer = Table.grid(padding=(0, 1))
    bar = Table.grid(padding=(0, 1))
    bar.add_row(
        "map",
        ProgressBar(total=COMPLETE_SHARE, completed=min(progress.completeness, COMPLETE_SHARE), width=40),
        f"{progress.completeness:6.1%} of what can be seen (complete at {COMPLETE_SHARE:.0%})",
    )
    outer.add_row(bar)
    outer.add_row(f"simulated {clock(progress.t_s)}   {pace:.0f} times real time   Ctrl-C stops and keeps the map")
    rows = Table(box=None, pad_edge=False)
    for heading in ("vehicle", "mode", "d", "h", "speed", "way"):
        rows.add_column(heading, justify="left" if heading in ("vehicle", "mode") else "right", min_width=8)
    for flight in progress.flights:
        measurement = flight.measurement
        rows.add_row(
            str(flight.log.vehicle_id),
            MODE_MEANS[flight.navigator.status.mode],
            _metres(None if measurement is None else measurement.d_m),
            _metres(None if measurement is None else measurement.h_m),
            f"{flight.vehicle.forward_mps:.2f} m/s",
            f"{flight.vehicle.path_m:.0f} m",
        )
    outer.add_row(rows)
    return outer


def _line(progress: Progress, pace: float) -> str:
    first = progress.flights[0]
    measurement = first.measurement
    return (
        f"{clock(progress.t_s)} simulated, {pace:.0f} times real time: map {progress.completeness:.1%}, "
        f"{MODE_MEANS[first.navigator.status.mode]}, d {_metres(None if measurement is None else measurement.d_m)}, "
        f"h {_metres(None if measurement is None else measurement.h_m)}"
    )


def clock(t_s: float) -> str:
    """Minutes and seconds."""
    return f"{int(t_s) // 60}:{int(t_s) % 60:02d} min"


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} m"
