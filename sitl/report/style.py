"""How the pictures look: colours that colour-blind people can tell apart, type, and what every picture needs."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from companion.model import Mode

INK = "#1f2428"
FAINT_INK = "#6b737b"
GRID = "#e4e6e8"
MINE = "#eceae4"
WALL = "#8a8378"
MISSED = "#d3122a"

# The colours of Okabe and Ito.
MODE_COLOURS = {Mode.CIRCLE: "#009e73", Mode.TANGENT: "#d55e00", Mode.BOUNDARY: "#0072b2", Mode.HOLD: INK}
MODE_LABELS = {
    Mode.CIRCLE: "R1 turns to look",
    Mode.TANGENT: "R2 flies a tangent",
    Mode.BOUNDARY: "R3 follows a wall",
    Mode.HOLD: "hold",
}
VEHICLE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", INK)
SAFE, NEAR = "#0072b2", "#e69f00"
HOMEWARD = "#cc79a7"
CRITICAL = "#b3001b"

DPI = 144
WIDTH_IN = 10.0
HALF_WIDTH_IN = 5.4  # two of these beside each other are as wide as the page
MOST_IN = 7.2  # the greatest height of a plan or map
STRIP_IN = 0.75  # below those, for the scale bar and the legend: nothing there can cover data
_EDGE_IN = 0.15

_RC: Any = {  # matplotlib's own type for this names every key that it has
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
}


def picture(
    width_in: float, height_in: float, draw: Callable[[Figure], None], raster: NDArray[np.uint8] | None = None
) -> bytes:
    """A PNG.

    Args:
        width_in: its width, `DPI` pixels to the inch.
        height_in: its height.
        draw: draws on an empty white figure.
        raster: (rows, columns, 3) put in the middle of the top edge as it is, over what is drawn there: matplotlib
            would take longer to resample it than it took to make.
    """
    with mpl.rc_context(_RC):
        figure = Figure(figsize=(width_in, height_in), dpi=DPI, facecolor="white")
        FigureCanvasAgg(figure)
        draw(figure)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="rgba", dpi=DPI)
    columns, rows = figure.canvas.get_width_height()
    pixels = np.frombuffer(buffer.getvalue(), np.uint8).reshape(rows, columns, 4).copy()
    if raster is not None:
        left = (columns - raster.shape[1]) // 2
        pixels[: raster.shape[0], left : left + raster.shape[1], :3] = raster
    png = io.BytesIO()
    imsave(png, pixels, format="png", pil_kwargs={"compress_level": 4})
    return png.getvalue()


def vehicle_colour(index: int) -> str:
    """The colour of the vehicle at this place in the list of flights."""
    return VEHICLE_COLOURS[index % len(VEHICLE_COLOURS)]


def round_length_m(extent_m: float) -> float:
    """The largest of 1, 2, 5, 10 ... that is at most a fifth of ``extent_m``: the length of a scale bar."""
    fifth = max(extent_m, 1e-3) / 5.0
    power = 10.0 ** np.floor(np.log10(fifth))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= fifth * (1.0 + 1e-9)))


def add_scale_bar(figure: Figure, inch_per_m: float, width_in: float) -> None:
    """A scale bar in the lower left corner, for a picture that is ``width_in`` wide."""
    length = round_length_m(width_in / inch_per_m)
    left, right, y = _EDGE_IN, _EDGE_IN + length * inch_per_m, STRIP_IN / 2
    to_inch = figure.dpi_scale_trans
    for x0, y0, x1, y1 in ((left, y, right, y), (left, y - 0.05, left, y + 0.05), (right, y - 0.05, right, y + 0.05)):
        figure.add_artist(Line2D((x0, x1), (y0, y1), color=INK, lw=1.8, transform=to_inch))
    figure.text(right + 0.08, y, f"{length:g} m", va="center", transform=to_inch)
