"""What every section of the configuration has in common."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError


class Section(BaseModel):
    """A frozen group of settings: unknown keys, wrong types, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)


def refuse(message: str, *keys: str) -> PydanticCustomError:
    """The error of a rule that ties several settings together.

    Args:
        message: what is wrong and what to do, with the values and the bound in it.
        keys: full names of the settings involved, so that the loader can name the line which holds them.
    """
    return PydanticCustomError("settings", "{message}", {"message": message, "keys": list(keys)})
