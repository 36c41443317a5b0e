"""Who speaks on the line, so that an error can say what was heard instead of our autopilot."""

from __future__ import annotations

from pathlib import Path

from companion.autopilot.interface import Message
from companion.config.autopilot import AutopilotSettings
from companion.mavlink.firmware import KINDS, AutopilotKind
from companion.mavlink.ids import MavAutopilot, MavComponent
from companion.mavlink.link_url import SerialLink, parse_link

REMEMBERED = 64


def _firmware(heartbeat: Message) -> int:
    firmware = heartbeat.fields.get("autopilot")
    return firmware if isinstance(firmware, int) else MavAutopilot.INVALID


def kind_of(heartbeat: Message) -> AutopilotKind | None:
    """Which firmware sent a heartbeat; None when it is none that we fly."""
    return KINDS.get(_firmware(heartbeat))


class Neighbours:
    """Remembers the senders of heartbeats, 64 at most."""

    def __init__(self, settings: AutopilotSettings) -> None:
        self._settings = settings
        self._seen: dict[tuple[int, int], int] = {}  # (system, component) -> MAV_AUTOPILOT

    def note(self, heartbeat: Message) -> None:
        """Somebody is there."""
        if len(self._seen) < REMEMBERED:
            self._seen[heartbeat.system_id, heartbeat.component_id] = _firmware(heartbeat)

    def instead_of_ours(self) -> str:
        """The error for a person: our autopilot did not come; what did, and what to do."""
        url, system_id = self._settings.url, self._settings.system_id
        begin = f"no autopilot of system {system_id} on {url} within {self._settings.connect_timeout_s:g} s: "
        ours = self._seen.get((system_id, MavComponent.AUTOPILOT1), MavAutopilot.INVALID)
        if ours not in KINDS and ours != MavAutopilot.INVALID:
            return f"{begin}its firmware (MAV_AUTOPILOT {ours}) is neither PX4 (12) nor ArduPilot (3)"
        others = sorted({system for (system, _), autopilot in self._seen.items() if autopilot in KINDS} - {system_id})
        if others:
            names = ", ".join(map(str, others))
            return f"{begin}only autopilots of other systems: {names}. Set autopilot.system_id to the one to fly"
        if self._seen:
            names = ", ".join(f"{system}/{component}" for system, component in sorted(self._seen))
            return f"{begin}only senders that are no autopilot (system/component {names}). Is the autopilot on?"
        if isinstance(link := parse_link(url), SerialLink):
            if not Path(link.device).exists():
                return f"{begin}there is no {link.device}. Is its cable plugged in, and is that its name?"
            return (
                f"{begin}nothing at all was heard on {link.device}. Is the autopilot on, are TX and RX crossed, does "
                f"its port speak MAVLink at {link.baud} baud, and does no other program have it open?"
            )
        return (
            f"{begin}nothing at all was heard. Is the autopilot on, does it send MAVLink to this address, "
            "and does no other program listen on the same port?"
        )
