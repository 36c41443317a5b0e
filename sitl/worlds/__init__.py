"""Worlds to fly in: generated ones and mesh files."""

from sitl.worlds.load import load_world
from sitl.worlds.model import World
from sitl.worlds.start import check_start

__all__ = ["World", "check_start", "load_world"]
