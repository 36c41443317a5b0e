"""The section `safety`: what is refused, what a level fills in, and what it must not fill in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from companion.config.load import load_settings, preset_names
from companion.config.reactions import ANSWERS, HARMLESS, ReactionsSettings
from companion.config.safety import CAUTIOUS, SafetySettings
from companion.config.settings import Settings
from companion.config.show import dump_yaml
from companion.gate.faults import Fault
from companion.gate.obedience import STAND_MPS
from companion.station_keeping import MOST_MPS
from tests.config.conftest import Write
from tests.config.conftest import refusal as lines_of_refusal

Refusal = Callable[[str], str]


@pytest.fixture
def refusal(write: Write) -> Refusal:
    """Loads a file that must be refused and gives the one line that says why."""

    def refuse(text: str) -> str:
        (line,) = lines_of_refusal(write(text))
        return line

    return refuse


def safety(**values: Any) -> SafetySettings:
    return SafetySettings.model_validate(values)


def test_every_fault_has_its_answer_and_no_other_word_is_one() -> None:
    """A fault without a key could not be configured; the words are those that the pilot reads."""
    assert set(ReactionsSettings.model_fields) == {fault.value for fault in Fault}
    for level, answers in ANSWERS.items():
        assert set(answers) == set(Fault)
        filled = safety(level=level).reactions.by_fault()
        assert {fault: (it.first, it.hold_after_s, it.land_after_s) for fault, it in filled.items()} == answers


@pytest.mark.parametrize("level", ["normal", "cautious"])
def test_only_harmless_faults_are_only_told(level: Any) -> None:
    """The defaults keep the rule that files have to keep."""
    assert {fault for fault, answer in ANSWERS[level].items() if answer[0] == "tell"} <= HARMLESS


def test_who_is_led_back_to_its_place_cannot_be_called_disobedient(refusal: Refusal) -> None:
    """A limit within what keeps a place would end each stop with a hold."""
    said = refusal("safety: {not_obeyed_mps: 0.1}\n")
    assert "safety.not_obeyed_mps" in said
    assert "0.15" in said
    assert safety(not_obeyed_mps=0.15).not_obeyed_mps > STAND_MPS > MOST_MPS


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("battery_v", "0"),
        ("battery_v", ".nan"),
        ("creep_m", "-0.1"),
        ("creep_m", ".inf"),
        ("hold_creep_m", "-0.1"),
        ("hold_creep_m", ".nan"),
        ("not_obeyed_mps", ".nan"),
    ],
)
def test_numbers_that_would_switch_a_fault_off_or_make_no_sense_are_refused(
    key: str, value: str, refusal: Refusal
) -> None:
    """A battery is not judged by null, which says so; a creep below nothing would lengthen every way."""
    assert f"safety.{key}" in refusal(f"safety: {{{key}: {value}}}\n")


@pytest.mark.parametrize(("key", "value"), [("aiding_s", "0.1"), ("gps_s", "0.2"), ("odometry_s", "0.01")])
def test_who_misses_too_soon_is_refused(key: str, value: str, refusal: Refusal) -> None:
    """A threshold below the spacing of the messages would be a fault in each flight."""
    assert f"safety.stale.{key}" in refusal(f"safety: {{stale: {{{key}: {value}}}}}\n")


class TestLevel:
    """`level: cautious` fills what the file leaves out, and nothing else."""

    def test_every_number_is_stricter(self) -> None:
        """A cautious number that is laxer would be the opposite of what was asked for."""
        grows = {"battery_percent", "recover_s", "autopilot_delay_s"}
        for section, values in CAUTIOUS.items():
            for key, value in values.items():
                normal = getattr(getattr(safety(), section) if section else safety(), key)
                assert (value > normal) if key in grows else (value < normal), f"{section}.{key}"

    def test_it_fills_in(self) -> None:
        filled = safety(level="cautious")
        for section, values in CAUTIOUS.items():
            found = getattr(filled, section) if section else filled
            assert {key: getattr(found, key) for key in values} == values

    def test_what_the_file_says_stays(self) -> None:
        filled = safety(
            level="cautious", stale={"depth_s": 0.9}, reactions={"depth_stale": {"hold_after_s": 4.0}}, recover_s=0.5
        )
        assert (filled.stale.depth_s, filled.stale.ranges_s, filled.recover_s) == (0.9, 0.3, 0.5)
        answer = filled.reactions.depth_stale
        assert (answer.first, answer.hold_after_s, answer.land_after_s) == ("brake", 4.0, 15.0)

    def test_one_level_leaves_the_other_alone(self) -> None:
        """Defaults are shared objects: filling one in must not change the next."""
        safety(level="cautious")
        assert safety().stale.depth_s == 0.55

    def test_what_is_left_out_follows_the_law(self) -> None:
        control = Settings().control
        assert safety().effective_limits(control).speed_mps == pytest.approx(1.1 * control.speed_mps)
        assert safety(level="cautious").effective_limits(control).speed_mps == pytest.approx(1.05 * control.speed_mps)
        assert safety().beat_late_s(control) == pytest.approx(0.12)
        assert safety(stale={"beat_s": 0.3}).beat_late_s(control) == 0.3
        slow = control.model_copy(update={"period_s": 0.1})
        assert safety().setpoint_late_s(slow) == pytest.approx(0.24)
        assert safety(limits={"climb_mps": 1.5}).effective_limits(control).climb_mps == 1.5
        assert safety().effective_limits(control).yaw_rate_radps == pytest.approx(1.1 * control.max_yaw_rate_radps)

    @pytest.mark.parametrize("preset", preset_names())
    def test_every_preset_can_be_cautious_and_is_shown_so_that_it_loads_again(
        self, preset: str, tmp_path: Path
    ) -> None:
        file = tmp_path / "vehicle.yaml"
        file.write_text("safety: {level: cautious}\n", encoding="utf-8")
        cautious = load_settings(file, preset)
        file.write_text(dump_yaml(cautious), encoding="utf-8")
        assert load_settings(file, preset) == cautious


class TestReactions:
    """Delays belong to their first answer."""

    @pytest.mark.parametrize(
        ("given", "filled"),
        [
            ({"first": "land"}, ("land", None, None)),
            ({"first": "hold"}, ("hold", None, 30.0)),
            ({"first": "brake"}, ("brake", 5.0, 30.0)),
            ({"land_after_s": 40.0}, ("brake", 5.0, 40.0)),
            ({"hold_after_s": None}, ("brake", None, 30.0)),
        ],
    )
    def test_what_is_left_out(self, given: dict[str, Any], filled: tuple[Any, ...]) -> None:
        answer = safety(reactions={"depth_stale": given}).reactions.depth_stale
        assert (answer.first, answer.hold_after_s, answer.land_after_s) == filled

    def test_an_answer_milder_than_the_faults_own_gets_delays(self) -> None:
        """`estimator: {first: brake}` must not brake for ever because its own answer, landing, has no delays."""
        answer = safety(reactions={"estimator": {"first": "brake"}}).reactions.estimator
        assert (answer.hold_after_s, answer.land_after_s) == (5.0, 30.0)

    @pytest.mark.parametrize("first", ["tell", "hold", "land", "brake"])
    def test_the_map_may_have_any(self, first: str) -> None:
        assert safety(reactions={"map": {"first": first}}).reactions.map.first == first


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("limits: {speed_mps: 0.4}", "safety.limits.speed_mps = 0.4 m/s must not be below control.speed_mps = 0.5 m/s"),
        ("limits: {climb_mps: 0.3}", "safety.limits.climb_mps = 0.3 m/s must not be below control.max_climb_mps"),
        ("limits: {yaw_rate_radps: 0.5}", "safety.limits.yaw_rate_radps = 0.5 rad/s must not be below "),
        ("distance: {hard_limit_m: 0.35}", "safety.distance.hard_limit_m = 0.35 m must be greater than vehicle.body_"),
        (
            "distance: {hard_limit_m: 0.8}",
            "safety.distance.hard_limit_m = 0.8 m must be smaller than control.critical_",
        ),
        (
            "stale: {setpoint_s: 0.07}",
            "safety.stale.setpoint_s = 0.07 s must be at least 0.075 s with control.period_s",
        ),
        ("stale: {beat_s: 0.07}", "safety.stale.beat_s = 0.07 s must be at least 0.075 s with control.period_s = 0.05"),
        ("stale: {depth_s: 0.29}", "safety.stale.depth_s = 0.29 s must be at least 0.3 s with sensors.camera.rate_hz"),
        ("stale: {ranges_s: 0.14}", "safety.stale.ranges_s = 0.14 s must be at least 0.15 s with sensors.beams.rate"),
        (
            "stale: {link_s: 0.05}\nautopilot: {position_hz: 20}",
            "safety.stale.link_s = 0.05 s must be at least 0.075 s",
        ),
        ("stale: {pose_s: 0.1}\nautopilot: {position_hz: 10}", "safety.stale.pose_s = 0.1 s must be at least 0.15 s"),
        ("pose: {frozen_s: 0.05}", "safety.pose.frozen_s = 0.05 s must be at least 0.06 s with autopilot.position_hz"),
        ("stale: {hang_s: 1.0, beat_s: 1.0}", "safety.stale.hang_s = 1 s must be greater than safety.stale.beat_s = 1"),
        ("battery_percent: 25", "safety.battery_percent = 25 must be smaller than mission.battery_low_percent = 25"),
        (
            "battery_v: 10.5\nmission: {battery_low_v: 10.5}",
            "safety.battery_v = 10.5 V must be smaller than mission.battery_low_v = 10.5 V",
        ),
        ("battery_v: 0", "safety.battery_v"),
        ("fence: {north_m: [5, -5]}", "safety.fence.north_m = [5, -5] must be [least, most]"),
        ("fence: {east_m: [5, 9]}", "safety.fence.east_m = [5, 9] must hold 0"),
        ("fence: {height_m: [0, 9]}", "safety.fence.height_m = [0, 9] must hold 0"),
        ("fence: {height_m: [-1, 1.5]}", "safety.fence.height_m = [-1, 1.5] must reach above control.height_m = 1.5"),
        ("reactions: {flood: {land_after_s: 5}}", "safety.reactions.flood.land_after_s = 5 s must be greater than "),
        ("reactions: {flood: {first: tell}}", "safety.reactions.flood.first: tell leaves the vehicle flying although"),
        (
            "reactions: {flood: {first: land, land_after_s: 9}}",
            "safety.reactions.flood.land_after_s = 9 s cannot foll",
        ),
        (
            "reactions: {flood: {first: land, hold_after_s: 9}}",
            "safety.reactions.flood.hold_after_s = 9 s cannot foll",
        ),
        (
            "reactions: {flood: {first: hold, hold_after_s: 9}}",
            "safety.reactions.flood.hold_after_s = 9 s cannot foll",
        ),
    ],
)
def test_nonsense_is_refused_with_its_value_and_bound(refusal: Refusal, text: str, said: str) -> None:
    """One line: where, which key, which value, which bound."""
    line = refusal(f"safety:\n  {text}\n")
    assert line.startswith(("vehicle.yaml:2: ", "default: ")), line
    assert said in line


def test_a_voltage_of_the_gate_may_stand_alone_or_below_the_missions() -> None:
    """Each is judged where it is given."""
    assert (Settings().mission.battery_low_v, Settings().safety.battery_v) == (None, None)
    for mission, safety in (({}, {"battery_v": 10.0}), ({"battery_low_v": 10.5}, {"battery_v": 10.0})):
        assert Settings.model_validate({"mission": mission, "safety": safety}).safety.battery_v == 10.0


def test_none_watches_no_battery(tmp_path: Path) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text("mission: {battery_low_percent: 0}\nsafety: {battery_percent: 0}\n", encoding="utf-8")
    assert load_settings(file).safety.battery_percent == 0.0


def test_the_hard_limit_lies_between_body_and_critical_margin() -> None:
    """Left out it fits every vehicle that fits its margins."""
    settings = Settings()
    assert settings.vehicle.body_radius_m < settings.hard_limit_m < settings.control.critical_margin_m
    assert Settings.model_validate({"safety": {"distance": {"hard_limit_m": 0.5}}}).hard_limit_m == 0.5


class TestAttached:
    """Each partner has a place of its own; nothing else listens."""

    def test_none_by_default(self) -> None:
        assert safety().attached == ()

    @pytest.mark.parametrize(
        "urls",
        [
            ["udpout://10.0.0.2:14550", "udpout://10.0.0.2:14550"],
            ["udpin://0.0.0.0:14540"],
            ["udpin://127.0.0.1:14540"],
            ["tcpin://0.0.0.0:5760", "tcpin://127.0.0.1:5760"],
            ["serial:///dev/ttyUSB0:57600", "serial:///dev/ttyUSB0:115200"],
        ],
    )
    def test_two_at_one_place(self, refusal: Refusal, urls: list[str]) -> None:
        listed = ", ".join(f"{{url: '{url}'}}" for url in urls)
        assert "is the same place as" in refusal(f"safety:\n  attached: [{listed}]\n")

    def test_different_places(self) -> None:
        urls = ["udpout://10.0.0.2:14550", "udpout://10.0.0.3:14550", "udpin://0.0.0.0:14550", "tcpin://0.0.0.0:14540"]
        attached = [{"url": url, "may": "command"} for url in urls]
        assert len(Settings.model_validate({"safety": {"attached": attached}}).safety.attached) == 4

    def test_no_such_address_and_no_such_right(self, refusal: Refusal) -> None:
        assert "safety.attached.0.url" in refusal("safety:\n  attached: [{url: 'http://x'}]\n")
        assert "safety.attached.0.may" in refusal("safety:\n  attached: [{url: 'udpin://:1', may: fly}]\n")


class TestSigning:
    """A key file is named from the root: nobody knows from where the service is started."""

    @pytest.mark.parametrize("path", ["signing.key", "./key", "~/key", ""])
    def test_relative(self, refusal: Refusal, path: str) -> None:
        line = refusal(f"safety:\n  signing: {{key_file: '{path}'}}\n")
        assert "safety.signing.key_file" in line
        assert "an absolute path" in line

    def test_absolute(self) -> None:
        assert safety(signing={"key_file": "/etc/companion/key"}).signing.key_file == "/etc/companion/key"
