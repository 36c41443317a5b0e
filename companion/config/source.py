"""One YAML text as plain values that know their lines, and the list of what is wrong with it."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import ReusedAnchorWarning, YAMLError
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode

from companion.errors import InputError

Key = tuple[str, ...]
"""A setting's place: ("control", "margin_m"). Elements of lists stand as "0", "1" ..."""

MAX_FILE_BYTES = 100_000  # ten times all settings with their comments; the parser needs seconds for more
MAX_DEPTH = 20
MAX_PROBLEMS = 20  # more than a screen of them helps no one
MAX_SHOWN = 60

_YAML_TAG = "tag:yaml.org,2002:"
_TEXT_KINDS = ("str", "timestamp", "merge", "value")  # what YAML guesses of plain text is text here
_KINDS = ("map", "seq", "null", "bool", "int", "float", *_TEXT_KINDS)


class Source:
    """One YAML text as plain values, with the line of every key, and everything that is wrong with it.

    Built from the node tree instead of a loader's objects: nodes know their lines, custom tags construct nothing, and
    an alias is seen before it multiplies.
    """

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        self.lines: dict[Key, int] = {}
        self._problems: list[tuple[int, str]] = []
        self.refused: set[Key] = set()
        self._seen: set[int] = set()
        self._yaml = YAML(typ="safe", pure=True)
        value = self._plain(self._compose(text), ())
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

    def _compose(self, text: str) -> Any:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ReusedAnchorWarning)  # harmless where aliases are refused
                return self._yaml.compose(text)
        except YAMLError as error:
            mark = getattr(error, "problem_mark", None)
            place = self.name if mark is None else f"{self.name}:{mark.line + 1}"
            problem = getattr(error, "problem", None) or str(error).splitlines()[0]
            raise InputError(f"{place}: not valid YAML: {printable(problem)}") from None
        except RecursionError:
            raise InputError(f"{self.name}: nested too deeply: this is no settings file") from None
        except (AssertionError, LookupError, ValueError) as error:  # how ruamel.yaml answers an odd %YAML line
            raise InputError(f"{self.name}: not valid YAML: remove the lines that begin with %") from error

    def _plain(self, node: Any, key: Key) -> Any:
        """The node as dicts, lists and scalars; what cannot be used is refused and left out."""
        if node is None:
            return None
        if id(node) in self._seen:
            self.refuse(key, "aliases (*name) are not used here; write the value out")
            return None
        self._seen.add(id(node))
        kind = str(node.tag).removeprefix(_YAML_TAG)
        if kind not in _KINDS:
            self.refuse(key, f"tags such as {short(kind)} are not used here; remove it")
        elif len(key) > MAX_DEPTH:
            self.refuse(key[:1], "nested too deeply; remove the inner levels")
        elif isinstance(node, MappingNode):
            return self._mapping(node, key)
        elif isinstance(node, SequenceNode):
            for index, item in enumerate(node.value):
                self.lines[*key, str(index)] = item.start_mark.line + 1
            return [self._plain(item, (*key, str(index))) for index, item in enumerate(node.value)]
        else:
            return self._scalar(node, kind, key)
        return None

    def _mapping(self, node: MappingNode, key: Key) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for name_node, value_node in node.value:
            line = name_node.start_mark.line + 1
            name = name_node.value if isinstance(name_node, ScalarNode) else None
            if name is None or not _storable(name):
                self.lines.setdefault((*key, "?"), line)
                self.refuse((*key, "?"), "a key must be plain text")
            elif name in values:
                self.refuse((*key, name), f"given twice, again in line {line}; remove one of the two")
            else:
                self.lines[*key, name] = line
                values[name] = self._plain(value_node, (*key, name))
        return values

    def _scalar(self, node: ScalarNode, kind: str, key: Key) -> Any:
        if kind in _TEXT_KINDS:
            if _storable(node.value):
                return node.value
            self.refuse(key, f"text that cannot be stored: {short(node.value)}; use plain characters")
            return None
        try:
            value = self._yaml.constructor.construct_object(node)
            json.dumps(value)  # an int of thousands of digits fails only when it is written down
        except (LookupError, ValueError):
            self.refuse(key, f"value {short(node.value)} is not a number, true or false; correct it")
            return None
        return value


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
        raise InputError(f"{name}: larger than {MAX_FILE_BYTES} bytes: this is no settings file; give another")
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
