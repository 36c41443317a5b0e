"""The protocol of sensor drivers, and how one is found by its name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, runtime_checkable

from companion.autopilot.interface import Link
from companion.clock import Clock
from companion.config.settings import Settings
from companion.errors import InputError
from companion.sensors.sink import SensorSink

GROUP = "companion.sensors"
"""The entry-point group in which drivers are found."""


@runtime_checkable
class SensorDriver(Protocol):
    """A source of readings that runs until it is cancelled."""

    name: str

    async def run(self, sink: SensorSink) -> None:
        """Fill ``sink`` until cancelled, and release everything then.

        A device or process that is not there, or goes away, is waited for and taken up again. The event loop is
        shared with the control of the vehicle: nothing here may hold it for more than 5 ms.

        Args:
            sink: where readings go, stamped with the context's clock when they were measured, not when they arrived.

        Raises:
            InputError: a setting can never work.
        """


@dataclass(frozen=True, slots=True)
class DriverContext:
    """The surroundings that all drivers share.

    Attributes:
        clock: the clock in which every reading is stamped.
        link: the connection to the autopilot; None where there is none.
    """

    clock: Clock
    link: Link | None


DriverFactory = Callable[[Settings, DriverContext], SensorDriver]
"""The function that an entry point names; raises InputError for settings that can never work."""


def load_drivers(settings: Settings, context: DriverContext) -> tuple[SensorDriver, ...]:
    """The drivers named by ``sensors.drivers``, in that order, not yet running.

    Raises:
        InputError: a name is unknown, given twice or offered by two packages, or its driver cannot be made.
    """
    return tuple(_factory(entry)(settings, context) for entry in find_drivers(settings))


def find_drivers(settings: Settings) -> tuple[EntryPoint, ...]:
    """Where the drivers named by ``sensors.drivers`` are; nothing of them is imported.

    Raises:
        InputError: a name is unknown, given twice or offered by two packages.
    """
    names = settings.sensors.drivers
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"sensors.drivers names {', '.join(twice)} twice; each driver runs once")
    return tuple(_find(name) for name in names)


def _find(name: str) -> EntryPoint:
    offered = entry_points(group=GROUP)
    found = {entry.value: entry for entry in offered if entry.name == name}
    if not found:
        known = ", ".join(sorted({entry.name for entry in offered})) or "none; is the package installed?"
        raise InputError(f"sensors.drivers: there is no sensor driver {name!r}. Known: {known}")
    if len(found) > 1:
        places = ", ".join(sorted(found))
        raise InputError(f"sensors.drivers: {name} is offered more than once ({places}); uninstall all but one")
    (entry,) = found.values()
    return entry


def _factory(entry: EntryPoint) -> DriverFactory:
    try:
        factory: DriverFactory = entry.load()
    except (ImportError, AttributeError) as error:
        raise InputError(f"sensors.drivers: {entry.name} ({entry.value}) cannot be loaded: {error}") from error
    return factory
