"""EVENT, the message in which PX4 says what it also says as text: the only one for who is no ground station.

pymavlink's dialects do not hold the message yet, so it is built here: 53 bytes, as MAVLink's common.xml has it. The
number of an event is made of its name, `event_id`; its text is in the metadata that the autopilot is built with.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from sitl.autopilot.mavlink import Message, dialect

EVENT = 410
_FORMAT = struct.Struct("<IIHBBB40B")
_FIELDS = (
    "destination_component", "destination_system", "id", "event_time_boot_ms", "sequence", "log_levels", "arguments",
)  # fmt: skip
_ON_THE_WIRE = (
    "id", "event_time_boot_ms", "sequence", "destination_component", "destination_system", "log_levels", "arguments",
)  # fmt: skip
_AUTOPILOT_COMPONENT = 1
_ARGUMENT_BYTES = 40
FIRST_SEQUENCE = 65535 - 10
"""High, so that whoever counts meets the wrap-around soon."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something to be told: its name in PX4's source, its levels outside and inside, the bytes of its arguments."""

    name: str
    external: int
    internal: int
    arguments: bytes = b""


def event_id(name: str) -> int:
    """The number of an event of the autopilot: 24 bits of FNV-1a (32) of its name, and 1 above them."""
    value = 0x811C9DC5
    for byte in name.encode():
        value = (value ^ byte) * 0x1000193 & 0xFFFFFFFF
    return value & 0xFFFFFF | _AUTOPILOT_COMPONENT << 24


def event_message(event: Event, boot_ms: int, sequence: int) -> Message:
    """The EVENT of an event."""
    arguments = list(event.arguments.ljust(_ARGUMENT_BYTES, b"\0"))
    return _Event(0, 0, event_id(event.name), boot_ms, sequence, event.internal << 4 | event.external, arguments)


def _init(self: Any, *values: Any) -> None:
    dialect.MAVLink_message.__init__(self, EVENT, "EVENT")
    self._fieldnames, self._instance_field, self._instance_offset = list(_FIELDS), None, -1
    for name, value in zip(_FIELDS, values, strict=True):
        setattr(self, name, value)


def _pack(self: Any, mav: Any, force_mavlink1: bool = False) -> bytes:
    *numbers, arguments = (getattr(self, name) for name in _ON_THE_WIRE)
    packed: bytes = self._pack(mav, self.crc_extra, _FORMAT.pack(*numbers, *arguments), force_mavlink1=force_mavlink1)
    return packed


_Event: Any = type(
    "MAVLink_event_message",
    (dialect.MAVLink_message,),
    {
        "id": EVENT,
        "msgname": "EVENT",
        "name": "EVENT",
        "fieldnames": list(_FIELDS),
        "ordered_fieldnames": list(_ON_THE_WIRE),
        "fieldtypes": ["uint8_t", "uint8_t", "uint32_t", "uint32_t", "uint16_t", "uint8_t", "uint8_t"],
        "fielddisplays_by_name": {},
        "fieldenums_by_name": {},
        "fieldunits_by_name": {},
        "native_format": bytearray(b"<IIHBBBB"),
        "orders": [3, 4, 0, 1, 2, 5, 6],
        "lengths": [1, 1, 1, 1, 1, 1, 40],
        "array_lengths": [0, 0, 0, 0, 0, 0, 40],
        "crc_extra": 160,
        "unpacker": _FORMAT,
        "instance_field": None,
        "instance_offset": -1,
        "__init__": _init,
        "pack": _pack,
    },
)
dialect.mavlink_map[EVENT] = _Event
