"""Where on its way out a vehicle is, by the walls that it sees."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from companion.control.decisions import Choice
from companion.control.homing.homing import UNSURE_M, Homing
from companion.control.homing.matching import Match
from companion.control.known_ground import UPRIGHT_57_DEG, KnownGround
from companion.model import Measurement, Pose
from tests.control.scene import CAMERA_RAD, Scene, box, law_parameters

#: A ring of drifts 4 m wide about a pillar, with a niche by which a place of its south side is told.
RING = Scene(box(-4.0, -2.0, 42.0, 18.0), box(4.0, 2.0, 38.0, 14.0), box(-1.0, -2.0, 0.0, -1.2))

#: A whole lap, to just before where it began.
LAP_M = [(0.0, 0.0), (40.0, 0.0), (40.0, 16.0), (-2.0, 16.0), (-2.0, 2.0)]


def flown_out() -> tuple[Homing, float]:
    """A vehicle that has flown a lap and turns back, and when."""
    ground = KnownGround(UPRIGHT_57_DEG, 0.25)
    homing, t_s = Homing(law_parameters(), ground, Choice(law_parameters(), ground)), 0.0
    for (x_m, y_m), (to_x_m, to_y_m) in itertools.pairwise(LAP_M):
        yaw_rad, length_m = math.atan2(to_y_m - y_m, to_x_m - x_m), math.dist((x_m, y_m), (to_x_m, to_y_m))
        for step in range(int(length_m)):
            share, t_s = step / length_m, t_s + 1.0
            pose = Pose(t_s, x_m + share * (to_x_m - x_m), y_m + share * (to_y_m - y_m), 1.5, yaw_rad)
            homing.fly_out(RING.measure(pose, CAMERA_RAD, pose.z_m), pose)
    homing.begin(t_s)
    return homing, t_s


def noisy(seen: Measurement, noise_m: float, chance: np.random.Generator) -> Measurement:
    """With walls that lie a little elsewhere in each direction."""
    assert seen.scan is not None
    off_m = chance.normal(0.0, noise_m, len(seen.scan.ranges_m))
    return replace(seen, scan=seen.scan._replace(ranges_m=seen.scan.ranges_m + off_m))


@pytest.mark.parametrize("noise_m", [0.0, 0.2], ids=["clear", "noisy"])
def test_home_is_recognised_after_a_long_way(noise_m: float) -> None:
    """Protects the landing: the whole way out counts for how far the position may have drifted.

    And a place that walls tell clearly is believed though noise and other views take half of what agrees.
    """
    homing, t_s = flown_out()
    truly = Pose(t_s + 1.0, -1.5, 0.5, 1.5, 0.0)
    believed = replace(truly, x_m=truly.x_m + 0.8, y_m=truly.y_m + 0.5)
    seen = noisy(RING.measure(truly, CAMERA_RAD, truly.z_m), noise_m, np.random.default_rng(1))
    homing.align(seen, believed, truly.t_s)
    found = homing.pose(believed)
    assert math.hypot(found.x_m - truly.x_m, found.y_m - truly.y_m) < 0.15


def test_what_a_smooth_drift_has_not_told_is_looked_for_until_walls_tell_it() -> None:
    """Protects the landing: along a smooth drift every place looks the same, and the drift of the way stays unknown.

    Before, a vehicle that was first recognised there took its place along it for known, and landed 1.45 m off.
    """
    homing, t_s = flown_out()
    off_m = (1.1, 0.3)
    assert homing.unsure_m == pytest.approx(1.2, abs=0.1), "1 % of the lap"
    for x_m in np.arange(24.0, -0.5, -0.5):
        t_s += 0.5
        truly = Pose(t_s, float(x_m), 0.0, 1.5, math.pi)
        believed = replace(truly, x_m=truly.x_m + off_m[0], y_m=truly.y_m + off_m[1])
        homing.align(RING.measure(truly, CAMERA_RAD, truly.z_m), believed, t_s)
        found = homing.pose(believed)
        assert abs(found.y_m - truly.y_m) < 0.15
        assert math.hypot(found.x_m - truly.x_m, found.y_m - truly.y_m) < homing.unsure_m + 0.2, "it says so itself"
    assert math.hypot(found.x_m - truly.x_m, found.y_m - truly.y_m) < 0.15
    assert homing.unsure_m < 0.15


@pytest.mark.parametrize(
    ("x_m", "better_by", "is_told"), [(1.9, 0.06, False), (1.9, 0.12, True), (0.3, 0.06, True), (0.3, 0.04, False)]
)
def test_what_walls_tell_to_be_far_off_they_have_to_tell_clearly(
    monkeypatch: pytest.MonkeyPatch, x_m: float, better_by: float, is_told: bool
) -> None:
    """Protects the landing: somewhere along metres of rough walls a little more agrees by chance, and it was 1.4 m off.

    Across the drift walls tell it all the same.
    """
    homing, t_s = flown_out()
    unsure_m = homing.unsure_m
    found = Match(x_m, 0.2, 0.0, share=0.78, better_by=better_by, beside_rad=math.pi)
    monkeypatch.setattr("companion.control.homing.alignment.match", lambda *_: found)
    pose = Pose(t_s + 1.0, 10.0, 0.0, 1.5, math.pi)
    homing.align(RING.measure(pose, CAMERA_RAD, pose.z_m), pose, pose.t_s)
    moved = homing.pose(pose)
    assert (moved.x_m, moved.y_m) == pytest.approx((10.0 + x_m * is_told, 0.2))
    assert (homing.unsure_m < unsure_m / 2.0) == is_told


def arrives(homing: Homing, pose: Pose) -> bool:
    """Whether a vehicle that takes itself to be there has come home."""
    return homing.has_arrived(homing.pose(pose), pose.t_s)


def test_a_home_that_no_wall_has_told_is_made_sure_of_once() -> None:
    """Protects the landing in a smooth drift: 0.9 m off where the walls that would have told were 7 m further.

    Where none tells there either, it comes back and lands.
    """
    homing, t_s = flown_out()
    began_at = homing.began_at
    assert began_at is not None
    home = Pose(t_s + 1.0, began_at.x_m, began_at.y_m, 1.5, 0.0)
    assert not arrives(homing, home)
    assert homing.home is not None
    assert (homing.home.x_m, homing.home.y_m) == pytest.approx((10.0, 0.0), abs=1.0)
    assert not homing.lands_elsewhere
    assert not arrives(homing, replace(home, t_s=t_s + 15.0, x_m=homing.home.x_m))
    assert homing.home == began_at
    assert arrives(homing, replace(home, t_s=t_s + 30.0))
    assert homing.unsure_m > UNSURE_M


def test_it_comes_back_as_soon_as_walls_have_told_it() -> None:
    """Protects the battery: the first metres of the way out are flown only as far as it takes."""
    homing, t_s = flown_out()
    began_at = homing.began_at
    assert began_at is not None
    home = Pose(t_s + 1.0, began_at.x_m, began_at.y_m, 1.5, 0.0)
    assert not arrives(homing, home)
    assert homing.home != began_at
    truly = Pose(t_s + 5.0, -1.5, 0.5, 1.5, 0.0)
    assert homing.align(RING.measure(truly, CAMERA_RAD, truly.z_m), truly, truly.t_s) < 0.2
    assert not arrives(homing, truly)
    assert homing.home == began_at


@pytest.mark.parametrize("as_far_as_m", [5.0, 1.0, 0.0])
def test_where_the_way_out_is_blocked_now_it_is_not_made_sure_of_for_long(as_far_as_m: float) -> None:
    """Protects the landing at home: what stands before the place where it looks for walls makes it no other home."""
    homing, t_s = flown_out()
    began_at = homing.began_at
    assert began_at is not None
    home = Pose(t_s + 1.0, began_at.x_m + as_far_as_m, began_at.y_m, 1.5, 0.0)
    assert not arrives(homing, replace(home, x_m=began_at.x_m))
    for second in range(2, 40):
        arrives(homing, replace(home, t_s=t_s + second))
    assert homing.home == began_at
    assert not homing.lands_elsewhere
