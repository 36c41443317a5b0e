"""Seeds and worlds as people list them: ``20``, ``5..24``, ``1,5,7..9``, ``complex,random:1..20``."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import TypeVar

from companion.config.source import as_yaml
from companion.errors import InputError

MOST = 100_000
"""So many seeds or worlds at most: what is more is a typing error."""

_Item = TypeVar("_Item", int, str)
_RANGE = re.compile(r"(?P<before>[^.]*?)(?P<first>[0-9]{1,9})\.\.(?P<last>[0-9]{1,9})")


def seeds(value: object, place: str) -> tuple[int, ...]:
    """The seeds that a value names: a whole number N for 1 to N, a text with ranges, or a list of both.

    Args:
        value: as read from YAML; texts may hold several, separated by commas.
        place: where it was given, for the message that refuses it.

    Raises:
        InputError: it names no seeds, or one twice.
    """
    if isinstance(value, str) and re.fullmatch("[0-9]{1,9}", value.strip()):
        value = int(value)
    if isinstance(value, int) and not isinstance(value, bool):
        if not 1 <= value <= MOST:
            raise InputError(f"{place}: {value} seeds; give a number from 1 to {MOST}, or a range as in 5..24")
        return tuple(range(1, value + 1))
    found = []
    for text in _items(value, place):
        if not re.fullmatch(r"[0-9]{1,9}", text):
            raise InputError(
                f"{place}: {as_yaml(text)} is no seed; give N for the seeds 1 to N, a range as in 5..24, or a list"
            )
        found.append(int(text))
    return tuple(_once(found, place))


def names(value: object, place: str) -> tuple[str, ...]:
    """The names that a value lists, as texts separated by commas or as a list; ``random:1..20`` is twenty of them.

    Raises:
        InputError: it names none, or one twice.
    """
    return tuple(_once(_items(value, place), place))


def listed(numbers: Iterable[int]) -> str:
    """Numbers as `seeds` reads them, as short as possible."""
    spans: list[tuple[int, int]] = []
    for number in numbers:
        if spans and number == spans[-1][1] + 1:
            spans[-1] = (spans[-1][0], number)
        else:
            spans.append((number, number))
    return ",".join(str(first) if first == last else f"{first}..{last}" for first, last in spans)


def _items(value: object, place: str) -> list[str]:
    listed = value if isinstance(value, list) else [value]
    if not all(isinstance(item, str) or (isinstance(item, int) and not isinstance(item, bool)) for item in listed):
        raise InputError(f"{place}: {as_yaml(value)} cannot be used; give a text, or a list of texts")
    texts = [part.strip() for item in listed for part in str(item).split(",")]
    if not texts or not all(texts):
        raise InputError(f"{place}: something is missing in {as_yaml(value)}; give at least one, with commas between")
    return [item for text in texts for item in _expanded(text, place)]


def _expanded(text: str, place: str) -> Iterator[str]:
    spans = _RANGE.fullmatch(text)
    if spans is None:
        yield text
        return
    first, last = int(spans["first"]), int(spans["last"])
    if not first <= last < first + MOST:
        raise InputError(f"{place}: {as_yaml(text)}: from {first} to {last} are none, or more than {MOST}")
    yield from (f"{spans['before']}{number}" for number in range(first, last + 1))


def _once(items: Iterable[_Item], place: str) -> list[_Item]:
    counted = Counter(items)
    twice = next((item for item, times in counted.items() if times > 1), None)
    if twice is not None:
        raise InputError(f"{place}: {twice} is there twice; no mission is flown twice")
    return list(counted)
