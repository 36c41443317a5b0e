"""Rock is in space: what lay below the vehicle when it was seen is beside it when it has sunk."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.model import HIT, Pose
from companion.perception.extract import BODY_MARGIN_M
from companion.perception.scan_memory import AGAIN_S, LEVEL_M, LEVELS, ONCE_S, REACH_S, ScanMemory
from companion.perception.view import view_of
from tests.perception.observations import BEARINGS, DOWN, VEHICLE, extractor, later, observed, scan_of
from tests.perception.scenes import AT_START, FLOOR, ROOF, Surface, board, frame

HALF_M = VEHICLE.body_height_m / 2.0 + BODY_MARGIN_M
BLOCK_M = 0.9
"""The top of a block on the floor, 0.6 m below a vehicle that flies 1.5 m above it."""


def block(x_m: float = 2.0) -> Surface:
    """A ledge along the way on the left, from the floor to `BLOCK_M`."""
    return board(x_m, 0.6, 0.8, high_m=BLOCK_M)


def nearest_m(vz_mps: float = 0.0, z_m: float = AT_START.z_m) -> float | None:
    """D beside the block that was seen ahead a moment ago, of a vehicle at that height."""
    extract = extractor()
    extract.measure(observed(AT_START, [FLOOR, ROOF, block()], DOWN))
    pose = later(AT_START, 0.1, x_m=2.0, z_m=z_m, vz_mps=vz_mps)
    return extract.measure(observed(pose, [FLOOR, ROOF], DOWN)).d_m


def test_who_sinks_beside_a_block_that_it_flew_above_sees_it() -> None:
    """Protects the body: the slab in which the block was no obstacle lay 0.6 m higher."""
    assert nearest_m() is None, "so high it is none"
    for z_m in (1.1, 0.9, 0.7):
        assert nearest_m(z_m=z_m) == pytest.approx(0.2, abs=0.06), z_m


def test_who_is_about_to_sink_beside_it_sees_it_as_well() -> None:
    """Protects the reaction: the way down takes less time than braking."""
    assert nearest_m(vz_mps=-0.35, z_m=1.5) is None
    assert nearest_m(vz_mps=-0.4, z_m=1.5) == pytest.approx(0.2, abs=0.06), "to 1.1 m, the margin below included"
    assert nearest_m(vz_mps=0.4, z_m=1.5) is None, "up and away"
    assert pytest.approx(1.5 - HALF_M - 0.35 * REACH_S) == BLOCK_M


def memory() -> ScanMemory:
    return ScanMemory(60.0, 5.0, HALF_M)


def recalled(there: ScanMemory, pose: Pose) -> list[float]:
    measured = scan_of(extractor().measure(observed(pose, [FLOOR, ROOF], DOWN)))
    scan = measured._replace(state=np.zeros_like(measured.state), fresh=np.zeros_like(measured.fresh))
    there.recall(scan, pose, pose.t_s)
    return [float(range_m) for range_m in scan.ranges_m[scan.state == HIT]]


@pytest.mark.timeout(60, method="thread")
@pytest.mark.parametrize("vz_mps", [-1e300, -1e19, 1e19, 1e300, math.inf, math.nan])
def test_a_climb_that_is_none_is_not_reckoned_with(vz_mps: float) -> None:
    """Protects the tick: with 1e300 m/s it sometimes never ended, for the level up there is no whole number."""
    assert nearest_m(vz_mps=vz_mps, z_m=1.5) is None
    assert nearest_m(vz_mps=vz_mps, z_m=0.9) == pytest.approx(0.2, abs=0.06)


def test_floor_and_roof_are_no_walls() -> None:
    """Protects every flight: the camera sees them all the time, and the vehicle flies between them."""
    there = memory()
    there.remember_view(view_of(frame([FLOOR, ROOF])), AT_START, 5.0, 0.0)
    assert recalled(there, AT_START) == []
    assert recalled(there, later(AT_START, 0.0, z_m=0.1)) != [], "on the floor it is in the way"


def test_a_single_pixel_is_nothing() -> None:
    """Protects from flying pixels: what stands there shows in two pixels of a cell at least."""
    image = frame([FLOOR, ROOF])
    image.depth_m[60, 80] = 2.0
    there = memory()
    there.remember_view(view_of(image), AT_START, 5.0, 0.0)
    assert recalled(there, AT_START) == []
    image.depth_m[59:62, 80:82] = 2.0
    there.remember_view(view_of(image), AT_START, 5.0, 0.2)
    assert recalled(there, AT_START) == pytest.approx([2.1] * 1, abs=0.01)


@pytest.mark.parametrize(("images_s", "after_s", "kept"), [
    ((0.0,), ONCE_S - 0.1, True),
    ((0.0,), ONCE_S + 0.1, False),
    ((0.0, 0.2), 30.0, True),
    ((0.0, 0.2), 60.3, False),
    ((0.0, AGAIN_S + 0.1), ONCE_S + 1.0, False),
    ((0.0, 0.2, 10.0), 40.0, True),
])  # fmt: skip
def test_what_one_image_alone_has_shown_is_not_kept_for_a_minute(
    images_s: tuple[float, ...], after_s: float, kept: bool
) -> None:
    """Protects flights through dust: its false returns closed the way home for a minute each."""
    there = memory()
    cloud = frame([FLOOR, ROOF, board(2.0, 0.0, 0.3, 1.3, 1.7)])
    for t_s in images_s:
        there.remember_view(view_of(cloud), AT_START, 5.0, t_s)
    assert (recalled(there, later(AT_START, after_s)) != []) is kept
    up_m, down_m = there.above_and_below(later(AT_START, after_s, x_m=2.0, z_m=0.5), 0.4, 0.0, after_s)
    assert (up_m < 1.3) is kept, "it presses nobody down either"
    assert math.isfinite(down_m) is False or down_m > 0.4


@pytest.mark.parametrize("up_m", [0.0, LEVELS * LEVEL_M, -3.0 * LEVELS * LEVEL_M])
def test_heights_wrap_without_mixing(up_m: float) -> None:
    """Protects ramps of tens of metres: a wall of the level below is not one of this level."""
    there = memory()
    pose = later(AT_START, 0.0, z_m=up_m)
    there.remember(pose, BEARINGS[[200]], np.array([2.0]), 0.0)
    assert recalled(there, pose) == pytest.approx([2.0])
    assert recalled(there, later(pose, 0.0, z_m=up_m + LEVELS * LEVEL_M)) == []
    assert recalled(there, later(pose, 0.0, z_m=up_m + HALF_M + 0.01)) == []


@pytest.mark.parametrize("broken", [{"z_m": math.nan}, {"z_m": 1e7}, {"x_m": math.inf}, {"vz_mps": math.nan}])
def test_a_pose_that_is_none_remembers_and_recalls_nothing_wrong(broken: dict[str, float]) -> None:
    """Protects the memory from a NaN, which would become an index."""
    there = memory()
    pose = later(AT_START, 0.0, **broken)
    there.remember(pose, BEARINGS[[200]], np.array([2.0]), 0.0)
    there.remember_view(view_of(frame([FLOOR, block()])), pose, 5.0, 0.0)
    ranges_m = recalled(there, AT_START)
    assert all(math.isfinite(range_m) for range_m in ranges_m)
    assert bool(ranges_m) is ("vz_mps" in broken)


def flown_towards(x_m: float, low_m: float, high_m: float) -> list[tuple[float, float]]:
    """Roof and rise, of a vehicle that comes to a board across its way which it saw from afar, by distance."""
    extract = extractor()
    there = board(x_m, 0.0, 1.0, low_m=low_m, high_m=high_m)
    found = []
    for at_m in (0.0, x_m - 1.2, x_m - 0.6, x_m):
        pose = later(AT_START, 0.1 + 0.2 * at_m, x_m=at_m, vx_mps=0.4)
        surfaces = [FLOOR, ROOF] if at_m > 0.0 else [FLOOR, ROOF, there]
        told = extract.measure(observed(pose, surfaces, DOWN))
        found.append((math.inf if told.roof_m is None else told.roof_m, told.rise_m))
    return found


def test_what_hangs_from_the_roof_is_known_before_the_beam_sees_it() -> None:
    """Protects the body: the beam upward looks at one point, above the middle of the body."""
    above = [roof_m for roof_m, _ in flown_towards(4.0, 2.25, 2.8)]
    assert above[1] > 1.3, "it stands before it gets there"
    assert above[2:] == pytest.approx([0.75, 0.75], abs=0.2), "to two pixels of a coarse camera"


def test_a_step_in_the_floor_is_known_before_the_beam_sees_it() -> None:
    """Protects from steps: the beam downward sees one only when the vehicle is above it."""
    rises = [rise_m for _, rise_m in flown_towards(4.0, 0.4, 0.85)]
    assert rises[1] < 0.1
    assert rises[2:] == pytest.approx([0.85, 0.85], abs=0.2)


def test_a_pose_that_is_no_number_knows_of_nothing() -> None:
    """Protects the index of a cell."""
    assert memory().above_and_below(later(AT_START, 0.0, x_m=math.nan), 0.4, 0.5, 0.0) == (math.inf, math.inf)
