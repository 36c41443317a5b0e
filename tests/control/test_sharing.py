"""What vehicles tell each other of the mine."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.control.decisions import CLAIMED_M, Choice
from companion.control.ground_grid import FREE, HIT_WEIGHT, UNSEEN, WALL, level_at
from companion.control.known_ground import CELL_M, KnownGround, Place
from companion.control.parameters import Parameters
from companion.control.sharing import CLAIM_LASTS_S, MOST_TILES, TILE_CELLS, Claim, Frame, GroundNews, Sharing, Tile
from companion.model import Pose
from tests.control.scene import Scene
from tests.control.test_known_ground import DRIFT, H_M, at

HALL = Scene([(-80.0, -80.0), (80.0, -80.0), (80.0, 80.0), (-80.0, 80.0)])


SHARED = Frame()
"""A vehicle whose frame is the shared one."""


def sharing(ground: KnownGround, own_id: int = 1, frame: Frame = SHARED) -> Sharing:
    """What a vehicle tells and hears that knows this ground."""
    return Sharing(own_id, frame, ground, Choice(Parameters(), ground))


def look(ground: KnownGround, scene: Scene, pose: Pose) -> None:
    """Turn once round there, with the camera of the vehicle."""
    for yaw_rad in np.arange(-math.pi, math.pi, math.pi / 4.0):
        there = replace(pose, yaw_rad=float(yaw_rad))
        ground.see(scene.measure(there, h_m=H_M), there)


def seen_along(scene: Scene, from_x_m: float, to_x_m: float, ground: KnownGround | None = None) -> KnownGround:
    """What is known after a flight along the x axis that looked all round, twice a metre."""
    ground = KnownGround() if ground is None else ground
    for x_m in np.arange(from_x_m + 0.2, to_x_m + 0.21, 0.5):
        look(ground, scene, at(float(x_m), 0.2))
    return ground


def newcomer() -> KnownGround:
    """A vehicle that has looked once, at nothing in particular, a metre up a drift of its own."""
    ground = KnownGround()
    look(ground, DRIFT, at(0.2, 0.2))
    return ground


def state(ground: KnownGround, x_m: float, y_m: float, ground_m: float = 0.0) -> np.uint8:
    """What is known of a place."""
    window = ground.window(x_m, y_m)
    assert window is not None
    place = Place(x_m, y_m, ground_m)
    row, column = window.cell(place)
    level = level_at(window.grid, row, column, place.ground_dm)
    return UNSEEN if level < 0 else window.grid.cells[level, row, column]


def all_news(one: Sharing) -> GroundNews:
    """Everything that there is to tell, in one message."""
    tiles: dict[tuple[int, int], Tile] = {}
    news = one.news()
    assert news is not None
    for _ in range(100):
        found = one.news()
        assert found is not None
        tiles |= {tile.place: tile for tile in (*news.tiles, *found.tiles)}
    return replace(news, tiles=tuple(tiles.values()))


FRAMES = [Frame(), Frame(3.3, -1.7, 0.0, 0.0), Frame(4.0, 1.0, 2.0, 0.7), Frame(-2.0, 0.5, -3.0, -2.5)]


@pytest.mark.parametrize("frame", FRAMES)
def test_what_one_has_seen_the_other_knows_in_its_own_frame(frame: Frame) -> None:
    """Wherever the other one started, however it is turned: free is free there and a wall a wall, to half a cell."""
    told, heard = seen_along(DRIFT, -2.0, 12.0), newcomer()
    before = np.count_nonzero(heard.seen().grid.cells)
    listener = sharing(heard, 2, frame)
    listener.learn(all_news(sharing(told)))
    for x_m in (9.75, 10.75):
        assert state(heard, *frame.own(x_m, 0.25, 0.0)) == FREE
        # Walls are told as cells half a metre wide, and may have come to lie in the next one.
        beside = [state(heard, *frame.own(x_m, y_m, 0.0)) for y_m in (1.75, 2.0, 2.25, 2.5)]
        assert WALL in beside
    assert state(heard, *frame.own(10.25, 8.0, 0.0)) == UNSEEN
    assert np.count_nonzero(heard.seen().grid.cells) > before


def test_a_turned_grid_has_no_holes() -> None:
    """A hole in what is free would be unseen ground that attracts, all over the mine."""
    frame = Frame(1.0, -2.0, 0.0, 0.6)
    told, heard = KnownGround(), newcomer()
    for x_m in np.arange(20.0, 40.0, 2.0):
        look(told, HALL, at(float(x_m), 30.0))
    sharing(heard, 2, frame).learn(all_news(sharing(told)))
    along, across = np.meshgrid(np.arange(20.0, 38.0, 0.2), np.arange(28.0, 32.0, 0.2))
    for x_m, y_m in zip(along.ravel(), across.ravel(), strict=True):
        assert state(told, x_m, y_m) == FREE
        assert state(heard, *frame.own(x_m, y_m, 0.0)) == FREE


def test_told_twice_and_out_of_order_it_is_the_same() -> None:
    """The radio repeats, loses and reorders: tiles are as they are, not as they have changed."""
    news = all_news(sharing(seen_along(DRIFT, -2.0, 30.0)))
    once, twice = newcomer(), newcomer()
    sharing(once, 2).learn(news)
    turned = replace(news, tiles=news.tiles[::-1])
    for told in (turned, news, turned):
        sharing(twice, 2).learn(told)
    assert np.array_equal(once.seen().grid.cells, twice.seen().grid.cells)


def test_whoever_misses_half_of_the_messages_knows_everything_in_the_end() -> None:
    """No acknowledgement is needed: each tile comes round again."""
    speaker = sharing(seen_along(DRIFT, -2.0, 30.0))
    heard, whole = newcomer(), newcomer()
    sharing(whole, 2).learn(all_news(sharing(seen_along(DRIFT, -2.0, 30.0))))
    listener = sharing(heard, 2)
    rng = np.random.default_rng(1)
    for _ in range(60):
        news = speaker.news()
        assert news is not None
        if rng.random() < 0.5:
            listener.learn(news)
    assert np.array_equal(heard.seen().grid.cells, whole.seen().grid.cells)


def test_a_message_is_small_and_tells_what_changed_first() -> None:
    """A large hall is told in several, and a change comes with the next one."""
    ground = KnownGround()
    for x_m in np.arange(-60.0, 60.0, 6.0):
        for y_m in np.arange(-60.0, 60.0, 12.0):
            look(ground, HALL, at(float(x_m), float(y_m)))
    speaker = sharing(ground)
    sizes = []
    for _ in range(30):
        news = speaker.news()
        assert news is not None
        sizes.append(len(news.tiles))
    assert max(sizes) <= MOST_TILES + 1
    assert sizes[-1] == 1
    look(ground, HALL, at(61.0, 61.0))
    news = speaker.news()
    assert news is not None
    assert any(
        news.x_m + tile.column * TILE_CELLS * CELL_M <= 61.0 < news.x_m + (tile.column + 1) * TILE_CELLS * CELL_M
        for tile in news.tiles
    )


def test_the_grid_may_grow_meanwhile() -> None:
    """The known part begins elsewhere then; a tile stays the same tile."""
    ground = seen_along(DRIFT, 10.0, 12.0)
    speaker, heard = sharing(ground), newcomer()
    listener = sharing(heard, 2)
    for from_m, to_m in ((2.0, 10.0), (-10.0, 2.0), (12.0, 30.0)):
        seen_along(DRIFT, from_m, to_m, ground)
        for _ in range(6):
            news = speaker.news()
            assert news is not None
            listener.learn(news)
    for x_m in np.arange(-9.75, 30.0, 0.5):
        assert state(heard, float(x_m), 0.25) == FREE


def test_the_own_eyes_count_more() -> None:
    """Where another one's position is wrong its walls stand in the way, and its drifts lead through rock."""
    other = seen_along(DRIFT, -2.0, 12.0)
    shifted = Frame(0.0, 2.0)
    heard = seen_along(DRIFT, -2.0, 12.0)
    sharing(heard, 2).learn(all_news(sharing(other, 1, shifted)))
    for x_m in (4.25, 8.25):
        assert [state(heard, x_m, y_m) for y_m in (-0.75, -0.25, 0.25)] == [FREE] * 3
        assert WALL in [state(heard, x_m, y_m) for y_m in (1.75, 2.0, 2.25)]


