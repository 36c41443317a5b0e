"""What one vehicle tells the others, as bytes."""

from __future__ import annotations

import json
import math
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control.fleet import Report
from companion.control.sharing import MOST_TILES, TILE_CELLS, Claim, Frame, GroundNews, Tile
from companion.link.fleet_messages import LARGEST_BYTES, FleetMessage, FleetMessageError, decode, framed

REPORT = Report(12.5, 1.0, -2.0, 1.5, 1.4)
CLAIM = Claim(10.0, 20.0, -0.5, 33.0)


def tile(row: int, column: int, levels: int = 1, seed: int = 0) -> Tile:
    """Any cells."""
    rng = np.random.default_rng(seed)
    shape = (levels, TILE_CELLS, TILE_CELLS)
    return Tile(row, column, rng.integers(0, 4, shape, np.uint8), rng.integers(-300, 300, shape, np.int16))


NEWS = GroundNews(Frame(1.0, 2.0, 3.0, 0.5), 0.5, -64.0, -32.0, (tile(0, 1), tile(-2, 3, 2, 1)))
WHOLE = FleetMessage(3, 7, REPORT, CLAIM, NEWS)


def same(one: FleetMessage, other: FleetMessage) -> bool:
    """Whether they say the same, cell by cell."""
    if replace(one, news=None) != replace(other, news=None) or (one.news is None) != (other.news is None):
        return False
    if one.news is None or other.news is None:
        return True
    tiles = list(zip(one.news.tiles, other.news.tiles, strict=True))
    return replace(one.news, tiles=()) == replace(other.news, tiles=()) and all(
        a.place == b.place and np.array_equal(a.cells, b.cells) and np.array_equal(a.ground_dm, b.ground_dm)
        for a, b in tiles
    )


@pytest.mark.parametrize(
    "message",
    [
        WHOLE,
        replace(WHOLE, news=None),
        replace(WHOLE, claim=None),
        FleetMessage(255, 0, Report(0.0, 0.0, 0.0, 0.0, None, flies=False)),
    ],
    ids=["whole", "no ground", "no claim", "least"],
)
def test_what_is_told_arrives(message: FleetMessage) -> None:
    """To the last bit of every number and every cell."""
    assert same(decode(message.encode()), message)


def test_the_largest_message_fits_a_datagram() -> None:
    """As many tiles as are told at once, of a mine of two levels that nothing can deflate."""
    tiles = tuple(tile(row, 0, 2, row) for row in range(MOST_TILES + 1))
    message = replace(WHOLE, news=replace(NEWS, tiles=tiles))
    assert len(message.encode()) <= LARGEST_BYTES
    assert same(decode(message.encode()), message)


def test_what_does_not_fit_or_is_no_number_is_not_sent() -> None:
    """The one who sends hears of it, and not the one who reads."""
    for bad in (
        replace(WHOLE, report=replace(REPORT, x_m=math.nan)),
        replace(WHOLE, news=replace(NEWS, tiles=tuple(tile(row, 0, 8, row) for row in range(MOST_TILES + 1)))),
    ):
        with pytest.raises(ValueError, match=r"JSON|bytes"):
            bad.encode()


@given(data=st.binary(max_size=200))
def test_bytes_of_anybody_are_refused(data: bytes) -> None:
    """With one error, whatever they are."""
    with pytest.raises(FleetMessageError):
        decode(data)


@given(at=st.integers(0, 10_000), to=st.integers(0, 255))
def test_a_byte_that_was_changed_is_found(at: int, to: int) -> None:
    """Protects known ground: one byte in 14,000 that were changed passed the sum of deflate, with other cells."""
    data = bytearray(WHOLE.encode())
    at %= len(data)
    before, data[at] = data[at], to
    if before == to:
        assert same(decode(bytes(data)), WHOLE)
        return
    with pytest.raises(FleetMessageError):
        decode(bytes(data))


def made(change: dict[str, Any], cells: bytes = b"", ground: dict[str, Any] | None = None) -> bytes:
    """A message whose header is another one."""
    header: dict[str, Any] = {
        "vehicle": 1,
        "number": 1,
        "t_s": 0.0,
        "at_m": [0.0, 0.0, 0.0],
        "height_m": None,
        "flies": True,
        "claim": None,
    }
    if ground is not None:
        whole = {"frame": [0, 0, 0, 0], "cell_m": 0.5, "corner_m": [0, 0], "tiles": []}
        header["ground"] = whole | ground
    head = json.dumps(header | change).encode()
    return framed(len(head), zlib.compress(head + cells))


def test_the_header_of_these_tests_is_one() -> None:
    """Else each of the following would be refused for another reason."""
    assert decode(made({}, ground={})).news is not None


@pytest.mark.parametrize(
    "change",
    [
        *({"vehicle": value} for value in (0, 256, 1.5, True, "1", None)),
        *({"number": value} for value in (-1, 1.0, 2**60)),
        *({"t_s": value} for value in (math.nan, math.inf, "now", None, True)),
        *({"at_m": value} for value in ([0.0, 0.0], [0.0, 0.0, math.nan], [0.0, 0.0, 1e9], 7, None)),
        {"height_m": math.nan},
        {"flies": 1},
        *({"claim": value} for value in ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0, math.inf], 5)),
    ],
    ids=str,
)
def test_a_header_that_makes_no_sense_is_refused(change: dict[str, Any]) -> None:
    """NaN, what is out of bounds, and what is of another type."""
    with pytest.raises(FleetMessageError):
        decode(made(change))


@pytest.mark.parametrize(
    "ground",
    [
        *({"cell_m": value} for value in (0.0, 0.001, 100.0, math.nan)),
        {"frame": [0, 0, 0]},
        {"frame": [0, 0, 0, math.inf]},
        {"corner_m": [0]},
        {"tiles": [[0, 0, 1]]},
        {"tiles": [[0, 0, 9]]},
        {"tiles": [[10**9, 0, 1]]},
        {"tiles": [[0, 0, 1]] * (MOST_TILES + 2)},
        {"tiles": [7]},
    ],
    ids=str,
)
def test_ground_that_makes_no_sense_is_refused(ground: dict[str, Any]) -> None:
    """Cells that are not there, too many of them, and a grid that nobody has."""
    with pytest.raises(FleetMessageError):
        decode(made({}, ground=ground))


def test_what_inflates_to_more_than_a_message_holds_is_refused() -> None:
    """A few kB that would become gigabytes: no more is inflated than the largest message has."""
    head = b"x" * 100
    data = framed(len(head), zlib.compress(head + bytes(50_000_000), 9))
    assert len(data) <= LARGEST_BYTES
    with pytest.raises(FleetMessageError, match="too large"):
        decode(data)
    with pytest.raises(FleetMessageError, match="told of"):
        decode(made({}, cells=b"more", ground={}))
