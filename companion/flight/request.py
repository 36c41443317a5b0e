"""The request to the application, and the sealed memory in which it is handed over.

Not a file: a configuration that is edited while the vehicle flies changes nothing, also when the application has to be
started again.
"""

from __future__ import annotations

import fcntl
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from companion.config.settings import Settings
from companion.errors import InputError

_SEALS = fcntl.F_SEAL_WRITE | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL
Start = Literal["now", "key", "command"]


@dataclass(frozen=True, slots=True)
class FlightRequest:
    """One flight, or one pre-flight check, as a person has asked for it.

    Attributes:
        what: to fly, or only to check.
        settings: the whole configuration.
        preset: the name of the one below it, for the records.
        seed: draws every choice of the navigator; None draws a new one, which is recorded.
        fix: whether pre-flight may set parameters of the autopilot.
        skip: names of checks to skip, besides those in the settings.
        resume_map: the folder of an earlier flight whose map goes on, from the same start of the autopilot; the map
            stays in that folder.
    """

    what: Literal["run", "check"]
    settings: Settings
    preset: str
    seed: int | None = None
    fix: bool = False
    skip: tuple[str, ...] = ()
    resume_map: Path | None = None

    def started_by(self, start: Start) -> FlightRequest:
        """The same with another ``mission.start``."""
        mission = self.settings.mission.model_copy(update={"start": start})
        return replace(self, settings=self.settings.model_copy(update={"mission": mission}))

    def sealed(self) -> int:
        """A file descriptor for the application, from which `unsealed` reads this request."""
        return sealed("companion-request", _REQUEST.dump_json(self).decode())

    @classmethod
    def unsealed(cls, number: int) -> FlightRequest:
        """The request that was handed over.

        Raises:
            InputError: this file descriptor holds none.
        """
        try:
            return _REQUEST.validate_json(unsealed(number), strict=True)
        except ValidationError as error:
            raise InputError(f"what was handed over in file descriptor {number} is no request: {error}") from None


_REQUEST = TypeAdapter(FlightRequest)


def sealed(name: str, text: str) -> int:
    """A file descriptor, inherited by the processes that follow, from which this text can be read and nothing else."""
    # Without MFD_CLOEXEC: that it is inherited is what it is for.
    number = os.memfd_create(name, os.MFD_ALLOW_SEALING)
    with os.fdopen(number, "wb", closefd=False) as file:
        file.write(text.encode())
    fcntl.fcntl(number, fcntl.F_ADD_SEALS, _SEALS)
    return number


def unsealed(number: int) -> str:
    """What was handed over. It can be read again by whoever is started next: nothing is used up.

    Raises:
        InputError: this file descriptor holds nothing that was handed over.
    """
    try:
        if fcntl.fcntl(number, fcntl.F_GET_SEALS) & _SEALS != _SEALS:
            raise OSError("it is not sealed")
        return os.pread(number, os.fstat(number).st_size, 0).decode()
    except (OSError, OverflowError, ValueError) as error:
        raise InputError(
            f"nothing was handed over in file descriptor {number} ({error}): start with `companion run`"
        ) from None
