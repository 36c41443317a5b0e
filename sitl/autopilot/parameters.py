"""The parameters of an autopilot and the two ways in which an integer travels in a message's float."""

from __future__ import annotations

import enum
import math
import struct
from collections.abc import Mapping

from companion.errors import InputError


class Kind(enum.IntEnum):
    """MAV_PARAM_TYPE of what the two autopilots have."""

    INT8 = 2
    INT16 = 4
    INT32 = 6
    REAL32 = 9


class Encoding(enum.Enum):
    """How an integer travels in the float of PARAM_VALUE and PARAM_SET."""

    BYTEWISE = "the four bytes of the integer, as PX4 does"
    C_CAST = "the number, as ArduPilot does"


_BITS = {Kind.INT8: 8, Kind.INT16: 16, Kind.INT32: 32}


class Parameters:
    """Named numbers with a type, in the order of their names.

    Args:
        defaults: an `int` becomes ``integer`` unless ``kinds`` says otherwise; a `float` becomes REAL32.
        encoding: how integers travel.
        integer: the kind of a plain integer.
        kinds: of integers by their names.
    """

    def __init__(
        self, defaults: Mapping[str, float], encoding: Encoding, integer: Kind, kinds: Mapping[str, Kind]
    ) -> None:
        self._encoding = encoding
        self.names = tuple(sorted(defaults))
        self._values = {name: float(value) for name, value in defaults.items()}
        self._kinds = {
            name: kinds.get(name, integer) if isinstance(value, int) else Kind.REAL32
            for name, value in defaults.items()
        }

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def kind(self, name: str) -> Kind:
        """The type in which the parameter travels."""
        return self._kinds[name]

    def set(self, name: str, value: float) -> None:
        """Sets a parameter from the command line.

        Raises:
            InputError: there is none of that name, or the value is no number or none that its type holds.
        """
        if name not in self._values:
            raise InputError(f"parameter {name}: this autopilot has none of that name")
        if not self._store(name, value):
            raise InputError(f"parameter {name} = {value:g}: does not fit its type {self._kinds[name].name}")

    def encoded(self, name: str) -> float:
        """The value as the float of PARAM_VALUE."""
        value, kind = self._values[name], self._kinds[name]
        if kind is Kind.REAL32 or self._encoding is Encoding.C_CAST:
            return value
        return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])

    def set_encoded(self, name: str, field: float, kind: int) -> bool:
        """Takes the float of a PARAM_SET; False when it cannot be used, and then nothing has changed."""
        if name not in self._values:
            return False
        own = self._kinds[name]
        if self._encoding is Encoding.C_CAST or own is Kind.REAL32:
            # PX4 wants the right type; ArduPilot takes the number whatever type is claimed.
            if self._encoding is Encoding.BYTEWISE and kind != own:
                return False
            return self._store(name, field)
        if kind != own:
            return False
        return self._store(name, float(struct.unpack("<i", struct.pack("<f", field))[0]))

    def _store(self, name: str, value: float) -> bool:
        if not math.isfinite(value):
            return False
        bits = _BITS.get(self._kinds[name])
        if bits is not None:
            value = float(round(value))
            if not -(2 ** (bits - 1)) <= value < 2 ** (bits - 1):
                return False
        else:
            try:
                value = float(struct.unpack("<f", struct.pack("<f", value))[0])
            except OverflowError:
                return False
        self._values[name] = value
        return True
