"""Floors that a height above ground cannot be kept over: a shaft, a step, a ramp."""

from __future__ import annotations

import numpy as np

from sitl.mines.hazards.building import main_and_branch, mine, rough
from sitl.mines.model import World
from sitl.mines.plan import Array


def shaft() -> World:
    """A shaft over the width of the drift but for a bench along one wall: deeper than any beam reaches."""

    def ground_m(x_m: Array, y_m: Array) -> Array:
        return np.where((np.abs(x_m - 11.0) < 1.5) & (y_m < 0.6), -15.0, 0.0)

    def height_m(x_m: Array, y_m: Array) -> Array:
        return 3.0 - ground_m(x_m, y_m)

    shell = rough(main_and_branch(), ground_m, height_m, (9.5, 12.5), (0.6,))
    return mine("shaft", "a shaft of 3 m in the floor, 15 m deep, beside a bench of 1.5 m", shell)


def step() -> World:
    """A step up of 0.7 m across the drift."""

    def ground_m(x_m: Array, _y_m: Array) -> Array:
        return np.where(x_m > 11.0, 0.7, 0.0)

    return mine("step", "a step of 0.7 m in floor and roof", rough(main_and_branch(), ground_m, None, (11.0,)))


def slope() -> World:
    """A ramp of 25 %, 14 m long."""

    def ground_m(x_m: Array, _y_m: Array) -> Array:
        return 0.25 * (np.clip(x_m, 6.0, 20.0) - 6.0)

    return mine("slope", "a ramp of 25 % up, over 14 m", rough(main_and_branch(), ground_m))
