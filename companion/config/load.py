"""Loading the configuration: one YAML file over a preset over the defaults.

Everything that is wrong is reported at once, each problem with the line that holds it.
"""

from __future__ import annotations

import difflib
import json
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails
from ruamel.yaml import YAML
from ruamel.yaml.error import ReusedAnchorWarning, YAMLError
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode

from companion.config.settings import Settings
from companion.errors import InputError

Key = tuple[str, ...]
"""A setting's place: ("control", "margin_m"). Elements of lists stand as "0", "1" ..."""

DEFAULT_PRESET = "flight"
MAX_FILE_BYTES = 100_000  # ten times all settings with their comments; the parser needs seconds for more
MAX_DEPTH = 20
MAX_PROBLEMS = 20  # more than a screen of them helps no one
MAX_SHOWN = 60
LINE_WIDTH = 120

_YAML_TAG = "tag:yaml.org,2002:"
_TEXT_KINDS = ("str", "timestamp", "merge", "value")  # what YAML guesses of plain text is text here
_KINDS = ("map", "seq", "null", "bool", "int", "float", *_TEXT_KINDS)
_EXPECTED = {
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "model_type": "keys and values, indented below it",
    "string_type": "text",
    "tuple_type": "a list",
}
_BOUNDS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
_OUT_OF_RANGE = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")


@dataclass(frozen=True, slots=True)
class Loaded:
    """Effective settings, and the preset that lies below the file."""

    settings: Settings
    preset: str


