"""Pre-flight: what must stop a flight does, what need not does not, and --fix changes nothing but what is wrong."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

import pytest

from companion.autopilot.telemetry import Telemetry
from companion.config.settings import Settings
from companion.errors import InputError
from companion.flight.preflight import CheckResult, check_names, refusal, render, run_checks
from companion.mavlink.firmware import AutopilotKind
from companion.sensors.sink import NOT_POSITIVE
from companion.sensors.statistics import StreamStatistics
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT

GOOD: dict[AutopilotKind, dict[str, float | int]] = {
    PX4: {
        "COM_OF_LOSS_T": 0.5,
        "COM_OBL_RC_ACT": 5,
        "COM_RCL_EXCEPT": 6,
        "NAV_RCL_ACT": 2,
        "NAV_DLL_ACT": 0,
        "COM_DLL_EXCEPT": 0,
        "COM_LOW_BAT_ACT": 2,
        "BAT_CRIT_THR": 0.07,
        "BAT_LOW_THR": 0.15,
        "COM_DISARM_PRFLT": 15.0,
        "EKF2_NOAID_TOUT": 1_000_000,
        "MPC_XY_CRUISE": 1.0,
        "MPC_XY_VEL_MAX": 12.0,
        "MPC_Z_VEL_MAX_UP": 3.0,
        "MPC_Z_VEL_MAX_DN": 1.5,
    },
    ARDUPILOT: {
        "GUID_TIMEOUT": 0.5,
        "GUID_OPTIONS": 0,
        "AVOID_ENABLE": 0,
        "AVOID_MARGIN": 2.0,
        "AVOID_BACKUP_SPD": 0.75,
        "FS_THR_ENABLE": 3,
        "FS_OPTIONS": 16,
        "FS_GCS_ENABLE": 0,
        "FS_EKF_ACTION": 1,
        "BATT_FS_LOW_ACT": 1,
        "BATT_FS_CRT_ACT": 1,
        "BATT_LOW_VOLT": 10.5,
        "WPNAV_ACCEL": 250.0,
        "PSC_JERK_XY": 5.0,
    },
}
WITHOUT_GPS: dict[AutopilotKind, dict[str, float | int]] = {
    PX4: {
        "SYS_HAS_GPS": 0,
        "SYS_HAS_MAG": 0,
        "EKF2_GPS_CTRL": 0,
        "EKF2_EV_CTRL": 15,
        "EKF2_HGT_REF": 3,
        "EKF2_MAG_TYPE": 5,
        "COM_ARM_WO_GPS": 1,
    },
    ARDUPILOT: {
        "GPS1_TYPE": 0,
        "VISO_TYPE": 1,
        "EK3_SRC1_POSXY": 6,
        "EK3_SRC1_VELXY": 6,
        "EK3_SRC1_POSZ": 6,
        "EK3_SRC1_VELZ": 6,
        "EK3_SRC1_YAW": 6,
        "COMPASS_ENABLE": 0,
        "COMPASS_USE": 0,
        "COMPASS_USE2": 0,
        "COMPASS_USE3": 0,
    },
}
BEAMS = ("front", "left", "back", "right", "down", "up")


def reading(rate_hz: float, age_s: float = 0.05) -> StreamStatistics:
    """Statistics of a stream, as the sink gives them."""
    return StreamStatistics(rate_hz, age_s, count=100, dropped=0, reasons={})


class Bench:
    """A vehicle on the ground with which everything is right, until a test changes something."""

    def __init__(self, kind: AutopilotKind, folder: Path, gps: bool = True) -> None:
        self.clock = HandClock()
        self.link = FakeLink(self.clock, kind)
        self.link.params = GOOD[kind] | ({} if gps else WITHOUT_GPS[kind])
        self.settings = Settings.model_validate(
            {
                "autopilot": {"gps": gps},
                "record": {"folder": str(folder / "flights"), "largest_mb": 10},
            }
        )
        self.telemetry = Telemetry(self.link, self.clock, self.settings)
        self.inputs = {"depth": reading(5.0)} | {beam: reading(10.0) for beam in BEAMS}
        self.height_m: float | None = 0.12
        self.armed = False
        self.battery = 90
        self.v_east_mps = 0.0
        self.prearm = dict.fromkeys(("onboard_control_sensors_enabled", "onboard_control_sensors_health"), 1 << 28)
        self.flags = 511 if kind is PX4 else 0x33F
        self.seconds = 3.0
        self.streams = True
        self.heartbeat_every = 50
        self.link_problem = ""
        self.mode = 0x03040000 if kind is PX4 else 4

    def listen(self) -> None:
        """Three seconds of a healthy autopilot."""
        px4 = self.link.kind is PX4
        answered = 0
        for i in range(round(self.seconds / 0.02)):
            self.clock.advance(0.02)
            now_ms = int((self.clock.now_s() - 990.0) * 1000)
            self.telemetry.ask(self.clock.now_s())
            questions = self.link.sent_named("TIMESYNC")
            for question in questions[answered:]:
                self.link.deliver("TIMESYNC", {"tc1": int(now_ms * 1e6), "ts1": question["ts1"]})
            answered = len(questions)
            if i % self.heartbeat_every == 0:
                self.link.deliver("HEARTBEAT", {"custom_mode": self.mode, "base_mode": 128 if self.armed else 0})
            if i % 50 == 0:
                self.link.deliver("SYS_STATUS", {"battery_remaining": self.battery, **self.prearm})
                if not self.settings.autopilot.gps:
                    self.link.deliver("GPS_GLOBAL_ORIGIN", {"latitude": 1, "longitude": 1, "altitude": 0})
                    self.link.deliver("GLOBAL_POSITION_INT", {"lat": 1, "lon": 1})
                self.link.deliver("ESTIMATOR_STATUS" if px4 else "EKF_STATUS_REPORT", {"flags": self.flags})
            if self.streams:
                attitude = dict.fromkeys(("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"), 0.0)
                self.link.deliver("ATTITUDE", {"time_boot_ms": now_ms, **attitude})
                position = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), 0.0) | {"vy": self.v_east_mps}
                self.link.deliver("LOCAL_POSITION_NED", {"time_boot_ms": now_ms, **position})

    async def check(self, fix: bool = False, skip: Collection[str] = ()) -> dict[str, CheckResult]:
        self.listen()
        results = await run_checks(
            self.link,
            self.telemetry,
            self.settings,
            self.inputs,
            fix=fix,
            skip=skip,
            height_m=self.height_m,
            clock=self.clock,
            link_problem=self.link_problem,
        )
        self.results = results
        return {result.name: result for result in results}

    async def failures(self, **options: Any) -> list[str]:
        return [result.name for result in (await self.check(**options)).values() if result.failed]


@pytest.mark.parametrize("by_gate", [True, False])
async def test_two_who_call_themselves_our_autopilot_do_not_fly(by_gate: bool, tmp_path: Path) -> None:
    """Protects from arming another vehicle: seen by the gate at two addresses, or here as heartbeats twice as often."""
    bench = Bench(PX4, tmp_path)
    if by_gate:
        bench.link_problem = "two senders call themselves system 1 component 1"
    else:
        bench.heartbeat_every = 25
    found = (await bench.check())["link" if by_gate else "autopilot"]
    assert found.failed
    assert "two senders call themselves" in found.found
    assert found.fix


async def test_why_readings_are_refused_is_told_where_they_are_missed(tmp_path: Path) -> None:
    """Protects the integrator: frames that come and are refused are not frames that never came."""
    bench = Bench(PX4, tmp_path)
    bench.inputs["depth"] = StreamStatistics(0.0, math.inf, count=0, dropped=29, reasons={NOT_POSITIVE: 29})
    found = (await bench.check())["depth"]
    assert found.failed
    assert found.found == f"0.0 Hz, newest never came; 29 came, 29 refused: {NOT_POSITIVE}"
    assert "NaN" in found.fix


@pytest.mark.parametrize("gps", [True, False])
@pytest.mark.parametrize("kind", list(AutopilotKind))
async def test_a_vehicle_with_which_everything_is_right_may_fly(kind: AutopilotKind, gps: bool, tmp_path: Path) -> None:
    bench = Bench(kind, tmp_path, gps)
    before = dict(bench.link.params)
    assert (await bench.failures(fix=True)) == []
    assert refusal(bench.results) is None
    assert bench.link.params == before, "--fix changes only what is wrong"


@pytest.mark.parametrize(
    ("changed", "inputs", "failed"),
    [
        pytest.param({"armed": True}, {}, ["disarmed"], id="armed"),
        pytest.param({"battery": 20}, {}, ["battery"], id="empty"),
        pytest.param({"battery": -1}, {}, ["battery"], id="unknown battery"),
        pytest.param({"flags": 229}, {}, ["estimator"], id="lost"),
        pytest.param({"streams": False}, {}, ["attitude", "position", "estimator", "standing"], id="no streams"),
        pytest.param({"v_east_mps": 0.11}, {}, ["standing"], id="drifts"),
        pytest.param({}, {"depth": None}, ["depth"], id="no depth"),
        pytest.param({}, {"depth": reading(2.0)}, ["depth"], id="slow depth"),
        pytest.param({}, {"down": reading(10.0, age_s=1.0)}, ["down"], id="stale beam"),
        pytest.param({"height_m": None}, {}, ["height"], id="no height"),
        pytest.param({"height_m": 3.0}, {}, ["height"], id="impossible height"),
    ],
)
async def test_each_fault_fails_its_own_check(
    changed: dict[str, Any], inputs: dict[str, StreamStatistics | None], failed: list[str], tmp_path: Path
) -> None:
    bench = Bench(PX4, tmp_path)
    for name, value in changed.items():
        setattr(bench, name, value)
    bench.inputs = {name: one for name, one in (bench.inputs | inputs).items() if one is not None}
    assert (await bench.failures()) == failed
    message = refusal(bench.results)
    assert message is not None
    assert all(name in message for name in failed)


@pytest.mark.parametrize("kind", list(AutopilotKind))
async def test_a_vehicle_that_has_landed_may_fly_again_and_one_that_lands_may_not(
    kind: AutopilotKind, tmp_path: Path
) -> None:
    """Protects the flight after a landing: both autopilots go on showing it, with the motors off."""
    bench = Bench(kind, tmp_path)
    bench.mode = 0x06040000 if kind is PX4 else 9
    assert (await bench.failures()) == []
    bench.armed = True
    assert set(await bench.failures()) == {"disarmed", "mode"}
    bench.armed = False
    bench.mode = 0x05040000 if kind is PX4 else 6
    assert (await bench.failures()) == ["mode"], "return"


async def test_an_autopilot_that_fell_silent_fails_the_link(tmp_path: Path) -> None:
    bench = Bench(PX4, tmp_path)
    bench.listen()
    bench.clock.advance(5.0)
    bench.seconds = 0.0
    failures = await bench.failures()
    assert failures[0] == "link"
    assert {"attitude", "position", "estimator"} <= set(failures)


async def test_a_folder_that_cannot_be_written_fails_storage(tmp_path: Path) -> None:
    bench = Bench(PX4, tmp_path)
    (tmp_path / "flights").write_text("a file")
    assert (await bench.failures()) == ["storage"]


@pytest.mark.parametrize(
    ("kind", "name", "bad", "set_to"),
    [
        (PX4, "COM_OF_LOSS_T", 1.0, 0.5),
        (PX4, "COM_OF_LOSS_T", 0.0, 0.5),
        (PX4, "COM_OBL_RC_ACT", 0, 5),
        (PX4, "COM_RCL_EXCEPT", 0, 6),
        (PX4, "COM_RCL_EXCEPT", 4, 6),
        (PX4, "COM_RCL_EXCEPT", 1 | 2, 1 | 6),
        (PX4, "COM_RCL_EXCEPT", 4 | 8, 6 | 8),
        (PX4, "NAV_DLL_ACT", 1, 0),
        (PX4, "NAV_DLL_ACT", 2, 0),
        (PX4, "COM_LOW_BAT_ACT", 0, 2),
        (PX4, "COM_LOW_BAT_ACT", 3, 2),
        (PX4, "BAT_CRIT_THR", 0.0, 0.07),
        (PX4, "BAT_CRIT_THR", 0.3, 0.07),
        (PX4, "BAT_LOW_THR", 0.0, 0.15),
        (PX4, "COM_DISARM_PRFLT", 10.0, 15.0),
        (PX4, "COM_DISARM_PRFLT", 1.0, 15.0),
        (PX4, "EKF2_NOAID_TOUT", 5_000_000, 1_000_000),
        (PX4, "MPC_XY_CRUISE", 5.0, 1.0),
        (PX4, "MPC_XY_CRUISE", 0.0, 1.0),
        (PX4, "MPC_XY_VEL_MAX", 0.1, 0.5),
        (ARDUPILOT, "GUID_TIMEOUT", 3.0, 0.5),
        (ARDUPILOT, "GUID_OPTIONS", 8, 0),
        (ARDUPILOT, "AVOID_ENABLE", 3, 0),
        (ARDUPILOT, "FS_THR_ENABLE", 1, 3),
        (ARDUPILOT, "FS_GCS_ENABLE", 1, 0),
        (ARDUPILOT, "BATT_FS_LOW_ACT", 0, 1),
        (ARDUPILOT, "BATT_FS_LOW_ACT", 2, 1),
        (ARDUPILOT, "BATT_FS_LOW_ACT", 7, 1),
        (ARDUPILOT, "BATT_FS_CRT_ACT", 0, 1),
        (ARDUPILOT, "WPNAV_ACCEL", 500.0, 250.0),
        (ARDUPILOT, "WPNAV_ACCEL", 0.0, 250.0),
        (ARDUPILOT, "PSC_JERK_XY", 2.0, 5.0),
    ],
)
async def test_a_dangerous_parameter_stops_the_flight_and_fix_sets_it(
    kind: AutopilotKind, name: str, bad: float, set_to: float, tmp_path: Path
) -> None:
    bench = Bench(kind, tmp_path)
    bench.link.params[name] = bad
    results = await bench.check()
    assert [result.name for result in results.values() if result.failed] == [name]
    assert f"param set {name} {set_to:.7g}" in results[name].fix
    assert bench.link.params[name] == bad, "nothing is set without --fix"
    fixed = (await bench.check(fix=True))[name]
    assert fixed.ok
    assert fixed.fix.startswith("set by --fix")
    assert bench.link.params[name] == pytest.approx(set_to)
    assert (await bench.failures()) == []


@pytest.mark.parametrize(
    ("kind", "changed", "failed"),
    [
        (PX4, {"COM_RCL_EXCEPT": 0, "NAV_RCL_ACT": 3}, []),
        (PX4, {"COM_RCL_EXCEPT": 0, "NAV_RCL_ACT": 1}, ["COM_RCL_EXCEPT"]),
        (PX4, {"COM_RCL_EXCEPT": 2, "NAV_RCL_ACT": 2}, ["COM_RCL_EXCEPT"]),
        (PX4, {"COM_RCL_EXCEPT": 7, "NAV_RCL_ACT": 2}, []),
        (PX4, {"NAV_DLL_ACT": 3}, []),
        (PX4, {"NAV_DLL_ACT": 2, "COM_DLL_EXCEPT": 4}, ["NAV_DLL_ACT"]),
        (PX4, {"NAV_DLL_ACT": 2, "COM_DLL_EXCEPT": 6}, []),
        (PX4, {"COM_DISARM_PRFLT": 0.0}, []),
        (PX4, {"COM_DISARM_PRFLT": -1.0}, []),
        (PX4, {"MPC_XY_CRUISE": 0.5}, []),
        (ARDUPILOT, {"WPNAV_ACCEL": 100.0, "PSC_JERK_XY": 10.0}, []),
    ],
)
async def test_what_is_as_safe_by_another_way_may_stay(
    kind: AutopilotKind, changed: dict[str, float], failed: list[str], tmp_path: Path
) -> None:
    """Protects against the return that climbs: a hold after a lost transmitter needs both its exceptions, or a land."""
    bench = Bench(kind, tmp_path)
    bench.link.params |= changed
    assert (await bench.failures()) == failed


async def test_ardupilot_that_would_refuse_to_arm_is_not_asked_to(tmp_path: Path) -> None:
    """Protects whoever has stepped back from it: its reasons are told before. PX4's bit is only shown."""
    for kind, failed in ((ARDUPILOT, ["prearm"]), (PX4, [])):
        bench = Bench(kind, tmp_path)
        bench.prearm["onboard_control_sensors_health"] = 0
        bench.link.deliver("STATUSTEXT", {"severity": 2, "text": "PreArm: Gyros inconsistent"})
        assert (await bench.failures()) == failed
        found = next(one.found for one in bench.results if one.name == "prearm")
        assert ("Gyros inconsistent" in found) == (kind is ARDUPILOT)


