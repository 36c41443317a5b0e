"""What several commands say in the same words."""

from __future__ import annotations


def losses(places: int, size_bytes: int) -> str:
    """What of a map was damaged."""
    return f"{places} place{'s' if places > 1 else ''} cannot be read: {size(size_bytes)} of the map are lost"


def size(size_bytes: int) -> str:
    """A size as people say it."""
    for unit, large in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size_bytes >= large:
            return f"{size_bytes / large:.1f} {unit}"
    return f"{size_bytes} bytes"
