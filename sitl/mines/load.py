"""From what a user writes after ``--world`` to a world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from companion.errors import InputError
from sitl.mines.files import SUFFIXES
from sitl.mines.fixed import complex_world, room_world, slope_world
from sitl.mines.hazards import HAZARDS
from sitl.mines.mesh import mesh_world
from sitl.mines.model import World
from sitl.mines.placing import Reading
from sitl.mines.random_mine import random_world
from sitl.mines.start_beside import Start, start_pose

_FIXED = {"complex": complex_world, "slope": slope_world, "room": room_world}


def load_world(spec: str, seed: int, start: Start | None = None, reading: Reading | None = None) -> World:
    """The world that ``spec`` names.

    Args:
        spec: ``complex``, ``slope`` or ``room`` (after the paper's Section 5), ``random`` (drawn by ``seed``),
            ``random:K`` (drawn by K whatever the seed), ``hazard:NAME`` (one of `HAZARDS`), or the path of a mesh file.
        seed: draws the world ``random``; not negative.
        start: x, y, z in m and yaw in rad where the vehicle starts. Mesh files need it, unless a JSON file beside them
            names one, and have it in their own unit and origin.
        reading: how a mesh file is to be read.

    Raises:
        InputError: no such world, or its file cannot be used.
    """
    kind, _, drawn_by = spec.partition(":")
    if spec in _FIXED:
        world = _FIXED[spec]()
    elif spec == "random":
        if seed < 0:
            raise InputError(f"seed {seed}: must not be negative")
        world = random_world(seed)
    elif kind == "random":
        if not (drawn_by.isascii() and drawn_by.isdigit()):
            raise InputError(f"world {spec}: after 'random:' comes the number that draws it, as in random:7")
        world = random_world(int(drawn_by))
    elif kind == "hazard":
        if drawn_by not in HAZARDS:
            raise InputError(f"world {spec}: after 'hazard:' comes one of {', '.join(HAZARDS)}")
        world = HAZARDS[drawn_by]()
    elif Path(spec).suffix or Path(spec).exists():
        return mesh_world(Path(spec), start, reading)
    else:
        known = ", ".join([*_FIXED, "random", "random:K", "hazard:NAME"])
        raise InputError(
            f"world {spec}: there is none of that name; give {known} or a mesh file ({', '.join(SUFFIXES)})"
        )
    if reading is not None and reading != Reading():
        raise InputError(f"world {spec}: --scale, --up and --cloud-voxel are for mesh files")
    return world if start is None else replace(world, start=start_pose(start))
