"""A value that somebody gave for a campaign, and where: a line of a file, or an option."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from companion.config.source import Key, Source, as_yaml, printable, read_text
from companion.errors import InputError


@dataclass(frozen=True, slots=True)
class Given:
    """A value and its place.

    Attributes:
        value: as read from YAML.
        place: for the message that refuses it: the option, or the file, the line and the key.
        beside: the folder in which relative paths begin.
        source: the file, where it is of one.
        key: its key there.
    """

    value: object
    place: str
    beside: Path = Path()
    source: Source | None = None
    key: Key = ()

    def part(self, name: str) -> Given:
        """What a mapping holds under a name."""
        assert isinstance(self.value, dict)  # noqa: S101 - by `mapping`
        if self.source is None:
            return Given(self.value[name], f"{self.place} {name}", self.beside)
        key = (*self.key, name)
        return Given(self.value[name], _place(self.source, key), self.beside, self.source, key)

    def item(self, number: int) -> Given:
        """An element of a list; of what is no list, the value itself."""
        if not isinstance(self.value, list):
            return self
        value, key = self.value[number], (*self.key, str(number))
        place = self.place if self.source is None else _place(self.source, key)
        return Given(value, place, self.beside, self.source, key)

    def mapping(self, example: str) -> Iterator[tuple[str, Given]]:
        """The parts of a mapping.

        Raises:
            InputError: it is none.
        """
        if not isinstance(self.value, dict):
            raise InputError(f"{self.place}: {as_yaml(self.value)} cannot be used; give names and values: {example}")
        for name in self.value:
            yield name, self.part(name)

    def settings(self, example: str) -> Iterator[tuple[str, Given]]:
        """Full names of settings and what stands there; sections in sections are the same as names with dots."""
        for name, part in self.mapping(example):
            if isinstance(part.value, dict):
                yield from ((f"{name}.{inner}", value) for inner, value in part.settings(example))
            else:
                yield name, part


def of_file(file: Path, known: tuple[str, ...]) -> dict[str, Given]:
    """What a YAML file gives, by its keys.

    Raises:
        InputError: it cannot be read, or has keys that are not known.
    """
    source = Source(printable(str(file)), read_text(file))
    for key in source.data:
        if key not in known:
            source.refuse((key,), f"unknown key; known here: {', '.join(known)}")
    source.raise_problems()
    return {
        key: Given(value, _place(source, (key,)), file.parent, source, (key,))
        for key, value in source.data.items()
        if value is not None
    }


def _place(source: Source, key: Key) -> str:
    return f"{source.name}:{source.line(key)}: {'.'.join(key)}"


def value(text: str, place: str) -> object:
    """The value that a text of an option is in YAML: a number, true or false, a text, or a list in brackets.

    Raises:
        InputError: it is none that a settings file could hold.
    """
    source = Source(place, f"value: {text}")
    source.raise_problems()
    return source.data["value"]
