"""One YAML text as plain values that know their lines, and the list of what is wrong with it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import yaml

from companion.errors import InputError

Key = tuple[str, ...]
"""A setting's place: ("control", "margin_m"). Elements of lists stand as "0", "1" ..."""

MAX_FILE_BYTES = 100_000  # ten times all settings with their comments; the parser needs seconds for more
_TOO_LARGE = f"larger than {MAX_FILE_BYTES} bytes: this is no settings file; give another"
MAX_DEPTH = 20
MAX_PROBLEMS = 20  # more than a screen of them helps no one
MAX_SHOWN = 60

_YAML_TAG = "tag:yaml.org,2002:"
_SCALARS: dict[str, tuple[re.Pattern[str], Callable[[str], Any]]] = {
    "null": (re.compile("~|null|Null|NULL|"), lambda _: None),
    "bool": (re.compile("true|True|TRUE|false|False|FALSE"), lambda text: text.lower() == "true"),
    "int": (
        re.compile("[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+"),
        lambda text: int(text, {"0o": 8, "0x": 16}.get(text[:2], 10)),
    ),
    "float": (
        re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"),
        lambda text: float(text if text[-1] in "0123456789." else text.replace(".", "")),
    ),
}
"""The core schema of YAML 1.2.2, section 10.3.2: what plain text can be beside text, in this order.

By it ``no``, ``off``, ``1_000``, ``0b11``, ``1:30`` and ``2001-12-14`` are text, ``017`` is 17, ``0o17`` is 15 and
``1e3`` is 1000.0. Of these PyYAML's own YAML 1.1 makes false, false, 1000, 3, 90, a date, 15 and twice text.
"""

_TAGS = {yaml.ScalarEvent: ("str", *_SCALARS), yaml.SequenceStartEvent: ("seq",), yaml.MappingStartEvent: ("map",)}
"""The tags that say no more than what a value is anyway."""

_OTHER_LINE_ENDS = re.compile("[\x85\u2028\u2029]")
"""They end a line for PyYAML and for no editor: what looks like a comment would be read as a setting."""


