"""Devices to frames: drivers, the sink that takes their readings, and how fresh, fast and alive each stream is."""
