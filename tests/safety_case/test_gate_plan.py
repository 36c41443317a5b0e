"""From settings to the gate's plan, and the refusal of a configuration in which a wall can be reached."""

from __future__ import annotations

from typing import Any

import pytest

from companion.config.load import load_settings, preset_names
from companion.config.settings import Settings
from companion.errors import InputError
from companion.gate.faults import Fault, Stage
from companion.gate.plan import Attached, Plan, Signing
from companion.safety_case.gate_plan import refuse_if_reachable, stopping_lines, to_plan


def plan_of(values: dict[str, Any] | None = None) -> Plan:
    settings = Settings.model_validate(values or {})
    return to_plan(settings, command=("fly",), restart_command=("wait",), inherit=(5,))


def refused(values: dict[str, Any]) -> str:
    with pytest.raises(InputError) as caught:
        refuse_if_reachable(Settings.model_validate(values))
    return str(caught.value)


class TestPlan:
    """Every setting arrives, in the gate's words."""

    def test_it_survives_the_way_to_the_gate(self) -> None:
        for preset in preset_names():
            plan = to_plan(load_settings(preset=preset), command=("a", "b"), restart_command=("c",))
            assert Plan.loads(plan.dumps()) == plan

    def test_commands_and_numbers(self) -> None:
        plan = plan_of({"autopilot": {"system_id": 7, "url": "tcpout://h:1"}, "safety": {"restarts": 2}})
        assert (plan.command, plan.restart_command, plan.inherit) == (("fly",), ("wait",), (5,))
        assert (plan.system_id, plan.autopilot_url, plan.restarts) == (7, "tcpout://h:1", 2)
        assert plan.silence_s == Settings().autopilot.silence_s
        assert plan.stopping.brake_mps2 == Settings().control.governor.brake_mps2

    def test_what_is_left_out_has_become_a_number(self) -> None:
        plan = plan_of()
        assert plan.limits.speed_mps == pytest.approx(0.55)
        assert plan.thresholds.setpoint_s == pytest.approx(0.12)
        assert plan.thresholds.hard_limit_m == pytest.approx(0.575)

    def test_heights_become_depths(self) -> None:
        """North-east-down: the highest height is the least down."""
        fence = plan_of({"safety": {"fence": {"height_m": (-1.0, 6.0), "north_m": (-2.0, 3.0)}}}).fence
        assert fence.down_m == (-6.0, 1.0)
        assert fence.north_m == (-2.0, 3.0)
        assert fence.east_m is None
        assert plan_of().fence.down_m is None

    def test_answers(self) -> None:
        reactions = plan_of({"safety": {"reactions": {"map": {"first": "hold"}}}}).reactions
        assert reactions[Fault.MAP].first is Stage.HOLD
        assert reactions[Fault.ESTIMATOR].first is Stage.LAND
        assert (reactions[Fault.DEPTH_STALE].hold_after_s, reactions[Fault.DEPTH_STALE].land_after_s) == (5.0, 30.0)
        assert plan_of().reactions[Fault.MAP].first is Stage.PASS

    def test_what_the_new_faults_are_judged_by(self) -> None:
        """A setting that does not arrive is one that nobody has."""
        plan = plan_of(
            {
                "autopilot": {"gps": False},
                "safety": {
                    "stale": {"aiding_s": 0.3, "gps_s": 0.4, "odometry_s": 0.2},
                    "not_obeyed_mps": 0.25,
                    "battery_v": 13.2,
                    "creep_m": 0.1,
                },
            }
        )
        limit = plan.thresholds
        assert (limit.aiding_s, limit.gps_s, limit.odometry_s) == (0.3, 0.4, 0.2)
        assert (limit.not_obeyed_mps, limit.battery_v, plan.stopping.creep_m, plan.gps) == (0.25, 13.2, 0.1, False)
        assert plan_of({"autopilot": {"gps": True}}).gps
        assert plan_of().thresholds.battery_v is None

    def test_partners_and_signing(self) -> None:
        plan = plan_of(
            {"safety": {"attached": ({"url": "udpin://:1", "may": "odometry"},), "signing": {"key_file": "/k"}}}
        )
        assert plan.attached == (Attached("udpin://:1", "odometry"),)
        assert plan.signing == Signing("/k", 1)
        assert plan_of().signing is None


class TestRefusal:
    """A flight in which a fault can end in a wall is not begun."""

    @pytest.mark.parametrize("level", ["normal", "cautious"])
    def test_what_we_fly_passes(self, level: str) -> None:
        for preset in ("flight", "swift", "table_ii"):
            settings = load_settings(preset=preset)
            flown = Settings.model_validate(settings.model_dump() | {"safety": {"level": level}})
            refuse_if_reachable(flown)

    def test_table_i_is_not_to_be_flown(self) -> None:
        """The paper's simulation: full speed until d_c, and d_c too near for a real autopilot's failsafe."""
        with pytest.raises(InputError) as caught:
            refuse_if_reachable(load_settings(preset="table_i"))
        assert "control.speed_law: paper" in str(caught.value)

    def test_faster_is_refused_with_fault_values_and_what_to_change(self) -> None:
        said = refused({"control": {"speed_mps": 1.0}})
        assert "gate killed: " in said
        assert "autopilot.silence_s = 0.5" in said
        for key in ("control.speed_mps = 1", "safety.limits.speed_mps", "control.critical_margin_m = 0.8"):
            assert key in said

    def test_a_larger_body_is_refused(self) -> None:
        assert "vehicle.body_radius_m = 0.5" in refused({"vehicle": {"body_radius_m": 0.5}})

    def test_a_lazy_threshold_is_refused_by_its_key(self) -> None:
        said = refused({"safety": {"stale": {"depth_s": 1.0, "setpoint_s": 1.0}}})
        assert "safety.stale.depth_s = 1)" in said
        assert "setpoint_late: " in said
        assert "ranges_stale" not in said

    def test_a_threshold_that_is_left_out_is_called_null(self) -> None:
        assert "safety.stale.setpoint_s = null" in refused({"safety": {"stale": {"pose_s": 1.0}}})

    def test_what_the_pilot_is_only_told_of_does_not_count(self) -> None:
        lines = {line.fault: line for line in stopping_lines(Settings())}
        assert not lines["map"].stops
        assert not lines["map"].reaches_wall
