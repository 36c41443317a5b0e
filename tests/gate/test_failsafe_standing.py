"""How the gate makes a vehicle stand: it keeps the place, stands before it holds, and lands where it is."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from companion.gate.failsafe_actions import (
    AWAY_MPS,
    HOLD_PATIENCE_S,
    LAND_MPS,
    PLACELESS,
    UNSTOPPABLE,
)
from companion.gate.faults import Fault, Stage
from companion.gate.protocol import Phase
from companion.gate.vehicle import NOWHERE_S
from companion.mavlink.firmware import AutopilotKind
from companion.sides import NOTHING_AROUND, Side, Sides
from companion.station_keeping import PATIENCE_S, STANDS_MPS
from tests.gate.built import BEAT, KINDS
from tests.gate.failsafe_scene import PLAN, Scene

BOTH = pytest.mark.parametrize("kind", KINDS)
AT_S = 64.0
PERIOD_S = PLAN.period_s
TOO_NEAR = Sides(front=Side(0.25, 0.0))


def braking(kind: AutopilotKind = AutopilotKind.PX4) -> Scene:
    """It came to stand at the origin, and the gate brakes."""
    scene = Scene(kind)
    scene.escalation.force(Stage.BRAKE)
    scene.at(AT_S)
    assert scene.due(AT_S) == ["stop"]
    return scene


def counts(scene: Scene, fault: Fault, now_s: float) -> None:
    scene.escalation.update(frozenset({fault}), now_s)


@BOTH
def test_while_it_brakes_the_place_is_kept(kind: AutopilotKind) -> None:
    """Protects the wall from a creep: zero velocity let PX4 creep on at 0.06 m/s, half a metre in 9 s."""
    scene = braking(kind)
    scene.at(AT_S + PERIOD_S, x=0.04, y=-0.02, z=-0.06)
    assert scene.due(AT_S + PERIOD_S) == [(-0.02, 0.01, 0.03)]
    scene.at(AT_S + 2 * PERIOD_S, x=9.0)
    assert scene.due(AT_S + 2 * PERIOD_S) == [(-0.1, 0.0, 0.0)], "and slowly, however far"


def test_the_way_back_is_told_along_the_heading() -> None:
    """Protects the frames: the setpoint is the body's, the place is on the autopilot's axes."""
    scene = braking()
    scene.at(AT_S + PERIOD_S, yaw=1.5707963267948966, x=0.04)
    assert scene.due(AT_S + PERIOD_S) == [(0.0, 0.02, 0.0)], "it looks east and has to go south: to the right"


def test_what_still_moves_is_asked_to_stand_first() -> None:
    """Protects the stop from a lurch back to where the fault struck."""
    scene = Scene()
    scene.escalation.force(Stage.BRAKE)
    for tick, speed in enumerate((0.5, 0.3, 0.2)):
        scene.at(AT_S + tick * PERIOD_S, x=0.03 * tick, vx=speed)
        assert scene.due(AT_S + tick * PERIOD_S) == ["stop"]
    scene.at(AT_S + 3 * PERIOD_S, x=0.1)
    assert scene.due(AT_S + 3 * PERIOD_S) == ["stop"], "here it stands"
    scene.at(AT_S + 4 * PERIOD_S, x=0.14)
    assert scene.due(AT_S + 4 * PERIOD_S) == [(-0.02, 0.0, 0.0)]


def test_the_next_stop_has_a_place_of_its_own() -> None:
    """Protects the way on: from a stop that is over nobody flies back to where it was."""
    scene = braking()
    scene.escalation.reset()
    assert scene.due(AT_S + 0.25) == []
    scene.escalation.force(Stage.BRAKE)
    scene.at(AT_S + 0.5, x=0.3)
    assert scene.due(AT_S + 0.5) == ["stop"]
    scene.failsafe.reset()
    scene.at(AT_S + 0.75, x=0.5)
    assert scene.due(AT_S + 0.75) == ["stop"], "nor after the flight"


@pytest.mark.parametrize("fault", sorted(PLACELESS))
def test_a_place_that_is_not_believed_is_not_flown_to(fault: Fault) -> None:
    """Protects from flying by a position that jumped, froze, or is no longer measured."""
    scene = braking()
    counts(scene, fault, AT_S)
    scene.escalation.stage = Stage.BRAKE
    scene.at(AT_S + PERIOD_S, x=0.04)
    assert scene.due(AT_S + PERIOD_S) == ["stop"]
    scene.escalation.reset()
    scene.escalation.force(Stage.BRAKE)
    scene.at(AT_S + 2 * PERIOD_S, x=0.08)
    assert scene.due(AT_S + 2 * PERIOD_S) == ["stop"], "when it is believed again, here is where it stays"


def test_other_faults_leave_the_place_as_it_is() -> None:
    """Protects the standing from being given up for a blind camera."""
    for fault in set(Fault) - PLACELESS:
        scene = braking()
        counts(scene, fault, AT_S)
        scene.escalation.stage = Stage.BRAKE
        scene.at(AT_S + PERIOD_S, x=0.04)
        assert scene.due(AT_S + PERIOD_S) == [(-0.02, 0.0, 0.0)], fault


def test_an_old_position_is_no_position() -> None:
    """Protects from a way back that was long since flown: stale is not fresh."""
    scene = braking()
    scene.at(AT_S + PERIOD_S, x=0.04)
    limit_s = PLAN.thresholds.pose_s
    assert scene.due(AT_S + PERIOD_S + limit_s) == [(-0.02, 0.0, 0.0)]
    assert scene.due(AT_S + 2 * PERIOD_S + limit_s) == ["stop"]


@pytest.mark.parametrize("message", ["LOCAL_POSITION_NED", "ATTITUDE"])
def test_half_of_a_pose_is_none(message: str) -> None:
    """Protects from a heading of zero that nobody told."""
    scene = Scene()
    scene.escalation.force(Stage.BRAKE)
    full = {"time_boot_ms": 1, "yaw": 1.0} | dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), 0.0)
    scene.vehicle.on_message(message, full, AT_S)
    scene.vehicle.motion.fresh_s = AT_S
    assert scene.due(AT_S) == ["stop"]
    assert scene.failsafe._station.place_m is None


@BOTH
def test_it_comes_to_stand_before_it_is_asked_to_hold(kind: AutopilotKind) -> None:
    """Protects the wall from ArduCopter's BRAKE, which goes twice as far as zero velocity does."""
    scene = Scene(kind)
    scene.escalation.force(Stage.HOLD)
    for tick, speed in enumerate((0.5, 0.3, STANDS_MPS + 1e-6)):
        scene.at(AT_S + tick * PERIOD_S, vx=speed)
        assert scene.due(AT_S + tick * PERIOD_S) == ["stop"]
    scene.at(AT_S + 0.25, vx=STANDS_MPS)
    assert scene.due(AT_S + 0.25) == ["stop", scene.ours.hold]


