"""Surfaces that cameras and rangefinders see wrongly or not at all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.mines.conditions import Conditions, Surface
from sitl.mines.hazards.building import HEIGHT_M, main_and_branch, mine, rough
from sitl.mines.model import World
from sitl.mines.plan import Shell


def dark_wall() -> World:
    """The end of the drift and one wall of it give no echo, as wet coal does."""
    shell = rough(main_and_branch())
    middle = _middles(shell)
    wall = (middle[:, 2] > 0.3) & (middle[:, 2] < HEIGHT_M - 0.3)
    dark = wall & ((middle[:, 0] > 24.5) | ((np.abs(middle[:, 0] - 11.0) < 3.0) & (middle[:, 1] > 1.2)))
    text = "a drift whose end, and 6 m of whose northern wall, give no echo"
    return mine("dark-wall", text, shell, _made_of(dark, Surface.DARK))


def shiny_wall() -> World:
    """The same walls shine: they return patches that come and go, and mirror."""
    shell = rough(main_and_branch())
    middle = _middles(shell)
    wall = (middle[:, 2] > 0.3) & (middle[:, 2] < HEIGHT_M - 0.3)
    shiny = wall & ((middle[:, 0] > 24.5) | ((np.abs(middle[:, 0] - 11.0) < 3.0) & (middle[:, 1] > 1.2)))
    text = "a drift whose end, and 6 m of whose northern wall, shine: patches come and go"
    return mine("shiny-wall", text, shell, _made_of(shiny, Surface.SHINY))


def water() -> World:
    """Still water on the floor over 6 m: it mirrors the roof."""
    shell = rough(main_and_branch())
    middle = _middles(shell)
    wet = (np.abs(middle[:, 0] - 11.0) < 3.0) & (middle[:, 2] < 0.25) & (np.abs(middle[:, 1]) < 1.9)
    return mine("water", "still water on 6 m of the floor, which mirrors the roof", shell, _made_of(wet, Surface.WATER))


def _middles(shell: Shell) -> NDArray[np.float64]:
    """(m, 3) the middle of each triangle."""
    return np.asarray(shell.vertices_m[shell.triangles].mean(axis=1), np.float64)


def _made_of(triangles: NDArray[np.bool_], surface: Surface) -> Conditions:
    return Conditions(surfaces=np.where(triangles, surface, Surface.ROCK).astype(np.uint8))
