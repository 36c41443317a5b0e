"""What pydantic found wrong, said to people: where the value comes from, what is wrong with it, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from companion.config.settings import Settings
from companion.config.source import MAX_SHOWN, Key, Source, as_yaml

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


def explain(errors: Iterable[ErrorDetails], source: Source, below: Source) -> None:
    """Record what pydantic found in the merged settings, each at the place that its value comes from.

    Args:
        errors: of `Settings`, validated from the file merged over its preset.
        source: the file, which takes the messages.
        below: the preset.
    """

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


def section_of(field: FieldInfo | None) -> type[BaseModel] | None:
    """The model of a field that is a section of its own."""
    kind = field.annotation if field is not None else None
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


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
    value = as_yaml(error["input"])
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
        section = section_of(field)
        if field is not None and section is None:
            break  # an element of a list: its list is the field
        model = section or model
        field = model.model_fields.get(part)
    return (section_of(field) or model), field


def _paths(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, field in model.model_fields.items():
        section = section_of(field)
        if section is None:
            yield prefix + name
        else:
            yield from _paths(section, f"{prefix}{name}.")
