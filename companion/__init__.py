"""Autonomous exploration and mapping of mines, caves and tunnels by a PX4 or ArduPilot drone."""

__version__ = "0.1.0"
