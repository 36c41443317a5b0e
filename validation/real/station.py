"""A ground station and a transmitter for a real autopilot: heartbeats, sticks, orders, parameters."""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from tests.integration.witness import Witness
from tests.shared.beside import OwnThread, wait_until

BEAT_S = 1.0
STICKS_S = 0.05
MIDDLE, THROTTLE_MIDDLE = 0, 500
ACKNOWLEDGED_S, SECOND_ACK_S = 3.0, 0.3
"""PX4 acknowledges some commands twice; the last one counts."""
_SENDER = (255, 190)
_REAL32 = m.MAV_PARAM_TYPE_REAL32


@dataclass(frozen=True, slots=True)
class Ack:
    """One COMMAND_ACK."""

    t_s: float
    command: int
    result: int


@dataclass(frozen=True, slots=True)
class Heard:
    """One message of the autopilot, whatever it is."""

    t_s: float
    message: Message


class Station(Witness):
    """A witness that also speaks, on the autopilot's link to the ground, while the block lasts.

    Args:
        port: to which the autopilot sends.
        keep: names of the messages that are kept besides what a witness keeps.

    Attributes:
        beating: whether heartbeats of a ground station are sent.
        sticks: whether a transmitter is there, its sticks in the middle.
        acks: what was acknowledged.
        heard: the messages of `keep`.
        parameters: values and types of the autopilot's parameters, as far as it told them.
        kind: MAV_AUTOPILOT of its heartbeats.
    """

    def __init__(self, port: int, keep: tuple[str, ...] = ()) -> None:
        super().__init__(port)
        self.beating, self.sticks = True, False
        self.acks: list[Ack] = []
        self.heard: list[Heard] = []
        self.parameters: dict[str, tuple[float, int]] = {}
        self.kind: int | None = None
        self._keep = frozenset(keep)
        self._voice = _Voice(self)

    def __enter__(self) -> Self:
        super().__enter__()
        self._voice.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._voice.__exit__(*error)
        super().__exit__(*error)

    @property
    def reached(self) -> bool:
        """Whether the autopilot has been heard, so that it can be spoken to."""
        return self._autopilot is not None

    def command(self, command: int, *parameters: float, component: int = 1, sender: tuple[int, int] = _SENDER) -> None:
        """Order something; the seven parameters that are not given are 0."""
        seven = (*parameters, *[0.0] * 7)[:7]
        self.send(m.MAVLink_command_long_message(1, component, command, 0, *seven), sender)

    def ask(self, command: int, *parameters: float, component: int = 1) -> list[int]:
        """Order something; the results of all acknowledgements, oldest first, none when there was none."""
        since = len(self.acks)
        self.command(command, *parameters, component=component)
        give_up_s = time.monotonic() + ACKNOWLEDGED_S
        while time.monotonic() < give_up_s and not self._results(since, command):
            time.sleep(0.01)
        time.sleep(SECOND_ACK_S)
        return self._results(since, command)

    def set_mode(self, mode: tuple[float, float, float]) -> None:
        """Select a flight mode as a pilot does, by the parameters of DO_SET_MODE."""
        self.command(m.MAV_CMD_DO_SET_MODE, *mode)

    def parameter(self, name: str, timeout_s: float = ACKNOWLEDGED_S) -> tuple[float, int] | None:
        """Value and type; None: the autopilot does not answer."""
        self.parameters.pop(name, None)
        give_up_s = time.monotonic() + timeout_s
        while name not in self.parameters and time.monotonic() < give_up_s:
            self.send(m.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
            time.sleep(0.2)
        return self.parameters.get(name)

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Set parameters in flight, each until it is confirmed."""
        for name, value in values.items():
            self._set(name, value)

    def _set(self, name: str, value: float) -> None:
        found = self.parameter(name)
        assert found is not None, f"the autopilot has no parameter {name}"
        kind = found[1]
        wire = value if kind == _REAL32 or not self._px4 else _bits(int(value))

        def confirmed() -> bool:
            self.send(m.MAVLink_param_set_message(1, 1, name.encode(), wire, kind))
            time.sleep(0.1)
            return abs(self.parameters[name][0] - value) <= 1e-4 * max(1.0, abs(value))

        wait_until(confirmed, f"{name} is {value:g}", 5.0)

    @property
    def _px4(self) -> bool:
        return self.kind == int(m.MAV_AUTOPILOT_PX4)

    def _results(self, since: int, command: int) -> list[int]:
        return [ack.result for ack in self.acks[since:] if ack.command == command]

    def _hear(self, message: Message, now_s: float) -> None:
        super()._hear(message, now_s)
        name = message.get_type()
        if name == "HEARTBEAT":
            self.kind = message.autopilot
        elif name == "COMMAND_ACK":
            self.acks.append(Ack(now_s, message.command, message.result))
        elif name == "PARAM_VALUE":
            integer = self._px4 and message.param_type != _REAL32
            value = _number(message.param_value) if integer else message.param_value
            self.parameters[message.param_id] = (value, message.param_type)
        if name in self._keep:
            self.heard.append(Heard(now_s, message))


class _Voice(OwnThread):
    """Says what a ground station says again and again."""

    def __init__(self, station: Station) -> None:
        self._station = station
        super().__init__("station")

    def _run(self) -> None:
        beat_s = 0.0
        while not self._stop.wait(STICKS_S):
            station, now_s = self._station, time.monotonic()
            if not station.reached:
                continue
            if station.beating and now_s - beat_s >= BEAT_S:
                beat_s = now_s
                station.send(
                    m.MAVLink_heartbeat_message(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, m.MAV_STATE_ACTIVE, 3)
                )
            if station.sticks:
                sticks = (MIDDLE, MIDDLE, THROTTLE_MIDDLE, MIDDLE)
                station.send(m.MAVLink_manual_control_message(1, *sticks, 0))


def _bits(value: int) -> float:
    """PX4 has the four bytes of an integer in the place of a float's."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def _number(field: float) -> float:
    return float(struct.unpack("<i", struct.pack("<f", field))[0])