async def test_a_value_that_only_the_owner_knows_is_not_guessed_by_fix(tmp_path: Path) -> None:
    """Protects a battery with more cells from the voltage of one with three."""
    bench = Bench(ARDUPILOT, tmp_path)
    bench.link.params["BATT_LOW_VOLT"] = 0.0
    result = (await bench.check(fix=True))["BATT_LOW_VOLT"]
    assert result.failed
    assert "about 3.5 V a cell" in result.fix
    assert "100 %" in result.reason
    assert bench.link.params["BATT_LOW_VOLT"] == 0.0


@pytest.mark.parametrize("name", ["WPNAV_ACCEL", "PSC_JERK_XY"])
async def test_ardupilot_without_what_its_braking_rests_on_does_not_fly(name: str, tmp_path: Path) -> None:
    """Protects against a later version that calls it by another name: what nobody has read is not known."""
    bench = Bench(ARDUPILOT, tmp_path)
    del bench.link.params[name]
    assert (await bench.failures()) == [name]


async def test_ardupilots_avoidance_may_stay_when_it_cannot_push(tmp_path: Path) -> None:
    """By default it flies backwards in front of a wall; below d_c and without backing up it does no harm."""
    bench = Bench(ARDUPILOT, tmp_path)
    bench.link.params |= {"AVOID_ENABLE": 3, "AVOID_MARGIN": 0.5, "AVOID_BACKUP_SPD": 0.0}
    assert (await bench.failures()) == []
    bench.link.params["AVOID_MARGIN"] = bench.settings.control.critical_margin_m
    assert (await bench.failures()) == ["AVOID_ENABLE"]
    bench.link.params |= {"AVOID_MARGIN": 0.5, "AVOID_BACKUP_SPD": 0.75}
    assert (await bench.failures()) == ["AVOID_ENABLE"]


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -1.0])
async def test_no_odd_value_passes_for_a_timeout(bad: float, tmp_path: Path) -> None:
    bench = Bench(PX4, tmp_path)
    bench.link.params["COM_OF_LOSS_T"] = bad
    assert (await bench.failures()) == ["COM_OF_LOSS_T"]


