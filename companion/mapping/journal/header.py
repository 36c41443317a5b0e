"""What a map is: the first thing in each file of a journal, so that any one of them can be understood alone."""

from __future__ import annotations

import json
import math
import struct
import zlib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from companion.config.mapping import MapSettings
from companion.errors import CompanionError
from companion.mapping.voxels.sensor_model import steps_of

MAGIC = b"voxelog\n"
VERSION = 1

_FRONT = struct.Struct("<8sIII")
"""Magic, version, bytes of JSON that follow, and a CRC of all but itself. No version may change this layout."""

_LONGEST_BYTES = 1 << 20
_FIXED = ("voxel_m", "threshold", "lowest", "highest", "frame")
"""What must be the same for two maps to be one."""


class JournalError(CompanionError):
    """A journal cannot be opened: it is no journal, of another map, newer than this program, or in use."""


@dataclass(frozen=True, slots=True)
class Header:
    """What a map is.

    Attributes:
        voxel_m: edge of a voxel.
        threshold: a voxel is occupied from this value on, in thousandths of log-odds.
        lowest: lower clamp of a voxel's value.
        highest: upper clamp.
        frame: what the axes are, such as "east-north-up from the place of take-off".
        settings: what else a reader may want to know: settings of the map, vehicle, date. Must fit into JSON.
    """

    voxel_m: float
    threshold: int
    lowest: int
    highest: int
    frame: str
    settings: dict[str, object] = field(default_factory=dict)

    @classmethod
    def of(cls, settings: MapSettings, frame: str = "east-north-up") -> Header:
        """The header of a map with these settings."""
        steps = steps_of(settings)
        return cls(settings.voxel_m, steps.threshold, steps.lowest, steps.highest, frame, settings.model_dump())

    def differences(self, other: Header) -> list[str]:
        """What keeps a map with this header from being continued with the other, in words; empty when nothing does."""
        mine, theirs = asdict(self), asdict(other)
        return [f"{name} is {mine[name]}, not {theirs[name]}" for name in _FIXED if mine[name] != theirs[name]]


def prologue(header: Header) -> bytes:
    """What a segment begins with: the header twice, so that no single damaged place can hide what the map is."""
    text = json.dumps(asdict(header), sort_keys=True).encode()
    if len(text) > _LONGEST_BYTES:
        raise ValueError(f"the header has {len(text)} bytes, more than {_LONGEST_BYTES}: put less into its settings")
    crc = zlib.crc32(text, zlib.crc32(_FRONT.pack(MAGIC, VERSION, len(text), 0)))
    return 2 * (_FRONT.pack(MAGIC, VERSION, len(text), crc) + text)


def read_prologue(data: bytes, path: Path) -> tuple[Header | None, int]:
    """The header at the front of a segment, None if both copies are damaged, and where the records begin.

    Raises:
        JournalError: it was written by a newer version, or is no header of a map.
    """
    at = 0
    for _ in range(2):
        at = data.find(MAGIC, at, 2 * _LONGEST_BYTES)
        if at < 0:
            break
        text = _checked(data, at, path)
        if text is not None:
            size = _FRONT.size + len(text)
            return _parsed(text, path), (2 * size if at == 0 else at + size)
        at += 1
    return None, 0


def is_unfinished(data: bytes, begin: int) -> bool:
    """Whether a segment without records is as a crash leaves it that interrupts the making of the file.

    Args:
        data: the whole file.
        begin: where `read_prologue` says that its records begin.
    """
    if begin > 0:
        return begin > len(data)
    return not any(data) or data[: len(MAGIC)] == MAGIC[: len(data)]


def _checked(data: bytes, at: int, path: Path) -> bytes | None:
    if len(data) < at + _FRONT.size:
        return None
    magic, version, size, crc = _FRONT.unpack_from(data, at)
    text = data[at + _FRONT.size : at + _FRONT.size + min(size, _LONGEST_BYTES)]
    if len(text) != size or crc != zlib.crc32(text, zlib.crc32(_FRONT.pack(magic, version, size, 0))):
        return None
    if version > VERSION:
        raise JournalError(
            f"{path}: written by a newer version of this program (format {version}, known: {VERSION}); use that version"
        )
    return text


def _parsed(text: bytes, path: Path) -> Header:
    try:
        values: dict[str, Any] = json.loads(text)
        header = Header(
            float(values["voxel_m"]),
            int(values["threshold"]),
            int(values["lowest"]),
            int(values["highest"]),
            str(values["frame"]),
            dict(values["settings"]),
        )
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise JournalError(f"{path}: its header is not that of a map ({error!r}); another program wrote it") from None
    if not (math.isfinite(header.voxel_m) and header.voxel_m > 0.0):
        raise JournalError(f"{path}: voxel_m is {header.voxel_m}, must be above 0; another program wrote it")
    return header
