"""The take-off: to the measured height and setpoints that steer, or an error that says why not."""

from __future__ import annotations

import pytest

from companion.autopilot.vehicle import FlightError
from companion.mavlink.firmware import AutopilotKind
from tests.autopilot import scripted
from tests.autopilot.scripted import ARDUPILOT, H_M, KINDS, PX4, Flight


@pytest.mark.parametrize("gps", [True, False])
@pytest.mark.parametrize("kind", KINDS)
async def test_take_off_ends_at_the_measured_height_and_setpoints_then_steer(kind: AutopilotKind, gps: bool) -> None:
    """The whole way on each autopilot: the height is reached and kept for a second before take_off returns."""
    one = Flight(kind, gps)
    async with one.vehicle as vehicle:
        await one.up()
        measured_m = one.autopilot.measured_m()
        assert measured_m is not None
        assert abs(measured_m - H_M) <= 0.2
        assert one.autopilot.armed
        await vehicle.engage()
        assert vehicle._offboard.engaged
        assert all(await one.cruise(2.0))
        assert one.autopilot.mode == (scripted.PX4_OFFBOARD if kind is PX4 else scripted.GUIDED)
        last = one.setpoints[-1]
        assert (last["coordinate_frame"], last["type_mask"]) == (8, 0x5C7)
        assert (last["vx"], last["vy"]) == (0.5, 0.0)
        assert await vehicle.land()
    assert not one.autopilot.armed


async def test_hold_is_not_height_reached() -> None:
    """PX4 reports hold at 0.6 of the height; the rest is climbed by our own setpoints."""
    one = Flight(PX4)
    one.autopilot.ends_take_off_at = 0.6
    async with one.vehicle:
        await one.up()
        measured_m = one.autopilot.measured_m()
        assert measured_m is not None
        assert abs(measured_m - H_M) <= 0.2
        assert one.vehicle._offboard.engaged


async def test_a_take_off_of_px4_that_goes_too_high_ends_at_the_measured_height() -> None:
    """Protects from the roof: PX4 counts from an altitude that drifts with GPS, and rose to 2.65 m instead of 1.5 m."""
    one = Flight(PX4)
    one.autopilot.ends_take_off_at = 1.8
    async with one.vehicle:
        await one.up()
        assert one.vehicle._offboard.engaged
        assert one.autopilot.highest_m <= H_M + 0.2


async def test_no_setpoint_goes_out_before_ardupilot_flies() -> None:
    """Velocity setpoints before the take-off suppress it; brake is not armable, so guided comes first."""
    one = Flight(ARDUPILOT)
    async with one.vehicle:
        await one.up()
        assert one.setpoints == []
        assert not one.autopilot.suppressed
        assert [command for command, _ in one.link.commands] == [176, 400, 22]
        assert one.link.commands[2][1][6] == H_M


async def test_px4_without_gps_arms_in_offboard_and_is_told_no_origin_any_more() -> None:
    """Protects the take-off underground: PX4 may have no global origin, without which it cannot hold.

    An origin that is told here, after the checks, could turn every landing into a flight to 0°/0°.
    """
    one = Flight(PX4, gps=False)
    one.autopilot.hold_allowed = False
    async with one.vehicle:
        await one.up()
        assert one.link.sent_named("SET_GPS_GLOBAL_ORIGIN") == []
        assert [command for command, _ in one.link.commands] == [176, 400]
        assert one.modes_asked == [(1.0, 6.0, 0.0)]


async def test_a_refusal_to_arm_is_told_in_the_autopilots_words() -> None:
    """Protects the person who looks for the reason: what the autopilot said last, and nothing from long before."""
    one = Flight(ARDUPILOT)
    one.autopilot.refuses_to_arm = ["PreArm: Gyros inconsistent"] * 100
    one.autopilot.say("said long before")
    with pytest.raises(FlightError, match=r"refuses to arm \(failed\).*said: PreArm: Gyros inconsistent$"):
        async with one.vehicle:
            await one.up()
    assert not one.autopilot.armed
    assert one.modes_asked == [(1.0, 4.0, 0.0)], "nothing to hold or land: it never armed"


async def test_a_refusal_to_arm_names_the_checks_of_the_autopilot_that_failed() -> None:
    """Protects the person who looks for the reason: PX4's own report knows it where it says only that it refuses."""
    one = Flight(PX4, gps=False)
    one.link.arming_problems = ("No valid position estimate", "Battery low")
    one.autopilot.refuses_to_arm = ["Arming denied"] * 100
    checks = "because of its own checks: No valid position estimate; Battery low"
    with pytest.raises(FlightError, match=rf"refuses to arm \(failed\), {checks}\. The .* said: Arming denied$"):
        async with one.vehicle:
            await one.up()


async def test_a_reason_not_to_arm_may_pass() -> None:
    """Protects the start from reasons that are gone a moment later."""
    one = Flight(ARDUPILOT)
    one.autopilot.refuses_to_arm = ["AHRS: waiting for home"] * 2
    async with one.vehicle:
        await one.up()
        assert one.autopilot.armed


@pytest.mark.parametrize("kind", KINDS)
async def test_a_vehicle_that_does_not_lift_is_an_error_and_is_disarmed(kind: AutopilotKind) -> None:
    """Protects against waiting for a height that does not come, with propellers that turn."""
    one = Flight(kind)
    one.autopilot.lifts = False
    with pytest.raises(FlightError, match="disarmed before the height was reached"):
        async with one.vehicle:
            await one.up()
    assert not one.autopilot.armed


@pytest.mark.parametrize("kind", KINDS)
async def test_after_a_refused_take_off_the_vehicle_is_disarmed_where_it_stands(kind: AutopilotKind) -> None:
    """Protects the people beside a vehicle that is armed and will not fly."""
    one = Flight(kind)
    one.autopilot.refuses_to_take_off = True
    with pytest.raises(FlightError, match=r"refuses to take off \(denied\)"):
        async with one.vehicle:
            await one.up()
    assert not one.autopilot.armed
    assert one.link.commands[-1] == (400, (0.0,)), "disarmed, and nothing else was tried"


async def test_a_height_that_is_never_measured_is_not_reached() -> None:
    """Missing is not zero, and an autopilot in hold is no height."""
    one = Flight(PX4)
    with pytest.raises(FlightError, match="not reached within 40 s: the height is not measured"):
        async with one.vehicle as vehicle:
            await vehicle.take_off(H_M, lambda: None)
    assert one.autopilot.mode == scripted.PX4_LAND


async def test_a_vehicle_that_is_armed_already_is_left_alone() -> None:
    """Protects a flight that is somebody else's."""
    one = Flight(PX4)
    one.autopilot.armed = True
    one.autopilot.heartbeat()
    with pytest.raises(FlightError, match="armed already"):
        async with one.vehicle:
            await one.up()
    assert one.link.commands == []
