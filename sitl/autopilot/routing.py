"""Who was heard on which connection, and what therefore goes where: an autopilot forwards what is for others.

PX4 and ArduPilot agree: what names a component goes to each other connection on which that component was heard,
what names none to all on which anybody was. What is for the autopilot alone stays.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from sitl.autopilot.inbox import AUTOPILOT_COMPONENT
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m

GROUND_STATION_SILENT_S = 2.5
_MOST_COMPONENTS = 32

Way = TypeVar("Way", bound=Hashable)


@dataclass(slots=True)
class _Connection:
    """What was heard on it."""

    components: set[tuple[int, int]] = field(default_factory=set)
    ground_station_s: float | None = None

    def knows(self, system: int, component: int) -> bool:
        """Whether it leads to them; 0 stands for any."""
        if system == 0:
            return bool(self.components)
        return any(s == system and component in (0, c) for s, c in self.components)


class Routes(Generic[Way]):
    """The connections of one autopilot.

    Args:
        system_id: of the vehicle.
        texts_only_to_ground_stations: whether STATUSTEXT leaves only where a ground station's heartbeat was heard.
    """

    def __init__(self, system_id: int, texts_only_to_ground_stations: bool) -> None:
        self._system_id = system_id
        self._texts_only_to_ground_stations = texts_only_to_ground_stations
        self._connections: dict[Way, _Connection] = {}

    def heard(self, way: Way, message: Message, t_s: float) -> None:
        """A message has come in on ``way``."""
        connection = self._connections.setdefault(way, _Connection())
        source = message.get_srcSystem(), message.get_srcComponent()
        if source != (self._system_id, AUTOPILOT_COMPONENT) and len(connection.components) < _MOST_COMPONENTS:
            connection.components.add(source)
        if message.get_type() == "HEARTBEAT" and message.type == m.MAV_TYPE_GCS:
            connection.ground_station_s = t_s

    def forget(self, ways: Iterable[Way]) -> None:
        """Connections that are gone."""
        for way in ways:
            self._connections.pop(way, None)

    def onward(self, way: Way, message: Message) -> list[Way]:
        """Where else a message that came in on ``way`` goes."""
        system, component = _target(message)
        if (system, component) == (self._system_id, AUTOPILOT_COMPONENT):
            return []
        return [
            other
            for other, connection in self._connections.items()
            if other != way and connection.knows(system, component)
        ]

    def takes(self, way: Way, message: Message, t_s: float) -> bool:
        """Whether what the autopilot says to all, or to one whose connection it looks for, goes out on ``way``."""
        connection = self._connections.get(way, _Connection())
        if message.get_type() == "STATUSTEXT" and self._texts_only_to_ground_stations:
            heard_s = connection.ground_station_s
            return heard_s is not None and t_s - heard_s <= GROUND_STATION_SILENT_S
        if message.get_type() == "COMMAND_ACK":
            return connection.knows(message.target_system, message.target_component)
        return True


def _target(message: Message) -> tuple[int, int]:
    """Whom a message is for; 0 stands for all."""
    return getattr(message, "target_system", 0), getattr(message, "target_component", 0)