def test_what_does_not_stand_is_held_all_the_same() -> None:
    """Protects from waiting for an autopilot that does not obey: two seconds are enough for both of them."""
    scene = Scene()
    scene.escalation.force(Stage.HOLD)
    for tick in range(round(PATIENCE_S / PERIOD_S) + 1):
        scene.at(AT_S + tick * PERIOD_S, vx=0.3)
        assert scene.ours.hold not in scene.due(AT_S + tick * PERIOD_S)
    scene.at(AT_S + PATIENCE_S + PERIOD_S, vx=0.3)
    asked_s = AT_S + PATIENCE_S + PERIOD_S
    assert scene.ours.hold in scene.due(asked_s)
    scene.at(asked_s + HOLD_PATIENCE_S)
    scene.due(asked_s + HOLD_PATIENCE_S)
    assert scene.stage() is Stage.HOLD, "the patience with the hold begins with the request"


def test_the_patience_with_the_stop_counts_from_its_beginning() -> None:
    """Protects from waiting again: who was braked for seconds, and moves, is held at once."""
    scene = Scene()
    scene.escalation.force(Stage.BRAKE)
    scene.at(AT_S, vx=0.3)
    scene.due(AT_S)
    scene.escalation.reset()
    scene.at(AT_S + 1.0, vx=0.3)
    scene.due(AT_S + 1.0)
    scene.escalation.force(Stage.BRAKE)
    scene.at(AT_S + 2.0, vx=0.3)
    scene.due(AT_S + 2.0)
    scene.escalation.force(Stage.HOLD)
    scene.at(AT_S + 3.0, vx=0.3)
    assert scene.due(AT_S + 3.0) == ["stop"], "what came between counts not"
    scene.at(AT_S + 4.5, vx=0.3)
    assert scene.ours.hold in scene.due(AT_S + 4.5)


