"""How the pictures look: colours that colour-blind people can tell apart, type, and what every picture needs."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from companion.model import Mode

INK = "#1f2428"
FAINT_INK = "#6b737b"
GRID = "#e4e6e8"
MINE = "#eceae4"
WALL = "#8a8378"
MISSED = "#d3122a"

# The colours of Okabe and Ito.
MODE_COLOURS = {Mode.CIRCLE: "#009e73", Mode.TANGENT: "#e66100", Mode.BOUNDARY: "#0072b2", Mode.HOLD: INK}
MODE_LABELS = {
    Mode.CIRCLE: "R1 turns to look",
    Mode.TANGENT: "R2 flies a tangent",
    Mode.BOUNDARY: "R3 follows a wall",
    Mode.HOLD: "hold",
}
VEHICLE_COLOURS = ("#0072b2", "#e66100", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", INK)
SAFE, NEAR, CRITICAL = "#0072b2", "#e69f00", "#b3001b"

_RC: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.edgecolor": FAINT_INK,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "text.color": INK,
    "xtick.color": FAINT_INK,
    "ytick.color": FAINT_INK,
    "legend.frameon": False,
    "figure.dpi": 160,
}


def picture(width_in: float, height_in: float, draw: Callable[[Figure], None]) -> bytes:
    """A PNG of the size given, drawn by ``draw`` on an empty white figure."""
    with mpl.rc_context(_RC):
        figure = Figure(figsize=(width_in, height_in), facecolor="white", layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png")
    return buffer.getvalue()


def vehicle_colour(index: int) -> str:
    """The colour of the vehicle at this place in the list of flights."""
    return VEHICLE_COLOURS[index % len(VEHICLE_COLOURS)]


def round_length_m(extent_m: float) -> float:
    """The largest of 1, 2, 5, 10 ... that is at most a fifth of ``extent_m``: the length of a scale bar."""
    fifth = max(extent_m, 1e-3) / 5.0
    power = 10.0 ** np.floor(np.log10(fifth))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= fifth * (1.0 + 1e-9)))


def add_scale_bar(axes: Axes, extent_m: float) -> None:
    """A scale bar below the lower left corner of axes whose x runs over ``extent_m`` metres, and no ticks."""
    left = axes.get_xlim()[0] + 0.01 * extent_m
    length = round_length_m(extent_m)
    place = blended_transform_factory(axes.transData, axes.transAxes)
    axes.plot([left, left + length], [-0.025, -0.025], color=INK, lw=2.2, transform=place, clip_on=False)
    axes.text(left + length, -0.025, f"  {length:g} m", va="center", ha="left", transform=place)
    axes.set_axis_off()