class Source:
    """One YAML text as plain values, with the line of every key, and everything that is wrong with it.

    Built from the parser's events instead of a loader's objects: events know their lines, tags construct nothing, an
    alias is seen before it multiplies, and nesting ends before it costs anything.

    Raises:
        InputError: it is not valid YAML, or no mapping.
    """

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        self.lines: dict[Key, int] = {}
        self._problems: list[tuple[int, str]] = []
        self.refused: set[Key] = set()
        value = self._document(text)
        if value is not None and not isinstance(value, dict):
            raise InputError(f"{name}:1: the file must hold sections such as 'control:' with keys indented below them")
        self.data: dict[str, Any] = value or {}

    def refuse(self, key: Key, message: str, place: str | None = None) -> None:
        """Record what is wrong with a key and what to do; of one key, only the first.

        The place is where the value comes from, by default the line of the key in this file.
        """
        if key in self.refused:
            return
        self.refused.add(key)
        line = self.line(key)
        shown = ".".join(short(part) for part in key)
        self._problems.append((line, ": ".join(filter(None, (place or f"{self.name}:{line}", shown, message)))))

    def refuse_together(self, keys: Sequence[Key], message: str, origin: Callable[[Key], str]) -> None:
        """Record a rule that ties several keys together and is broken, at the first of them that the file sets."""
        first = next((key for key in keys if key in self.lines), keys[0])
        origins = ", ".join(f"{'.'.join(key)}: {origin(key)}" for key in keys)
        self._problems.append((self.line(first), f"{origin(first)}: {message} [{origins}]"))

    def line(self, key: Key) -> int:
        """Line of the key, or of the nearest section around it, or 1."""
        return next((self.lines[key[:n]] for n in range(len(key), 0, -1) if key[:n] in self.lines), 1)

    def raise_problems(self) -> None:
        """Raise one `InputError` with every problem, in the order of the lines, if there is any."""
        if not self._problems:
            return
        messages = [message for _, message in sorted(self._problems, key=lambda problem: problem[0])]
        more = [f"{self.name}: and {len(messages) - MAX_PROBLEMS} more"] if len(messages) > MAX_PROBLEMS else []
        raise InputError("\n".join(messages[:MAX_PROBLEMS] + more))

    def _document(self, text: str) -> Any:
        """The one document of the text as dicts, lists and scalars; None when there is none."""
        if len(text) > MAX_FILE_BYTES:
            raise InputError(f"{self.name}: {_TOO_LARGE}")
        if odd := _OTHER_LINE_ENDS.search(text):
            line = text.count("\n", 0, odd.start()) + 1
            escape = ascii(odd[0])[1:-1]
            raise InputError(f"{self.name}:{line}: not usable: a line separator; remove it or write {escape}")
        try:
            self._events: Iterator[yaml.Event] = yaml.parse(text, Loader=yaml.SafeLoader)
            next(self._events)  # the stream begins
            start = next(self._events)
            if not isinstance(start, yaml.DocumentStartEvent):
                return None
            if start.version not in (None, (1, 2)):
                self._fail(start, "another version of YAML than 1.2; remove the line that begins with %YAML")
            value = self._value(next(self._events), ())
            next(self._events)  # the document ends
            if isinstance(another := next(self._events), yaml.DocumentStartEvent):
                self._fail(another, "a second document begins here; a settings file holds one")
        except yaml.MarkedYAMLError as error:
            place = "" if error.problem_mark is None else f":{error.problem_mark.line + 1}"
            raise InputError(f"{self.name}{place}: not valid YAML: {printable(error.problem or str(error))}") from None
        except yaml.reader.ReaderError as error:
            line = text.count("\n", 0, error.position) + 1
            raise InputError(f"{self.name}:{line}: not valid YAML: {str(error).splitlines()[0]}") from None
        except ValueError as error:  # how PyYAML answers the escape of a character that does not exist
            raise InputError(f"{self.name}: not valid YAML: {printable(str(error))}") from error
        return value

    def _fail(self, event: yaml.Event, message: str) -> NoReturn:
        raise InputError(f"{self.name}:{_line(event)}: {message}")

    def _value(self, event: yaml.Event, key: Key) -> Any:
        """What the event begins; what cannot be used is refused and left out."""
        if len(key) > MAX_DEPTH:
            self._fail(event, f"nested too deeply, more than {MAX_DEPTH} levels; remove the inner ones")
        if isinstance(event, yaml.AliasEvent):
            self.refuse(key, "aliases (*name) are not used here; write the value out")
            return None
        assert isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent)  # noqa: S101 - by YAML's grammar
        kind = (event.tag or "").removeprefix(_YAML_TAG)
        if kind not in ("", "!", *_TAGS[type(event)]):
            self.refuse(key, f"tags such as {short(kind)} are not used here; remove it")
            self._skip(event)
            return None
        if isinstance(event, yaml.ScalarEvent):
            return self._scalar(event, kind, key)
        return self._mapping(key) if isinstance(event, yaml.MappingStartEvent) else self._sequence(key)

    def _skip(self, event: yaml.Event) -> None:
        """Pass over everything that the event begins."""
        depth = 0
        while True:
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                self._fail(event, f"nested too deeply, more than {MAX_DEPTH} levels; remove the inner ones")
            if depth == 0:
                return
            event = next(self._events)

    def _sequence(self, key: Key) -> list[Any]:
        values: list[Any] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            item = (*key, str(len(values)))
            self.lines[item] = _line(event)
            values.append(self._value(event, item))
        return values

    def _mapping(self, key: Key) -> dict[str, Any]:
        values: dict[str, Any] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            line = _line(event)
            name = event.value if isinstance(event, yaml.ScalarEvent) else None
            if name is None or not _storable(name):
                self.lines.setdefault((*key, "?"), line)
                self.refuse((*key, "?"), "a key must be plain text")
                self._skip(event)
                self._skip(next(self._events))
            elif name in values:
                self.refuse((*key, name), f"given twice, again in line {line}; remove one of the two")
                self._skip(next(self._events))
            else:
                self.lines[*key, name] = line
                values[name] = self._value(next(self._events), (*key, name))
        return values

    def _scalar(self, event: yaml.ScalarEvent, kind: str, key: Key) -> Any:
        text: str = event.value
        if event.implicit[0]:  # plain text without a tag
            kind = next((kind for kind, (form, _) in _SCALARS.items() if form.fullmatch(text)), "")
        if kind not in _SCALARS:
            if _storable(text):
                return text
            self.refuse(key, f"text that cannot be stored: {short(text)}; use plain characters")
            return None
        form, convert = _SCALARS[kind]
        try:
            if form.fullmatch(text):
                value = convert(text)
                json.dumps(value)  # an int of thousands of digits fails only when it is written down
                return value
        except ValueError:
            pass
        self.refuse(key, f"value {short(text)} is not a number, true or false; correct it")
        return None


def _line(event: yaml.Event) -> int:
    assert event.start_mark is not None  # noqa: S101 - the parser marks every event
    return event.start_mark.line + 1


def read_text(file: Path) -> str:
    """The text of a settings file.

    Raises:
        InputError: it cannot be read, is too large, or is not UTF-8.
    """
    name = printable(str(file))
    try:
        with file.open("rb") as stream:
            # One byte more than allowed is enough to know, even of an endless device.
            content = stream.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError:
        raise InputError(f"{name}: no such file; check the path") from None
    except IsADirectoryError:
        raise InputError(f"{name}: is a folder; give the YAML file in it") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise InputError(f"{name}: cannot be read: {reason}") from error
    if len(content) > MAX_FILE_BYTES:
        raise InputError(f"{name}: {_TOO_LARGE}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(f"{name}:{line}: not UTF-8 text: byte {error.start}; save the file as UTF-8") from None


def _storable(text: str) -> bool:
    """YAML escapes can spell lone surrogates, which no UTF-8 file and no message can hold."""
    return not any("\ud800" <= character <= "\udfff" for character in text)


def printable(text: str) -> str:
    """The text itself, or with escapes where a terminal could not show it."""
    return text if text.isprintable() else ascii(text)


def short(text: str) -> str:
    """The text on one line, not too long."""
    return printable(text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}...")


def as_yaml(value: object) -> str:
    """The value as YAML writes it, not too long: text in quotes, so that "1" and 1 differ."""
    return short(json.dumps(value, ensure_ascii=False))