async def test_a_missing_parameter_is_told_and_stops_only_where_it_must(tmp_path: Path) -> None:
    bench = Bench(PX4, tmp_path)
    del bench.link.params["EKF2_NOAID_TOUT"], bench.link.params["COM_OF_LOSS_T"]
    results = await bench.check(fix=True)
    assert results["EKF2_NOAID_TOUT"].ok
    assert results["EKF2_NOAID_TOUT"].found == "the autopilot has no such parameter"
    assert results["COM_OF_LOSS_T"].failed


async def test_a_parameter_that_cannot_be_read_or_set_is_a_failed_check_and_no_crash(tmp_path: Path) -> None:
    bench = Bench(PX4, tmp_path)
    bench.link.params["COM_OBL_RC_ACT"] = 0
    bench.link.frozen_params = {"COM_OBL_RC_ACT"}
    bench.link.silent_params = {"COM_OF_LOSS_T"}
    results = await bench.check(fix=True)
    assert [name for name, result in results.items() if result.failed] == ["COM_OF_LOSS_T", "COM_OBL_RC_ACT"]
    assert "read back" in results["COM_OBL_RC_ACT"].fix


@pytest.mark.parametrize("kind", list(AutopilotKind))
async def test_without_gps_its_parameters_are_checked_and_need_a_reboot(kind: AutopilotKind, tmp_path: Path) -> None:
    """What the autopilot obeys only after a reboot is not done when it is set."""
    bench = Bench(kind, tmp_path, gps=False)
    name = "EKF2_HGT_REF" if kind is PX4 else "VISO_TYPE"
    wanted = bench.link.params[name]
    bench.link.params[name] = 0
    result = (await bench.check(fix=True))[name]
    assert result.failed
    assert "reboot" in result.fix
    assert bench.link.params[name] == wanted
    assert (await bench.failures()) == []


