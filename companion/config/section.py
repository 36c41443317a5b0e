"""What every section of the configuration has in common."""

from __future__ import annotations

from typing import Any

from annotated_types import DocInfo
from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError


class Section(BaseModel):
    """A frozen group of settings: unknown keys, wrong types, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Take the meanings that a plain class annotates with ``doc`` as the descriptions of the fields."""
        documented = [
            (field, item) for field in cls.model_fields.values() for item in field.metadata if isinstance(item, DocInfo)
        ]
        for field, item in documented:
            field.description = item.documentation
        if documented:
            cls.model_rebuild(force=True)


def refuse(message: str, *keys: str) -> PydanticCustomError:
    """The error of a rule that ties several settings together.

    Args:
        message: what is wrong and what to do, with the values and the bound in it.
        keys: full names of the settings involved, so that the loader can name the line which holds them.
    """
    return PydanticCustomError("settings", "{message}", {"message": message, "keys": list(keys)})
