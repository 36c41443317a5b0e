"""The map: its speed beside OctoMap and Open3D, its growth, its truth, its files, and what it costs the flight."""