async def test_with_gps_the_parameters_of_flying_without_are_not_asked_for(tmp_path: Path) -> None:
    bench = Bench(PX4, tmp_path)
    assert set(WITHOUT_GPS[PX4]).isdisjoint(await bench.check())


async def test_a_skipped_check_is_on_record_and_stops_nothing(tmp_path: Path) -> None:
    bench = Bench(PX4, tmp_path)
    bench.link.params["COM_OBL_RC_ACT"] = 0
    bench.height_m = None
    results = await bench.check(fix=True, skip=("height", "COM_OBL_RC_ACT", "GUID_TIMEOUT"))
    assert refusal(bench.results) is None
    assert [result.name for result in results.values() if result.skipped] == ["height", "COM_OBL_RC_ACT"]
    assert bench.link.params["COM_OBL_RC_ACT"] == 0, "what is skipped is not fixed either"


@pytest.mark.parametrize("kind", list(AutopilotKind))
async def test_braking_that_was_not_measured_stops_both_until_somebody_skips_it(
    kind: AutopilotKind, tmp_path: Path
) -> None:
    """Protects whoever counts on more than was measured; who has measured their own vehicle may skip it."""
    bench = Bench(kind, tmp_path)
    assert (await bench.failures(fix=True)) == [], "the default is what was measured"
    bench.settings = bench.settings.model_copy(
        update={"control": Settings.model_validate({"control": {"governor": {"brake_mps2": 0.8}}}).control}
    )
    assert (await bench.failures(fix=True)) == ["braking"]
    assert (await bench.failures(skip=("braking",))) == []
    assert [result.name for result in bench.results if result.skipped] == ["braking"]


async def test_a_check_that_does_not_exist_cannot_be_skipped(tmp_path: Path) -> None:
    bench = Bench(PX4, tmp_path)
    with pytest.raises(InputError, match=r"cannot skip batery: no such check\. The checks are: link, .*battery"):
        (await bench.check(skip=("batery",)))


@pytest.mark.parametrize("kind", list(AutopilotKind))
async def test_every_check_can_be_skipped_by_its_name(kind: AutopilotKind, tmp_path: Path) -> None:
    bench = Bench(kind, tmp_path, gps=False)
    assert set(await bench.check()) <= set(check_names(bench.settings))


async def test_the_table_fits_a_terminal_and_says_what_to_do(tmp_path: Path) -> None:
    bench = Bench(PX4, tmp_path)
    bench.link.params["COM_OBL_RC_ACT"] = 0
    bench.link.params["COM_OF_LOSS_T"] = 1.0
    (await bench.check(skip=("height",)))
    table = render(bench.results)
    assert max(map(len, table.splitlines())) <= 110
    assert "param set COM_OBL_RC_ACT 5, or --fix" in " ".join(table.split())
    assert f"{len(bench.results) - 3} passed, 2 failed, 1 skipped" in table
