"""The ground's map follows the vehicle's, whatever happens to the link and to either side."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from companion.link.map_wire import BUCKETS, Ask, Told, answer, asked, bits_of, read_answer, read_ask, read_bits
from companion.link.wire import WireError
from companion.mapping.voxels.chunks import keys_of
from companion.mapping.voxels.lookup import OCCUPIED, states_of
from tests.link.exchange import Exchange, Mine
from tests.mapping.journal.journals import HEADER, alike, piece


@pytest.fixture
def mine(tmp_path: Path) -> Mine:
    return Mine(tmp_path / "vehicle")


@pytest.fixture
def exchange(tmp_path: Path, mine: Mine) -> Exchange:
    return Exchange(tmp_path / "ground", mine)


def test_the_copy_is_the_map_bit_for_bit(exchange: Exchange, mine: Mine) -> None:
    for _ in range(20):
        mine.grow()
        exchange.until_equal()
        exchange.assert_equal()


def test_loss_outage_and_restarts_of_both_sides_leave_no_difference(exchange: Exchange, mine: Mine) -> None:
    """The issue's worst day: a third of everything lost, nothing for a minute, twice, and both begin anew."""
    exchange.loss = 0.3
    for step in range(60):
        mine.grow()
        exchange.follow()
        if step in (20, 40):
            exchange.clock.advance(60.0)
        elif not 20 < step < 26:
            exchange.once()
        if step in (10, 30):
            exchange.restart_ground()
        if step in (15, 45):
            exchange.restart_vehicle()
    exchange.until_equal()
    exchange.assert_equal()
    assert exchange.sync.age_s == 0.0


def test_a_restart_sends_little_again(exchange: Exchange, mine: Mine) -> None:
    """Protects a thin link: after a restart of either side only parts that differ go over."""
    for _ in range(100):
        mine.grow()
    exchange.until_equal()
    whole_bytes, exchange.sent_bytes = exchange.sent_bytes, 0
    exchange.restart_vehicle()
    exchange.until_equal()
    exchange.restart_ground()
    exchange.until_equal()
    assert exchange.sent_bytes < 2 * (8 * BUCKETS + 2000), "two times the sums, and no chunk"
    mine.grow(2)
    exchange.restart_vehicle()
    exchange.until_equal()
    exchange.assert_equal()
    assert exchange.sent_bytes < 0.2 * whole_bytes


def test_what_compaction_rewrites_is_not_sent_again(exchange: Exchange, mine: Mine) -> None:
    for _ in range(60):
        mine.grow()
    exchange.until_equal()
    before = exchange.sent_bytes
    mine.journal.append(piece({(0, 0, 0): alike(5)}))
    for _ in range(40):
        mine.journal.append(piece({(0, 0, 0): alike(5), (0, 0, 1): alike(6)}))
        mine.journal.compact_step(1.0)
        mine.journal.commit()
    exchange.until_equal()
    exchange.assert_equal()
    assert exchange.sent_bytes - before < 5_000


def test_each_chunk_goes_over_in_its_newest_state_only(exchange: Exchange, mine: Mine) -> None:
    """Protects a thin link from the past: what changed a hundred times in an outage is sent once."""
    mine.grow(1)
    exchange.until_equal()
    before = exchange.sent_bytes
    for value in range(100):
        mine.journal.append(piece({(9, 9, 9): alike(value + 1)}))
        exchange.follow()
    exchange.until_equal()
    exchange.assert_equal()
    assert exchange.sent_bytes - before < 1_000


def test_a_map_that_lost_its_end_is_followed_too(tmp_path: Path) -> None:
    """After a power failure the vehicle's map has less than the ground has seen: the vehicle is right."""
    mine = Mine(tmp_path / "vehicle")
    mine.grow()
    (segment,) = (mine.folder / "map.journal").glob("*.segment")
    size = segment.stat().st_size
    mine.journal.append(piece({(50, 0, 0): alike(7)}))
    exchange = Exchange(tmp_path / "ground", mine)
    exchange.until_equal()
    number = exchange.sync.number
    mine.journal.close()
    os.truncate(segment, size)
    mine.__init__(tmp_path / "vehicle")  # type: ignore[misc]
    exchange.restart_vehicle()
    exchange.until_equal()
    exchange.assert_equal()
    assert exchange.sync.number > number, "whoever draws it has to begin anew"
    assert list((tmp_path / "ground").glob("*/earlier-1-map.journal")), "what the ground had is kept"


