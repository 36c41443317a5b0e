"""A sheet to draw on: type, rules, axes in metres and a scale bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

INK, FAINT, GRID, MARK = (31, 36, 40), (107, 115, 123), (228, 230, 232), (213, 94, 0)
"""Text and lines; axes; the grid; what is pointed out. The last is from the colours of Okabe and Ito."""

Colour = tuple[int, int, int]

TEXT_PX, TITLE_PX = 17, 27

_TICK_PX = 6
_ROWS_APART_PX = 45.0
_COLUMNS_APART_PX = 45.0, 85.0, 130.0, 200.0
"""Between numbers below each other, and beside each other: the least of these for which they do not touch."""

_BETWEEN_PX = 20


def round_step(least: float) -> float:
    """The smallest of 1, 2, 5, 10 ... (and 0.5, 0.2 ...) that is at least ``least``."""
    power = 10.0 ** math.floor(math.log10(least))
    return power * next(step for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least * (1.0 - 1e-9))


def text_width(words: str, size: int = TEXT_PX) -> int:
    """Pixels that a line takes."""
    return math.ceil(_font(size).getlength(words))


@cache
def _font(size: int) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    """Comes with Pillow, so that a picture looks the same everywhere; it knows hardly more than ASCII."""
    return ImageFont.load_default(size)


class Axis:
    """Where metres are on the sheet, along one edge of a frame.

    Args:
        low_m: the least coordinate of the frame.
        high_m: the greatest.
        start_px: where ``low_m`` is.
        px_per_m: pixels to the metre; negative when the axis points up or left.
    """

    def __init__(self, low_m: float, high_m: float, start_px: float, px_per_m: float) -> None:
        self.low_m = low_m
        self.high_m = high_m
        self._start_px = start_px
        self._px_per_m = px_per_m

    def at(self, place_m: float) -> float:
        """The pixel of a coordinate."""
        return self._start_px + (place_m - self.low_m) * self._px_per_m

    def ticks_m(self, apart_px: float) -> list[float]:
        """Round coordinates, at least so far from each other."""
        step = round_step(apart_px / abs(self._px_per_m))
        first, last = math.ceil(self.low_m / step - 1e-6), math.floor(self.high_m / step + 1e-6)
        return [step * n for n in range(first, last + 1)]


def ticks_in_a_row(axis: Axis) -> list[float]:
    """Ticks with their numbers in a row."""
    for apart_px in _COLUMNS_APART_PX:
        ticks = axis.ticks_m(apart_px)
        if all(text_width(number(tick_m)) + _BETWEEN_PX <= apart_px for tick_m in ticks):
            break
    return ticks


def number(tick_m: float) -> str:
    """What is written at a tick."""
    return f"{tick_m:.12g}"


class Paper:
    """A white sheet of ``width_px`` x ``height_px``."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self.image = Image.new("RGB", (width_px, height_px), "white")
        self._draw = ImageDraw.Draw(self.image)

    def text(
        self, x: float, y: float, words: str, size: int = TEXT_PX, colour: Colour = INK, anchor: str = "la"
    ) -> None:
        """Write a line; ``anchor`` as Pillow has it: left, middle, right, and ascender, middle, descender."""
        self._draw.text((x, y), words, fill=colour, font=_font(size), anchor=anchor)

    def text_up(self, x: float, y: float, words: str) -> None:
        """Write a line upwards, its middle at (x, y)."""
        left, top, right, bottom = (round(edge) for edge in _font(TEXT_PX).getbbox(words))
        strip = Image.new("RGB", (right - left + 4, bottom - top + 4), "white")
        ImageDraw.Draw(strip).text((2 - left, 2 - top), words, fill=INK, font=_font(TEXT_PX))
        turned = strip.rotate(90, expand=True)
        self.image.paste(turned, (round(x - turned.width / 2), round(y - turned.height / 2)))

    def line(self, points: Sequence[tuple[float, float]], colour: Colour = INK, width: int = 1) -> None:
        """Draw a line through points."""
        self._draw.line(points, fill=colour, width=width, joint="curve")

    def dashes(self, start: tuple[float, float], end: tuple[float, float], colour: Colour = MARK) -> None:
        """Draw a dashed line."""
        length = math.dist(start, end)
        for n in range(0, int(length), 14):
            ends = [(n / length), min((n + 8) / length, 1.0)]
            self.line([(start[0] + t * (end[0] - start[0]), start[1] + t * (end[1] - start[1])) for t in ends], colour)

    def box(self, corners: tuple[float, float, float, float], fill: Colour | None = None, edge: Colour = FAINT) -> None:
        """Draw a rectangle: left, top, right, bottom."""
        self._draw.rectangle(corners, fill=fill, outline=edge)

    def raster(self, pixels: NDArray[np.uint8], x: Axis, y: Axis) -> None:
        """Put an image (rows, columns, 3) into the frame between two axes, its edges sharp at any scale."""
        left, right = sorted((round(x.at(x.low_m)), round(x.at(x.high_m))))
        top, bottom = sorted((round(y.at(y.low_m)), round(y.at(y.high_m))))
        size = max(right - left, 1), max(bottom - top, 1)
        times = [math.ceil(wanted / have) for wanted, have in zip(size, pixels.shape[1::-1], strict=True)]
        larger = np.repeat(np.repeat(pixels, times[1], axis=0), times[0], axis=1)
        self.image.paste(Image.fromarray(larger).resize(size, Image.Resampling.BOX), (left, top))

    def axes(self, x: Axis, y: Axis, x_name: str, y_name: str | None) -> None:
        """Draw a frame with its numbers below and, where it has a name, on the left."""
        left, right = sorted((round(x.at(x.low_m)), round(x.at(x.high_m))))
        top, bottom = sorted((round(y.at(y.low_m)), round(y.at(y.high_m))))
        self._draw.rectangle((left - 1, top - 1, right, bottom), outline=FAINT)
        for tick_m in ticks_in_a_row(x):
            self.line([(x.at(tick_m), bottom), (x.at(tick_m), bottom + _TICK_PX)], FAINT)
            self.text(x.at(tick_m), bottom + _TICK_PX + 3, number(tick_m), colour=FAINT, anchor="ma")
        self.text((left + right) / 2, bottom + _TICK_PX + 5 + TEXT_PX, x_name, anchor="ma")
        if y_name is None:
            return
        for tick_m in y.ticks_m(_ROWS_APART_PX):
            self.line([(left - _TICK_PX, y.at(tick_m)), (left, y.at(tick_m))], FAINT)
            self.text(left - _TICK_PX - 4, y.at(tick_m), number(tick_m), colour=FAINT, anchor="rm")
        self.text_up(left - 66, (top + bottom) / 2, y_name)

    def scale_bar(self, x: float, y: float, px_per_m: float) -> float:
        """Draw a scale bar of a round length from (x, y) to the right; where it ends."""
        length_m = round_step(110.0 / px_per_m)
        end = x + length_m * px_per_m
        for part in range(4):
            edges = (x + part * (end - x) / 4, y - 5, x + (part + 1) * (end - x) / 4, y + 5)
            self.box(edges, INK if part % 2 == 0 else (255, 255, 255), INK)
        self.text(end + 10, y, f"{length_m:g} m", anchor="lm")
        return end + 10 + text_width(f"{length_m:g} m")
