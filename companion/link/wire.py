"""What goes over the link as bytes: JSON of the words, checked when it is read: it may be anybody's.

A message that is not as it should be is a `WireError`, and never anything else.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from companion.errors import CompanionError
from companion.link.words import Answer, Command, Telemetry

MOST_BYTES = 64_000
"""Of a message that is read, the map's aside: the largest that is written has a tenth of that."""

_PREFIX = "companion/1"


class WireError(CompanionError):
    """Bytes that came over the link are no message of it."""


class RefusedError(Exception):
    """What came is not obeyed, or not believed, and why."""


@dataclass(frozen=True, slots=True)
class Report:
    """Telemetry as it goes over the link.

    Attributes:
        session: drawn anew each time that the vehicle's process of the link starts; commands must quote it.
        clock_s: of that process, when this was sent. Commands quote it too: an age is told on one clock only.
        map: the name of the folder that its map is in.
        drawing: number of the newest graph and frontiers; grows.
        telemetry: of the flight.
    """

    session: str
    clock_s: float
    map: str
    drawing: int
    telemetry: Telemetry


@dataclass(frozen=True, slots=True)
class Order:
    """A command as it goes over the link.

    Attributes:
        id: drawn by the sender; the same for each attempt to have it obeyed.
        attempt: counts from 1. The same attempt twice is a replay.
        vehicle: whom it is for.
        session: of that vehicle's link, from its telemetry.
        clock_s: the vehicle's own clock when it was given, as the sender reckons it from the newest telemetry.
        command: what is asked.
        by: who asks.
    """

    id: str
    attempt: int
    vehicle: str
    session: str
    clock_s: float
    command: Command
    by: str


@dataclass(frozen=True, slots=True)
class SignedOrder:
    """An order with what proves who gave it.

    Attributes:
        order: `encoded` text of an `Order`: what is signed.
        certificate: of the sender, PEM; empty on loopback without certificates.
        signature: of the text, hexadecimal; likewise.
    """

    order: str
    certificate: str = ""
    signature: str = ""


T = TypeVar("T", Report, Order, SignedOrder, Answer, Telemetry)
_ADAPTERS: dict[type[Any], TypeAdapter[Any]] = {
    kind: TypeAdapter(kind) for kind in (Report, Order, SignedOrder, Answer, Telemetry)
}


def telemetry_topic(vehicle: str) -> str:
    """Where a vehicle tells its telemetry; of all vehicles with ``*``."""
    return f"{_PREFIX}/{vehicle}/telemetry"


def command_topic(vehicle: str) -> str:
    """Where a vehicle takes commands."""
    return f"{_PREFIX}/{vehicle}/command"


def fleet_topic(vehicle: str) -> str:
    """Where a vehicle tells the others where it is; of all vehicles with ``*``."""
    return f"{_PREFIX}/{vehicle}/fleet"


def vehicle_of(topic: str) -> str:
    """Whose topic it is."""
    return topic.removeprefix(f"{_PREFIX}/").partition("/")[0]


def map_topic(vehicle: str) -> str:
    """Where a vehicle is asked for its map."""
    return f"{_PREFIX}/{vehicle}/map"


def encoded(message: T) -> bytes:
    """A message as bytes.

    Raises:
        ValueError: a number in it is not finite.
    """
    plain = asdict(message, dict_factory=_without_enums)
    return json.dumps(plain, allow_nan=False, separators=(",", ":")).encode()


def decoded(kind: type[T], data: bytes) -> T:
    """The message that some bytes say.

    Raises:
        WireError: they say none.
    """
    if len(data) > MOST_BYTES:
        raise WireError(f"a message of {len(data)} bytes, more than {MOST_BYTES}")
    try:
        message: T = _ADAPTERS[kind].validate_json(data, strict=True)
    except ValidationError as error:
        raise WireError(f"no {kind.__name__}: {error.errors(include_url=False)[0]['msg']}") from None
    if not _is_finite(message):
        raise WireError(f"no {kind.__name__}: a number is not finite")
    return message


def _without_enums(items: list[tuple[str, Any]]) -> dict[str, Any]:
    return {name: value.value if isinstance(value, Command) else value for name, value in items}


def _is_finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, tuple):
        return all(map(_is_finite, value))
    if is_dataclass(value):
        return all(_is_finite(getattr(value, field.name)) for field in fields(value))
    return True