def test_the_age_of_the_map_is_that_of_the_oldest_change_that_is_missing(exchange: Exchange, mine: Mine) -> None:
    assert exchange.sync.age_s == np.inf
    mine.grow()
    exchange.until_equal()
    assert exchange.sync.age_s == 0.0
    exchange.clock.advance(100.0)
    assert exchange.sync.age_s == pytest.approx(100.0), "silence is not freshness"
    for _ in range(30):
        mine.grow(20)
        exchange.follow()
        exchange.clock.advance(1.0)
    exchange.once()
    assert 20.0 < exchange.sync.age_s < 31.0, "the first of the thirty have come"


def test_a_thin_link_shows_a_coarse_picture_first(exchange: Exchange, mine: Mine) -> None:
    """What the page draws of far more than can be sent: where something is, before how it is."""
    mine.grow()
    exchange.until_equal()
    for _ in range(150):
        mine.grow(8)
    exchange.follow()
    chunks = len(mine.journal.chunks)
    for _ in range(6):
        exchange.once(bytes_per_s=5_000)
    assert "coarse" in exchange.asks
    copy = exchange.sync.copy
    assert copy is not None
    shown = copy.changed(0)
    assert len(shown.chunks) == chunks, "all of it is seen"
    assert copy.chunk_count < chunks / 2, "most of it has not come"
    truth = mine.journal.read(shown.chunks)
    order = np.argsort(keys_of(shown.chunks))
    occupied = states_of(truth.values[np.argsort(keys_of(truth.chunks))], HEADER.threshold) == OCCUPIED
    assert (shown.states[order][occupied] == OCCUPIED).all(), "no obstacle is left out"
    revision = shown.revision
    exchange.until_equal()
    exchange.assert_equal()
    assert len(copy.changed(revision).chunks) > chunks / 2, "what was coarse is drawn again when it has come"


def test_another_map_begins_a_copy_of_its_own(exchange: Exchange, mine: Mine) -> None:
    mine.grow()
    exchange.until_equal()
    number = exchange.sync.number
    exchange.sync.follow("20260102-090000")
    assert exchange.sync.copy is None
    assert exchange.sync.number == number + 1
    exchange.once()
    assert exchange.sync.copy is None, "what is told of another map is not taken for it"


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff\xff\xff\xff{}", b"\x02\x00\x00\x00{}x", answer(Told("e", "m", 0, 0, "", 0), b"x")[:-3]],
    ids=["nothing", "cut", "no head", "cut body"],
)
def test_an_answer_that_is_none_is_refused(data: bytes) -> None:
    with pytest.raises(WireError):
        read_answer(data)


@pytest.mark.parametrize(
    "data", [b"{}", b"[", asked(Ask("chunks", most_bytes=10**9)), asked(Ask("chunks", after=-1)), b'{"what":"all"}']
)
def test_a_question_that_is_none_is_refused(data: bytes) -> None:
    with pytest.raises(WireError):
        read_ask(data)


def test_damaged_records_are_refused_whole(exchange: Exchange, mine: Mine) -> None:
    mine.grow()
    exchange.until_equal()
    copy = exchange.sync.copy
    assert copy is not None
    before = copy.sum
    record = exchange.teller.tell(Ask("chunks", exchange.sync.map, exchange.teller.epoch))[1]
    for wrong in (record[:-1], b"x" + record, record[:40] + b"\0" + record[41:]):
        with pytest.raises(WireError, match="damaged"):
            copy.take(wrong)
    assert copy.sum == before


def test_buckets_go_over_as_bits() -> None:
    differ = np.random.default_rng(1).random(BUCKETS) < 0.3
    assert (read_bits(bits_of(differ)) == differ).all()
    assert not read_bits("").any()
    with pytest.raises(WireError):
        read_bits("zz")