def test_a_wall_that_was_seen_once_gives_way_to_ground_that_another_has_flown_over() -> None:
    """It may have been a bump in a nod, or the other vehicle itself, which has moved on."""
    for looks, found in ((1, FREE), (4, WALL)):
        heard = newcomer()
        cell = Place(3.25, 0.25, 0.0)
        level = level_at(heard._grid, *_own(heard, cell), 0)
        assert level >= 0
        heard._grid.cells[(level, *_own(heard, cell))] = WALL
        heard._grid.belief[(level, *_own(heard, cell))] = looks * HIT_WEIGHT
        sharing(heard, 2).learn(all_news(sharing(seen_along(DRIFT, -2.0, 12.0))))
        assert state(heard, cell.x_m, cell.y_m) == found


def _own(ground: KnownGround, place: Place) -> tuple[int, int]:
    column, row = ground._cell(place.x_m, place.y_m)
    return row, column


def test_before_its_first_look_a_vehicle_learns_nothing_and_has_nothing_to_tell() -> None:
    """Its grid lies nowhere yet; what it missed comes round again."""
    ground = KnownGround()
    one = sharing(ground, 2)
    one.learn(all_news(sharing(seen_along(DRIFT, -2.0, 12.0))))
    assert one.news() is None
    assert one.claim(at(0.0)) is None


