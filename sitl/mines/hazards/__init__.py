"""Small mines with one hazard each: ``--world hazard:NAME``."""

from __future__ import annotations

from collections.abc import Callable

from sitl.mines.hazards import air, echoes, floors, moving, overhead, passages
from sitl.mines.model import World

HAZARDS: dict[str, Callable[[], World]] = {
    "pillar": passages.pillar,
    "mirrored-edges": passages.mirrored_edges,
    "pocket": passages.pocket,
    "dust": air.dust,
    "dark-wall": echoes.dark_wall,
    "shiny-wall": echoes.shiny_wall,
    "water": echoes.water,
    "shaft": floors.shaft,
    "step": floors.step,
    "slope": floors.slope,
    "beam": overhead.low_beam,
    "cable": overhead.cable,
    "net": overhead.net,
    "overhang": overhead.overhang,
    "high-roof": overhead.high_roof,
    "person": moving.person,
    "machine": moving.machine,
    "door": moving.door,
    "door-on-loop": moving.door_on_loop,
    "roof-fall": moving.roof_fall,
    "open-end": air.open_end,
    "wind": air.wind,
    "no-light": air.no_light,
}
"""What to write after ``hazard:``, and what makes that mine."""
