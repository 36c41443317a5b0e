"""Autopilot, world, gate and application as separate processes on one computer, as they are on a vehicle."""