@pytest.mark.parametrize("bad", [math.nan, math.inf, 0.0, -1.0, 1e12])
def test_news_that_make_no_sense_are_ignored(bad: float) -> None:
    """Whatever comes over a network."""
    heard = newcomer()
    before = heard.seen().grid.cells.copy()
    news = all_news(sharing(seen_along(DRIFT, -2.0, 12.0)))
    sharing(heard, 2).learn(replace(news, cell_m=bad))
    if not 0.0 <= abs(bad) < 1e6:
        sharing(heard, 2).learn(replace(news, frame=Frame(bad)))
        sharing(heard, 2).learn(replace(news, frame=Frame(yaw_rad=bad)))
    assert np.array_equal(heard.seen().grid.cells, before)


# Claims.


def between_two_ends(own_id: int = 2) -> tuple[Sharing, Choice, Pose]:
    """A vehicle in a drift that is known 12 m to the west and 20 m to the east, and goes on unseen on both sides."""
    ground = seen_along(Scene([(-60.0, -2.0), (60.0, -2.0), (60.0, 2.0), (-60.0, 2.0)]), -12.0, 20.0)
    choice = Choice(Parameters(), ground)
    return Sharing(own_id, Frame(), ground, choice), choice, at(0.2, 0.2)


def goal_x_m(choice: Choice, pose: Pose) -> float:
    """Where it goes."""
    way = choice.nearest_unseen(pose)
    assert way is not None
    return way.goal.x_m


def test_it_claims_what_is_nearest() -> None:
    """The west end, with the way there."""
    one, choice, pose = between_two_ends()
    claim = one.claim(pose)
    assert claim is not None
    assert claim.x_m == pytest.approx(goal_x_m(choice, pose))
    assert claim.x_m < -12.0
    assert claim.length_m >= abs(claim.x_m)


@pytest.mark.parametrize(
    ("length_m", "by", "goes_west"),
    [(5.0, 1, False), (5.0, 3, False), (30.0, 1, False), (30.0, 3, True), (90.0, 1, True)],
    ids=["nearer", "nearer, larger", "as near, smaller", "as near, larger", "far"],
)
def test_what_another_one_claims_is_left_to_it(length_m: float, by: int, goes_west: bool) -> None:
    """To whoever surely is nearer; where that is not clear, to the smaller number."""
    one, choice, pose = between_two_ends(own_id=2)
    west = one.claim(pose)
    assert west is not None
    one.on_claim(by, replace(west, length_m=length_m), 0.0)
    one.look(0.0)
    assert (goal_x_m(choice, pose) < 0.0) == goes_west


def test_both_do_not_give_way_to_each_other() -> None:
    """Two side by side with one nearest place: one goes there and one elsewhere."""
    ends = []
    claims: dict[int, Claim] = {}
    for own_id in (1, 2):
        one, choice, pose = between_two_ends(own_id)
        for other, claim in claims.items():
            one.on_claim(other, claim, 0.0)
        one.look(0.0)
        found = one.claim(pose)
        assert found is not None
        claims[own_id] = found
        ends.append(goal_x_m(choice, pose))
    assert min(ends) < 0.0 < max(ends)


def test_where_nothing_else_is_left_it_helps() -> None:
    """A claim keeps nobody from finishing: whoever made it may be lost."""
    one, choice, pose = between_two_ends()
    for number, x_m in ((1, -16.0), (3, 24.0)):
        one.on_claim(number, Claim(x_m, 0.0, 0.0, 1.0), 0.0)
    one.look(0.0)
    assert choice.nearest_unseen(pose) is not None


def test_a_claim_is_forgotten_when_it_is_not_renewed_or_withdrawn() -> None:
    """A vehicle that has fallen silent goes nowhere."""
    one, choice, pose = between_two_ends()
    west = one.claim(pose)
    assert west is not None
    for t_s, claim, bound in ((0.0, west, True), (1.0, None, False), (2.0, west, True)):
        one.on_claim(1, claim and replace(claim, length_m=1.0), t_s)
        one.look(t_s)
        assert (goal_x_m(choice, pose) > 0.0) == bound
    one.look(2.1 + CLAIM_LASTS_S)
    assert goal_x_m(choice, pose) < 0.0


def test_a_claim_that_is_no_number_is_none() -> None:
    """NaN compares false: it would take nothing and everything."""
    one, choice, _ = between_two_ends()
    for field in ("x_m", "y_m", "ground_m", "length_m"):
        one.on_claim(1, replace(Claim(-16.0, 0.0, 0.0, 1.0), **{field: math.nan}), 0.0)
        one.look(0.0)
        assert choice.claimed == ()


def test_only_what_is_near_to_a_claim_is_left() -> None:
    """A branch on the same drift is somebody else's."""
    one, choice, pose = between_two_ends()
    west = one.claim(pose)
    assert west is not None
    one.on_claim(1, replace(west, y_m=west.y_m + CLAIMED_M + 4.0, length_m=1.0), 0.0)
    one.look(0.0)
    assert goal_x_m(choice, pose) < 0.0