@pytest.mark.parametrize("fault", sorted(UNSTOPPABLE))
def test_nobody_waits_where_zero_velocity_means_nothing(fault: Fault) -> None:
    """Protects the seconds: by an estimator that is lost no setpoint stops anything."""
    scene = Scene()
    counts(scene, fault, AT_S)
    scene.escalation.force(Stage.HOLD)
    scene.escalation.stage = Stage.HOLD
    scene.at(AT_S, vx=0.3)
    assert scene.due(AT_S) == ["stop", scene.ours.hold]


def test_nor_where_nobody_knows_whether_it_moves() -> None:
    """Protects the same without a fresh velocity, or in a mode that takes no setpoints."""
    scene = Scene()
    scene.escalation.force(Stage.HOLD)
    scene.at(AT_S, vx=0.3)
    stale_s = AT_S + PLAN.thresholds.pose_s + 2.0**-10
    assert scene.ours.hold in scene.due(stale_s)
    unsteered = Scene()
    unsteered.ask(unsteered.ours.hold)
    unsteered.escalation.force(Stage.HOLD)
    unsteered.at(AT_S, vx=0.3)
    assert unsteered.ours.hold in unsteered.due(AT_S)


@BOTH
def test_a_landing_does_not_wait(kind: AutopilotKind) -> None:
    """Protects from hovering with an empty battery: the landing brakes by itself."""
    scene = Scene(kind)
    scene.escalation.force(Stage.LAND)
    scene.at(AT_S, vx=0.5)
    assert scene.due(AT_S) == ["stop", scene.ours.land]


# PX4 with an origin and without a global position lands at latitude 0, longitude 0.


def nowhere(kind: AutopilotKind = AutopilotKind.PX4, *, steered: bool = True) -> Scene:
    scene = Scene(kind, steered=steered)
    origin: dict[str, Any] = {"latitude": 1, "longitude": 1, "altitude": 1}
    scene.vehicle.on_message("GPS_GLOBAL_ORIGIN", origin, AT_S - 2.0 * NOWHERE_S)
    scene.show(scene.ours.offboard, AT_S)
    scene.escalation.force(Stage.LAND)
    scene.at(AT_S)
    return scene


def test_where_px4_would_fly_away_to_land_it_is_led_down() -> None:
    """Protects from 20 m through a mine at 4 m/s towards a place in the Atlantic: it goes down where it is."""
    scene = nowhere()
    assert scene.due(AT_S) == [(0.0, 0.0, LAND_MPS)]
    scene.at(AT_S + PERIOD_S, x=0.04, z=0.3)
    assert scene.due(AT_S + PERIOD_S) == [(-0.02, 0.0, LAND_MPS)], "and keeps its place, but for the height"
    assert scene.vehicle.asked_modes == {scene.ours.offboard}


def test_it_is_led_down_only_in_the_mode_that_takes_setpoints() -> None:
    """Protects from a landing of PX4's own that the application has begun, and from one before any setpoint."""
    for steered in (True, False):
        scene = nowhere(steered=steered)
        scene.ask(scene.ours.land)
        scene.show(scene.ours.land, AT_S)
        assert scene.due(AT_S) == [(0.0, 0.0, LAND_MPS), scene.ours.offboard]
        scene.at(AT_S + 0.25)
        assert scene.due(AT_S + 0.25) == [(0.0, 0.0, LAND_MPS)]
        scene.at(AT_S + 0.5)
        assert scene.due(AT_S + 0.5) == [(0.0, 0.0, LAND_MPS), scene.ours.offboard], "until it shows"
        scene.show(scene.ours.offboard, AT_S + 0.75)
        scene.at(AT_S + 1.0)
        assert scene.due(AT_S + 1.0) == [(0.0, 0.0, LAND_MPS)]


