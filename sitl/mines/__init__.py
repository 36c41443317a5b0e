"""Mines to fly in: generated ones and mesh files."""

from sitl.mines.load import load_world
from sitl.mines.model import World

__all__ = ["World", "load_world"]