def preset_names() -> tuple[str, ...]:
    """The presets that ship with the package, sorted."""
    names = (entry.name for entry in (files("companion") / "presets").iterdir())
    return tuple(sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml")))


def load_settings(file: Path | None = None, preset: str | None = None) -> Settings:
    """The effective settings: defaults < preset < file. See `load`."""
    return load(file, preset).settings


def load(file: Path | None = None, preset: str | None = None) -> Loaded:
    """The effective settings and the preset they rest on.

    Args:
        file: a YAML file; an empty one changes nothing. Its top-level key ``preset`` chooses the preset.
        preset: name of a preset; overrides the file's choice. Without any choice it is `DEFAULT_PRESET`.

    Raises:
        InputError: the file cannot be read or used. One line for each problem:
            ``FILE:LINE: key: what is wrong: value, bound; what to do``.
    """
    if preset is not None and preset not in preset_names():
        raise InputError(_unknown_preset(preset))
    source = _Source("", "") if file is None else _Source(_printable(str(file)), _read(file))
    own_preset = source.data.pop("preset", None)
    if own_preset is not None and own_preset not in preset_names():
        source.refuse(("preset",), _unknown_preset(own_preset))
        own_preset = None  # the rest of the file is still checked, over another preset
    name = preset or own_preset or DEFAULT_PRESET
    below = _Source(f"preset {name}", (files("companion") / "presets" / f"{name}.yaml").read_text(encoding="utf-8"))

    merged = _merge(below.data, _without_empty_sections(source.data, Settings))
    try:
        # Strict: "0.5" is no number and 1 is no bool. JSON, because strict Python input wants tuples and enum members.
        settings = Settings.model_validate_json(json.dumps(merged), strict=True)
    except ValidationError as error:
        _explain(error.errors(include_url=False), source, below)
    source.raise_problems()
    return Loaded(settings, name)


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a settings file, for editors that check YAML while it is typed."""
    schema = Settings.model_json_schema()
    preset = {
        "description": "the settings below this file",
        "enum": list(preset_names()),
        "default": DEFAULT_PRESET,
    }
    schema["properties"] = {"preset": preset, **schema["properties"]}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def dump_yaml(settings: Settings) -> str:
    """Every setting as YAML that `load_settings` reads back unchanged, each key with its description."""
    return "\n".join(_dump(settings, indent="")).lstrip("\n") + "\n"


def _dump(model: BaseModel, indent: str) -> Iterator[str]:
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        text = f"{indent}{name}:"
        if isinstance(value, BaseModel):
            yield from ("",) if not indent else ()
            yield from _commented(text, field.description, indent)
            yield from _dump(value, indent + "  ")
        else:
            plain = model.model_dump(mode="json", include={name})[name]
            # JSON is YAML 1.2: the quoting of strings and lists needs no second implementation.
            yield from _commented(f"{text} {json.dumps(plain, ensure_ascii=False)}", field.description, indent)


def _commented(text: str, comment: str | None, indent: str) -> Iterator[str]:
    """The line with its comment behind it, or above it where that would be too long."""
    one_line = f"{text}  # {comment}"
    if comment is None:
        yield text
    elif len(one_line) <= LINE_WIDTH:
        yield one_line
    else:
        mark = f"{indent}# "
        yield from textwrap.wrap(comment, LINE_WIDTH, initial_indent=mark, subsequent_indent=mark)
        yield text


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Both mappings, section by section; where both have a value, the upper one's."""
    merged = dict(below)
    for key, value in above.items():
        lower = merged.get(key)
        merged[key] = _merge(lower, value) if isinstance(lower, dict) and isinstance(value, dict) else value
    return merged


def _without_empty_sections(data: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """A section whose keys are all commented out is null in YAML; it means that nothing is changed there."""
    kept = {}
    for key, value in data.items():
        section = _section(model.model_fields.get(key))
        if section is not None and isinstance(value, dict):
            kept[key] = _without_empty_sections(value, section)
        elif section is None or value is not None:
            kept[key] = value
    return kept


def _section(field: FieldInfo | None) -> type[BaseModel] | None:
    """The model of a field that is a section of its own."""
    kind = field.annotation if field is not None else None
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def _read(file: Path) -> str:
    name = _printable(str(file))
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


class _Source:
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
        shown = ".".join(_short(part) for part in key)
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
            raise InputError(f"{place}: not valid YAML: {_printable(problem)}") from None
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
            self.refuse(key, f"tags such as {_short(kind)} are not used here; remove it")
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
            self.refuse(key, f"text that cannot be stored: {_short(node.value)}; use plain characters")
            return None
        try:
            value = self._yaml.constructor.construct_object(node)
            json.dumps(value)  # an int of thousands of digits fails only when it is written down
        except (LookupError, ValueError):
            self.refuse(key, f"value {_short(node.value)} is not a number, true or false; correct it")
            return None
        return value


def _explain(errors: Iterable[ErrorDetails], source: _Source, below: _Source) -> None:
    """Record what pydantic found in the merged settings, each at the place that its value comes from."""

    def origin(key: Key) -> str:
        if key in source.lines:
            return f"{source.name}:{source.line(key)}"
        return below.name if key in below.lines else "default"

    for error in errors:
        key = tuple(str(part) for part in error["loc"])
        if error["type"] == "settings":
            keys = [tuple(name.split(".")) for name in error["ctx"]["keys"]]
            if ("preset",) not in source.refused:  # else the numbers below the file are not the intended ones
                source.refuse_together(keys, error["msg"], origin)
        elif error["type"] == "extra_forbidden":
            source.refuse(key, _unknown_key(key))
        else:
            source.refuse(key, _bad_value(key, error), origin(key))


def _unknown_preset(name: object) -> str:
    return f"no preset is called {_value(name)}; known: {', '.join(preset_names())}"


def _unknown_key(key: Key) -> str:
    """What may have been meant: the same name in another section, or a similar one in this."""
    *section, name = key
    model = _walk(tuple(section))[0]
    elsewhere = [path for path in _paths(Settings) if path.rpartition(".")[2] == name]
    similar = difflib.get_close_matches(name[:MAX_SHOWN], model.model_fields, n=1)
    if elsewhere or similar:
        return f"unknown key; did you mean {elsewhere[0] if elsewhere else '.'.join((*section, similar[0]))}?"
    return f"unknown key; known here: {', '.join(model.model_fields)}"


def _bad_value(key: Key, error: ErrorDetails) -> str:
    field = _walk(key)[1]
    value = _value(error["input"])
    meaning = f". Meaning: {field.description}" if field is not None and field.description else ""
    if field is not None and error["type"] in _OUT_OF_RANGE:
        bounds = (
            f"{sign} {getattr(limit, name):g}"
            for limit in field.metadata
            for name, sign in _BOUNDS.items()
            if hasattr(limit, name)
        )
        return f"out of range: value {value}, bound {' and '.join(bounds)}; choose a value within it{meaning}"
    expected = _EXPECTED.get(error["type"], error["msg"].removeprefix("Input should be "))
    return f"not usable: value {value}, expected {expected}; correct it{meaning}"


def _walk(key: Key) -> tuple[type[BaseModel], FieldInfo | None]:
    """The innermost section on the way to a key, and the key's field if there is one."""
    model: type[BaseModel] = Settings
    field = None
    for part in key:
        section = _section(field)
        if field is not None and section is None:
            break  # an element of a list: its list is the field
        model = section or model
        field = model.model_fields.get(part)
    return (_section(field) or model), field


def _paths(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, field in model.model_fields.items():
        section = _section(field)
        if section is None:
            yield prefix + name
        else:
            yield from _paths(section, f"{prefix}{name}.")


def _storable(text: str) -> bool:
    """YAML escapes can spell lone surrogates, which no UTF-8 file and no message can hold."""
    return not any("\ud800" <= character <= "\udfff" for character in text)


def _printable(text: str) -> str:
    return text if text.isprintable() else ascii(text)


def _short(text: str) -> str:
    """One line, not too long."""
    return _printable(text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}...")


def _value(value: object) -> str:
    """The value as YAML writes it: text in quotes, so that "1" and 1 differ."""
    return _short(json.dumps(value, ensure_ascii=False))
