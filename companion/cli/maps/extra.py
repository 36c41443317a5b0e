"""What `companion map` needs beyond the vehicle's own libraries: those of the extra `ground`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from companion.errors import CompanionError

EXTRA = "mine-companion[ground]"
_OF_THE_EXTRA = ("viser", "matplotlib", "PIL", "plyfile", "pypcd4", "pyproj")


class ExtraMissingError(CompanionError):
    """A library of the extra is not installed."""


@contextmanager
def of_the_extra(command: str) -> Iterator[None]:
    """Say what to install when a library is missing: a missing module of ours is a bug and keeps its own error.

    Args:
        command: what needs it, as the user typed it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in _OF_THE_EXTRA:
            raise
        raise ExtraMissingError(
            f"the module {error.name} is not installed; `{command}` needs pip install '{EXTRA}'"
        ) from None
