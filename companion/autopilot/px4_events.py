"""What PX4 says in EVENT messages: refusals, failsafes and arming checks, in its own words.

PX4 sends STATUSTEXT only on links on which it has heard a ground station, which this one is not. EVENTs it sends to
everybody, as numbers; their texts are in its metadata, which MAVSDK fetches from the autopilot itself (MAVLink FTP).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mavsdk.plugins.events import Event, Events, HealthAndArmingCheckReport
from mavsdk.system import System

from companion.autopilot.interface import Message
from companion.clock import Clock
from companion.mavlink.ids import MavComponent, MavSeverity

METADATA_S = 10.0
"""Until then the texts may still be on the way; after that an event without its text is better than none."""


class Px4Events:
    """Hands on each event as the STATUSTEXT that it would be on a ground station's link. Called in MAVSDK's threads.

    Args:
        system: as MAVSDK has discovered it.
        put: takes the message.
        clock: stamps it.

    Attributes:
        problems: what PX4's own checks have against arming now, each once.
    """

    def __init__(self, system: System, put: Callable[[Message], None], clock: Clock) -> None:
        self.problems: tuple[str, ...] = ()
        self._system_id: int = system.get_system_id()
        self._put = put
        self._clock = clock
        self._begun_s = clock.now_s()
        self._has_texts = False
        self._events = Events(system)
        self._events.subscribe_events(self._on_event)
        self._events.subscribe_health_and_arming_checks(self._on_checks)

    def on_raw(self, fields: dict[str, Any]) -> None:
        """One EVENT as it came, which is told by its number where no texts are to be had."""
        if self._has_texts or self._clock.now_s() - self._begun_s < METADATA_S:
            return
        severity = fields.get("log_levels", 0) & 0x0F
        if severity <= MavSeverity.WARNING:
            self._say(severity, f"event 0x{fields.get('id', 0):08x}, whose text the autopilot does not tell")

    def _on_event(self, event: Event, _user_data: object) -> None:
        self._has_texts = True
        if event.compid == MavComponent.AUTOPILOT1:
            self._say(int(event.log_level), event.message)

    def _on_checks(self, report: HealthAndArmingCheckReport, _user_data: object) -> None:
        self._has_texts = True
        self.problems = tuple(dict.fromkeys(problem.message for problem in report.all_problems if problem.message))

    def _say(self, severity: int, text: str) -> None:
        fields = {"severity": severity, "text": text, "id": 0, "chunk_seq": 0}
        now_s = self._clock.now_s()
        self._put(Message("STATUSTEXT", fields, now_s, self._system_id, MavComponent.AUTOPILOT1))
