"""What can be wrong with a map's file."""

from __future__ import annotations

from companion.errors import InputError


class MapFileError(InputError):
    """A file that holds no map, a name that says no format, or a map that a format cannot hold."""
