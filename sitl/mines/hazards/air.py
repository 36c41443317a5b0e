"""What is in the air of a mine, and what is not: dust, wind, light; and the end of a scan, behind which is nothing."""

from __future__ import annotations

import numpy as np

from sitl.mines.conditions import Conditions, Dust, Stretch, Trigger, Wind
from sitl.mines.hazards.building import Body, main_and_branch, mine, rough
from sitl.mines.model import World

_ACROSS = Stretch(7.0, -3.0, 15.0, 3.0)


def dust() -> World:
    """Puffs of dust or spray in a stretch of the drift."""
    told = "a drift with 8 m of dust, whose false returns come and go"
    return mine("dust", told, rough(main_and_branch()), Conditions(dust=(Dust(_ACROSS, 6.0, 0.03),)))


def wind() -> World:
    """A ventilation drift with 2 m/s along it; in its branch the air stands still."""
    blows = Wind(Stretch(6.0, -2.5, 30.0, 2.5), 2.0, 0.0)
    told = "a drift with a wind of 2 m/s along it and still air in its branch"
    return mine("wind", told, rough(main_and_branch()), Conditions(winds=(blows,)))


def no_light() -> World:
    """The lamp fails for good in the middle of the drift: from then on no image has any depth."""
    told = "a drift in which the light fails for good after 11 m"
    return mine("no-light", told, rough(main_and_branch()), Conditions(light_fails=Trigger(11.0, 0.0, 2.5)))


def open_end() -> World:
    """A scan that was cut off: the drift has no end, and beyond are neither walls nor floor."""
    shell = rough(main_and_branch())
    kept = shell.vertices_m[shell.triangles][:, :, 0].max(axis=1) < 24.0
    used, renumbered = np.unique(shell.triangles[kept], return_inverse=True)
    surface = Body(shell.vertices_m[used], renumbered.reshape(-1, 3).astype(np.int32))
    return mine("open-end", "a drift that was scanned up to x = 24 m: its mesh is open there", surface)
