"""Values and bytes that nobody should send, drawn from a seed."""

from __future__ import annotations

import copy
import math
import random
from collections.abc import Callable, Mapping
from typing import Any

TEXTS = (
    "",
    "\0",
    "a" * 70_000,
    "\ud800 a lone surrogate",
    "\x1b[2J\x1b]0;the title\x07",
    "\u202e backwards\r\n\t",
    "1.0",
    "nan",
    "[red]{}%s%n",
)
NO_NUMBERS: tuple[object, ...] = (
    None,
    math.nan,
    math.inf,
    -math.inf,
    *TEXTS,
    b"bytes",
    [],
    [1.0, 2.0],
    {},
    {"a": None},
    (),
    10**400,
    -(10**400),
    1e300,
    -1e300,
    True,
    False,
    1j,
    object(),
)
"""What is never the number that a field should hold."""
NUMBERS = (
    0,
    1,
    -1,
    255,
    65535,
    2**31 - 1,
    -(2**31),
    2**32 - 1,
    2**63 - 1,
    -(2**63),
    0.0,
    -0.0,
    1e-45,
    1e-320,
    3.4e38,
    1e6,
)
"""What a field may hold, though rarely does."""


class Missing:
    """Stands for a field that is not there."""


def no_number(rng: random.Random) -> object:
    """Anything but a number that a message may hold; `Missing` for nothing at all."""
    return rng.choice((*NO_NUMBERS, Missing))


def extreme(rng: random.Random, like: object) -> object:
    """A number of the same type, anywhere in its range, or a text."""
    if isinstance(like, str):
        return rng.choice(TEXTS)
    if isinstance(like, list):
        return [extreme(rng, like[0]) for _ in range(rng.choice((0, 1, len(like), 10 * len(like))))]
    if isinstance(like, int):
        return rng.choice((rng.getrandbits(8), rng.getrandbits(32), int(rng.choice(NUMBERS))))
    return rng.choice(
        (math.nan, rng.uniform(-7.0, 7.0), rng.uniform(-1e6, 1e6), 10.0 ** rng.uniform(-40, 38), *NUMBERS)
    )


def without_sense(rng: random.Random, fields: Mapping[str, Any], needed: tuple[str, ...]) -> dict[str, Any]:
    """The message with at least one of the fields that it needs made unusable."""
    spoiled = copy.deepcopy(dict(fields))
    for name in rng.sample(needed, rng.randint(1, len(needed))):
        spoiled[name] = no_number(rng)
    return {name: value for name, value in spoiled.items() if value is not Missing}


def spoiled(rng: random.Random, data: bytes) -> bytes:
    """Bytes with one thing wrong: cut, one bit, a stretch overwritten, left out, repeated or put in."""
    at, length = rng.randrange(len(data)), min(rng.choice((1, 4, 8, 16, 200)), len(data))
    ways: tuple[Callable[[], bytes], ...] = (
        lambda: data[:at],
        lambda: data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :],
        lambda: data[:at] + rng.randbytes(length) + data[at + length :],
        lambda: data[:at] + rng.choice((b"\xff", b"\0", b"\x7f", b"\x80")) * length + data[at + length :],
        lambda: data[:at] + data[at + length :],
        lambda: data[:at] + data[at : at + length] * rng.choice((2, 3, 50)) + data[at + length :],
        lambda: data[:at] + rng.randbytes(length) + data[at:],
    )
    return rng.choice(ways)()


def spoiled_often(rng: random.Random, data: bytes) -> bytes:
    """Several things wrong at once."""
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        data = spoiled(rng, data) or b"\0"
    return data


def spoiled_json(rng: random.Random, value: Any) -> Any:
    """A JSON value with one leaf or branch replaced, left out or repeated."""
    value = copy.deepcopy(value)
    parent: Any = None
    key: Any = None
    here = value
    while isinstance(here, (dict, list)) and here and (parent is None or rng.random() < 0.75):
        parent, key = here, rng.choice(list(here) if isinstance(here, dict) else range(len(here)))
        here = parent[key]
    if parent is None:
        return rng.choice((None, 3, [], {}, "text"))
    if rng.random() < 0.15:
        del parent[key]
    elif rng.random() < 0.2 and isinstance(parent, list):
        parent.extend(parent[:1] * rng.choice((1, 100)))
    else:
        parent[key] = rng.choice(
            (
                None,
                True,
                0,
                -1,
                10**400,
                2**64,
                1e300,
                -1e300,
                1e-300,
                "nan",
                "inf",
                "-inf",
                "",
                "\ud800",
                [],
                {},
                [[]],
                1e5,
            )
        )
    return value