def test_who_knows_where_it_is_lands_by_its_own_mode() -> None:
    """Protects all other vehicles: their own landing finds the ground better."""
    scene = nowhere()
    scene.vehicle.on_message("GLOBAL_POSITION_INT", {}, AT_S)
    assert scene.due(AT_S) == ["stop", scene.ours.land]
    ardupilot = nowhere(AutopilotKind.ARDUPILOT)
    assert ardupilot.due(AT_S) == ["stop", ardupilot.ours.land]
    without = Scene()
    without.escalation.force(Stage.LAND)
    without.at(AT_S)
    assert without.due(AT_S) == ["stop", without.ours.land]


# It backs away.


@pytest.mark.parametrize(
    ("sides", "forward_right"),
    [
        (NOTHING_AROUND, (0.0, 0.0)),
        (Sides(front=Side(0.75, 0.0)), (0.0, 0.0)),
        (Sides(front=Side(0.4375, 0.0)), (-0.125, 0.0)),
        (Sides(front=Side(0.5625, 0.25)), (-0.125, 0.0)),
        (Sides(front=Side(0.125, 0.0)), (-AWAY_MPS, 0.0)),
        (Sides(back=Side(0.375, 0.0)), (0.25, 0.0)),
        (Sides(left=Side(0.375, 0.0)), (0.0, 0.25)),
        (Sides(right=Side(0.5, 0.25)), (0.0, -0.25)),
    ],
)
def test_it_moves_away_from_a_wall_that_comes_nearer_while_it_stands(
    sides: Sides, forward_right: tuple[float, float]
) -> None:
    """Protects from odometry that drifts: who keeps a place by it drifts along, into the wall that the camera sees."""
    scene = Scene()
    scene.escalation.force(Stage.BRAKE)
    scene.at(AT_S)
    scene.monitor.on_beat(replace(BEAT, t_s=AT_S, sides=sides), AT_S)
    assert PLAN.thresholds.hard_limit_m + PLAN.stopping.creep_m == 0.5
    assert scene.due(AT_S) == [(*forward_right, 0.0) if any(forward_right) else "stop"]


def test_by_what_is_no_longer_seen_it_does_not_move() -> None:
    """Protects from backing through a mine by an old look: the application hangs, and tells of nothing newer."""
    scene = Scene()
    scene.escalation.force(Stage.BRAKE)
    scene.monitor.on_beat(replace(BEAT, t_s=AT_S, sides=TOO_NEAR), AT_S)
    scene.at(AT_S + 0.125)
    assert scene.due(AT_S + 0.125) == ["stop"]


def test_a_camera_that_is_too_near_leaves_it_to_the_beams() -> None:
    """Protects from a drift into the wall: nearer than the camera measures a beam still does."""
    scene = Scene()
    scene.escalation.force(Stage.BRAKE)
    scene.at(AT_S)
    scene.monitor.on_beat(replace(BEAT, t_s=AT_S, depth_age_s=5.0, ahead_m=math.nan, sides=TOO_NEAR), AT_S)
    assert scene.due(AT_S) == [(-0.5, 0.0, 0.0)]


@pytest.mark.parametrize(
    "blind", [{"depth_age_s": 0.625}, {"ahead_m": math.nan}, {"ahead_m": 0.5}], ids=["no look", "unknown", "remembered"]
)
def test_forward_it_goes_only_where_it_is_seen_to_be_free(blind: dict[str, Any]) -> None:
    """Protects from a blind flight: away from the wall behind, into the one ahead that the camera no longer sees."""
    scene = Scene()
    scene.escalation.force(Stage.BRAKE)
    scene.at(AT_S)
    beat = replace(BEAT, t_s=AT_S, sides=Sides(back=Side(0.375, 0.0), left=Side(0.4375, 0.0)))
    scene.monitor.on_beat(replace(beat, **blind), AT_S)
    assert scene.due(AT_S) == [(0.0, 0.125, 0.0)]


@pytest.mark.parametrize("phase", [Phase.CLIMBING, Phase.ENDING])
def test_near_the_ground_it_does_not_back_away_from_it(phase: Phase) -> None:
    """Protects the take-off: the camera looks at the floor, and a stop of a moment sent the vehicle backward."""
    scene = Scene()
    scene.escalation.force(Stage.BRAKE)
    scene.monitor.on_beat(replace(BEAT, t_s=AT_S, sides=TOO_NEAR, phase=phase), AT_S)
    scene.at(AT_S)
    assert scene.due(AT_S) == ["stop"]
