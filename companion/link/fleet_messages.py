"""What one vehicle tells the others, as bytes: where it is, where it is going, what it knows of the ground.

Whatever carries them may lose, repeat and reorder them: each stands for itself, and the newest counts. They are made of
a header in JSON and of the cells, deflated; everything has a largest size, and what is not of this form is refused.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.control.fleet import Report
from companion.control.ground_grid import MOST_LEVELS
from companion.control.sharing import MOST_TILES, TILE_CELLS, Claim, Frame, GroundNews, Tile
from companion.errors import CompanionError
from companion.model import ABSURD

VERSION = 1
LARGEST_BYTES = 60_000
"""A message fits a datagram."""
LARGEST_HEADER_BYTES = 8_192
LARGEST_NUMBER = 2**53
LEAST_CELL_M, MOST_CELL_M = 0.05, 5.0
FARTHEST_TILE = 10_000

_MAGIC = b"MCFM"
_PREFIX, _CRC = struct.Struct("<4sBH"), struct.Struct("<I")
_BODY_AT = _PREFIX.size + _CRC.size
_CELLS = TILE_CELLS * TILE_CELLS
_LARGEST_BODY_BYTES = LARGEST_HEADER_BYTES + (MOST_TILES + 1) * MOST_LEVELS * _CELLS * 3


class FleetMessageError(CompanionError):
    """These bytes are no message of a vehicle."""


@dataclass(frozen=True, slots=True)
class FleetMessage:
    """What one vehicle tells the others.

    Attributes:
        vehicle: its number in the fleet.
        number: grows with every message of a flight.
        report: where it is, by its own clock.
        claim: where it is going; None: nowhere.
        news: what it knows of the ground; None: nothing new is told.
    """

    vehicle: int
    number: int
    report: Report
    claim: Claim | None = None
    news: GroundNews | None = None

    def encode(self) -> bytes:
        """The message as bytes.

        Raises:
            ValueError: it holds what is no number, or is too large.
        """
        report, claim, news = self.report, self.claim, self.news
        header: dict[str, Any] = {
            "vehicle": self.vehicle,
            "number": self.number,
            "t_s": report.t_s,
            "at_m": [report.x_m, report.y_m, report.z_m],
            "height_m": report.height_m,
            "flies": report.flies,
            "claim": None if claim is None else [claim.x_m, claim.y_m, claim.ground_m, claim.length_m],
        }
        cells = b""
        if news is not None:
            frame = news.frame
            header["ground"] = {
                "frame": [frame.x_m, frame.y_m, frame.z_m, frame.yaw_rad],
                "cell_m": news.cell_m,
                "corner_m": [news.x_m, news.y_m],
                "tiles": [[tile.row, tile.column, len(tile.cells)] for tile in news.tiles],
            }
            cells = b"".join(tile.cells.tobytes() + tile.ground_dm.astype("<i2").tobytes() for tile in news.tiles)
        head = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
        if len(head) > LARGEST_HEADER_BYTES:
            raise ValueError(f"a header of {len(head)} bytes, {LARGEST_HEADER_BYTES} are the most")
        message = framed(len(head), zlib.compress(head + cells, 6))
        if len(message) > LARGEST_BYTES:
            raise ValueError(f"a message of {len(message)} bytes, {LARGEST_BYTES} are the most")
        return message


def framed(length: int, body: bytes) -> bytes:
    """A message of a deflated body that begins with a header of so many bytes.

    The sum of deflate itself takes some bodies for others: cells are small numbers, and there it is weak.
    """
    prefix = _PREFIX.pack(_MAGIC, VERSION, length)
    return b"".join((prefix, _CRC.pack(zlib.crc32(body, zlib.crc32(prefix))), body))


def decode(data: bytes) -> FleetMessage:
    """The message that these bytes are.

    Raises:
        FleetMessageError: they are none.
    """
    try:
        return _decoded(data)
    except (ValueError, TypeError, LookupError, RecursionError, OverflowError, struct.error, zlib.error) as error:
        raise FleetMessageError(f"no message of a vehicle: {error or type(error).__name__}") from None


def _decoded(data: bytes) -> FleetMessage:
    if not _BODY_AT < len(data) <= LARGEST_BYTES:
        raise ValueError(f"{len(data)} bytes")
    magic, version, length = _PREFIX.unpack_from(data)
    if (magic, version) != (_MAGIC, VERSION) or length > LARGEST_HEADER_BYTES:
        raise ValueError(f"begins with {magic!r}, version {version}")
    if data != framed(length, data[_BODY_AT:]):
        raise ValueError("is not what was sent")
    inflate = zlib.decompressobj()
    body = inflate.decompress(data[_BODY_AT:], _LARGEST_BODY_BYTES + 1)
    if not inflate.eof or inflate.unused_data or len(body) > _LARGEST_BODY_BYTES:
        raise ValueError("is cut, or too large")
    header = json.loads(body[:length].decode())
    x_m, y_m, z_m = (_number(value) for value in header["at_m"])
    height_m, claim, ground = header["height_m"], header["claim"], header.get("ground")
    return FleetMessage(
        vehicle=_whole(header["vehicle"], 1, 255),
        number=_whole(header["number"], 0, LARGEST_NUMBER),
        report=Report(
            *(_number(header["t_s"], math.inf), x_m, y_m, z_m),
            height_m=None if height_m is None else _number(height_m),
            flies=_flag(header["flies"]),
        ),
        claim=None if claim is None else _claim(claim),
        news=None if ground is None else _news(ground, body[length:]),
    )


def _claim(values: Any) -> Claim:
    x_m, y_m, ground_m, length_m = (_number(value) for value in values)
    return Claim(x_m, y_m, ground_m, length_m)


def _news(ground: Any, cells: bytes) -> GroundNews:
    x_m, y_m, z_m, yaw_rad = (_number(value) for value in ground["frame"])
    frame = Frame(x_m, y_m, z_m, yaw_rad)
    cell_m = _number(ground["cell_m"])
    if not LEAST_CELL_M <= cell_m <= MOST_CELL_M:
        raise ValueError(f"cells of {cell_m:g} m")
    x_m, y_m = (_number(value) for value in ground["corner_m"])
    if len(ground["tiles"]) > MOST_TILES + 1:
        raise ValueError(f"{len(ground['tiles'])} tiles")
    tiles, at = [], 0
    for one in ground["tiles"]:
        row, column = (_whole(value, -FARTHEST_TILE, FARTHEST_TILE) for value in one[:2])
        levels = _whole(one[2], 1, MOST_LEVELS)
        shape, size = (levels, TILE_CELLS, TILE_CELLS), levels * _CELLS
        # A copy: what is compiled for arrays that may be written to would be compiled anew for others.
        known = np.frombuffer(cells, np.uint8, size, at).reshape(shape).copy()
        ground_dm = np.frombuffer(cells, "<i2", size, at + size).astype(np.int16).reshape(shape)
        tiles.append(Tile(row, column, known, ground_dm))
        at += 3 * size
    if at != len(cells):
        raise ValueError(f"{len(cells)} bytes of cells, {at} are told of")
    return GroundNews(frame, cell_m, x_m, y_m, tuple(tiles))


def _number(value: Any, most: float = ABSURD) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or abs(value) >= most:
        raise ValueError(f"{value!r} is no number")
    return float(value)


def _whole(value: Any, least: int, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"{value!r} is no whole number from {least} to {most}")
    return value


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"{value!r} is neither true nor false")
    return value
