"""Truth mapped onto the mine: the vehicle is where it booted, however the simulator's compass and origin stand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config.settings import Settings
from companion.frames import NedPose
from companion.model import Pose
from sitl.mines import load_world
from sitl.sim.start import start_poses
from sitl.world.placement import Placer, Scene

STAND = Pose(0.0, 10.0, -4.0, 1.15, 0.7)


def ned(t_s: float, north_m: float, east_m: float, down_m: float, yaw_rad: float) -> NedPose:
    return NedPose(t_s, north_m, east_m, down_m, 0.0, 0.0, yaw_rad, 0.0, 0.0, 0.0, 0.0)


@given(
    boot_yaw_rad=st.floats(-3.1, 3.1),
    north_m=st.floats(-50.0, 50.0),
    east_m=st.floats(-50.0, 50.0),
    forward=st.booleans(),
)
def test_one_metre_ahead_there_is_one_metre_ahead_here(
    boot_yaw_rad: float, north_m: float, east_m: float, forward: bool
) -> None:
    """Booted anywhere with any heading: 2 m along its nose (or to its right) is 2 m that way in the mine."""
    placer = Placer(STAND)
    first = placer.place(ned(1.0, north_m, east_m, -3.0, boot_yaw_rad))
    assert (first.x_m, first.y_m, first.z_m) == pytest.approx((STAND.x_m, STAND.y_m, STAND.z_m))
    assert math.remainder(first.yaw_rad - STAND.yaw_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-12)
    # Along the nose by the compass, or clockwise of it.
    way_rad = boot_yaw_rad + (0.0 if forward else math.pi / 2)
    v_north, v_east = 0.5 * math.cos(way_rad), 0.5 * math.sin(way_rad)
    there = replace(
        ned(2.0, north_m + 2 * math.cos(way_rad), east_m + 2 * math.sin(way_rad), -4.5, boot_yaw_rad - 0.3),
        v_north_mps=v_north,
        v_east_mps=v_east,
        v_down_mps=-0.2,
        pitch_rad=-0.1,
    )
    pose = placer.place(there)
    # In the mine angles count to the left: the right is a quarter turn less.
    along_rad = STAND.yaw_rad - (0.0 if forward else math.pi / 2)
    assert pose.x_m == pytest.approx(STAND.x_m + 2 * math.cos(along_rad), abs=1e-9)
    assert pose.y_m == pytest.approx(STAND.y_m + 2 * math.sin(along_rad), abs=1e-9)
    assert pose.z_m == pytest.approx(STAND.z_m + 1.5)
    assert (pose.vx_mps, pose.vy_mps) == pytest.approx((0.5 * math.cos(along_rad), 0.5 * math.sin(along_rad)), abs=1e-9)
    assert pose.vz_mps == pytest.approx(0.2)
    # A turn to the left by the compass is one here; nose down there is nose down here.
    assert math.remainder(pose.yaw_rad - (STAND.yaw_rad + 0.3), 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert pose.pitch_rad == 0.1


def test_the_heading_offset_is_between_mine_and_compass() -> None:
    """Odometry aligned with north needs it: east by the compass is our zero."""
    placer = Placer(STAND)
    placer.place(ned(1.0, 0.0, 0.0, 0.0, math.pi / 2))
    assert placer.heading_offset_rad() == pytest.approx(STAND.yaw_rad)


def test_a_simulator_started_anew_stands_at_the_start_again() -> None:
    """It may boot elsewhere: the vehicle has not flown there through the rock."""
    placer = Placer(STAND)
    placer.place(ned(1.0, 0.0, 0.0, 0.0, 0.0))
    placer.place(ned(1.1, 0.4, 0.0, 0.0, 0.0))
    again = placer.place(ned(1.2, 60.0, 0.0, 0.0, 2.0))
    assert placer.restarts == 1
    assert (again.x_m, again.y_m, again.yaw_rad) == pytest.approx((STAND.x_m, STAND.y_m, STAND.yaw_rad))


def test_a_link_that_was_dead_for_ten_seconds_is_no_restart() -> None:
    """The vehicle flew on meanwhile: 5 m in 10 s."""
    placer = Placer(STAND)
    placer.place(ned(1.0, 0.0, 0.0, 0.0, 0.0))
    placer.place(ned(11.0, 5.0, 0.0, 0.0, 0.0))
    assert placer.restarts == 0


def test_the_start_is_that_of_the_simulation_put_on_the_floor() -> None:
    """The same seed starts at the same place in `companion sim` and here, else nothing can be compared."""
    settings = Settings()
    scene = Scene.load("room", 3, None, settings)
    rng = np.random.default_rng(np.random.SeedSequence(3).spawn(2)[0])
    hover = start_poses(load_world("room", 3), scene.caster, settings, 1, rng)[0]
    assert (scene.stand.x_m, scene.stand.y_m, scene.stand.yaw_rad) == (hover.x_m, hover.y_m, hover.yaw_rad)
    floor_m = hover.z_m - settings.control.height_m
    assert scene.stand.z_m == pytest.approx(floor_m + settings.vehicle.body_height_m / 2, abs=0.01)


def test_a_start_of_ones_own() -> None:
    """Given as a hovering pose, as for the simulation; the vehicle stands on the floor below."""
    scene = Scene.load("room", 1, (2.0, 2.0, 1.4, -1.0), Settings())
    assert (scene.stand.x_m, scene.stand.y_m, scene.stand.yaw_rad) == (2.0, 2.0, -1.0)
    assert scene.stand.z_m < 0.5
