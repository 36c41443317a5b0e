"""Loading settings: what is put over what, and what is said about values that cannot be used."""

from __future__ import annotations

import pytest

from companion.config.load import load, load_settings, preset_names
from companion.config.settings import Settings
from companion.model import Beam
from tests.config.conftest import Write, refusal


class TestLayers:
    """Defaults < preset < file."""

    def test_presets_that_ship(self) -> None:
        assert preset_names() == ("flight", "swift", "table_i", "table_ii")

    @pytest.mark.parametrize("preset", preset_names())
    def test_every_preset_loads(self, preset: str) -> None:
        assert load(preset=preset).preset == preset

    def test_without_a_choice_the_preset_is_flight(self) -> None:
        assert load_settings() == load_settings(preset="flight")

    @pytest.mark.parametrize(
        "text", ["", "\n", "# nothing\n", "---\n", "null\n", "control:\n", "sensors:\n  camera:\n", "\ufeffcontrol:\n"]
    )
    def test_a_file_that_sets_nothing_changes_nothing(self, write: Write, text: str) -> None:
        assert load_settings(write(text)) == load_settings()

    def test_file_over_preset_over_defaults(self, write: Write) -> None:
        loaded = load(write("preset: table_i\ncontrol:\n  margin_m: 1.5\n"))
        assert loaded.preset == "table_i"
        assert loaded.settings.control.margin_m == 1.5  # the file's
        assert loaded.settings.control.max_yaw_rate_radps == 0.3  # the preset's
        assert loaded.settings.control.pause_s == Settings().control.pause_s

    def test_the_argument_overrides_the_preset_of_the_file(self, write: Write) -> None:
        loaded = load(write("preset: table_i\ncontrol:\n  margin_m: 1.5\n"), preset="table_ii")
        assert loaded.preset == "table_ii"
        assert loaded.settings.control.height_m == 0.7
        assert loaded.settings.control.margin_m == 1.5

    def test_values_of_every_kind(self, write: Write) -> None:
        file = write(
            "control:\n  law: paper\n  speed_mps: 4e-1\n  margin_m: 1\n  climb_feed_forward: false\n"
            "fleet: {largest_group: 0x2}\nsensors:\n  beams:\n    directions:\n      - down\n      - 'front'\n"
        )
        loaded = load_settings(file)
        assert loaded.control.law == "paper"
        assert loaded.control.speed_mps == 0.4
        assert loaded.control.climb_feed_forward is False
        assert loaded.fleet.largest_group == 2
        assert loaded.sensors.beams.directions == (Beam.DOWN, Beam.FRONT)


class TestValues:
    """Single settings that do not fit."""

    @pytest.mark.parametrize(
        ("text", "key", "meant"),
        [
            ("control: {margin_mm: 1}", "control.margin_mm", "control.margin_m"),
            ("controll: {}", "controll", "control"),
            ("margin_m: 1", "margin_m", "control.margin_m"),
            ("control: {brake_mps2: 1}", "control.brake_mps2", "control.governor.brake_mps2"),
            ("sensors: {camera: {widht_px: 99}}", "sensors.camera.widht_px", "sensors.camera.width_px"),
        ],
    )
    def test_unknown_key(self, write: Write, text: str, key: str, meant: str) -> None:
        assert refusal(write(text)) == [f"vehicle.yaml:1: {key}: unknown key; did you mean {meant}?"]

    def test_unknown_key_like_none(self, write: Write) -> None:
        (line,) = refusal(write("vehicle: {zzz: 1}"))
        assert line == "vehicle.yaml:1: vehicle.zzz: unknown key; known here: body_radius_m, body_height_m"

    @pytest.mark.parametrize(
        ("key", "value", "expected"),
        [
            ("speed_mps", "fast", 'value "fast", expected a number'),
            ("speed_mps", "'0.5'", 'value "0.5", expected a number'),
            ("speed_mps", "0,5", 'value "0,5", expected a number'),
            ("speed_mps", "true", "value true, expected a number"),
            ("speed_mps", "", "value null, expected a number"),
            ("speed_mps", "[1, 2]", "value [1, 2], expected a number"),
            ("speed_mps", ".nan", "value NaN, expected a finite number"),
            ("speed_mps", "-.inf", "value -Infinity, expected a finite number"),
            ("speed_mps", "1e999", "value Infinity, expected a finite number"),
            ("climb_feed_forward", "yes", 'value "yes", expected true or false'),
            ("climb_feed_forward", "1", "value 1, expected true or false"),
            ("law", "papr", "value \"papr\", expected 'paper' or 'smooth'"),
            ("governor", "3", "value 3, expected keys and values, indented below it"),
        ],
    )
    def test_wrong_type(self, write: Write, key: str, value: str, expected: str) -> None:
        (line,) = refusal(write(f"control:\n  {key}: {value}\n"))
        assert line.startswith(f"vehicle.yaml:2: control.{key}: not usable: {expected}; correct it")

    @pytest.mark.parametrize(
        ("section", "key", "value", "bound"),
        [
            ("control", "tangent_probability", "0", "> 0 and < 1"),
            ("control", "tangent_probability", "1", "> 0 and < 1"),
            ("control", "margin_m", "-1", ">= 0.3 and <= 10"),
            ("fleet", "largest_group", "99999999999999999999999", ">= 1 and <= 20"),
        ],
    )
    def test_out_of_range(self, write: Write, section: str, key: str, value: str, bound: str) -> None:
        (line,) = refusal(write(f"{section}:\n  {key}: {value}\n"))
        assert line.startswith(
            f"vehicle.yaml:2: {section}.{key}: out of range: value {value}, bound {bound}; choose a value within it"
        )

    @pytest.mark.parametrize(
        ("folder", "says"),
        [
            ("$HOME/flights", "names a variable"),
            ("/data/${DAY}", "names a variable"),
            ("C:\\\\flights", "is a path of Windows"),
            ("C:/flights", "is a path of Windows"),
            ("data\\\\flights", "is a path of Windows"),
            ("~nobody-of-this-name/flights", "there is nobody called"),
        ],
    )
    def test_a_folder_that_only_a_shell_would_understand(self, write: Write, folder: str, says: str) -> None:
        """Protects from a folder that is called $HOME, with the recording of the flight in it."""
        (line,) = refusal(write(f'record:\n  folder: "{folder}"\n'))
        assert line.startswith("vehicle.yaml:2: record.folder: ")
        assert says in line

    def test_the_home_of_a_person_is_meant(self, write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
        """Protects from a folder that is called ~ ."""
        monkeypatch.setenv("HOME", "/home/miner")
        assert load_settings(write('record:\n  folder: "~/flights"\n')).record.folder == "/home/miner/flights"
        assert load_settings(write("record:\n  folder: my flights~\n")).record.folder == "my flights~"

    def test_element_of_a_list(self, write: Write) -> None:
        (line,) = refusal(write("sensors:\n  beams:\n    directions:\n      - down\n      - frnt\n"))
        assert line.startswith('vehicle.yaml:5: sensors.beams.directions.1: not usable: value "frnt", expected ')

    def test_unknown_preset(self, write: Write) -> None:
        assert refusal(None, "fligt") == ['no preset is called "fligt"; known: flight, swift, table_i, table_ii']
        (line,) = refusal(write("control:\npreset: [x]\n"))
        assert line == 'vehicle.yaml:2: preset: no preset is called ["x"]; known: flight, swift, table_i, table_ii'

    def test_everything_at_once_in_the_order_of_the_lines(self, write: Write) -> None:
        lines = refusal(
            write("fleet:\n  largest_group: 0\ncontrol:\n  law: x\n  law: y\n  pause: 1\nsim: !a {}\npreset: none\n")
        )
        assert [line.split(": ")[:2] for line in lines] == [
            ["vehicle.yaml:2", "fleet.largest_group"],
            ["vehicle.yaml:4", "control.law"],
            ["vehicle.yaml:6", "control.pause"],
            ["vehicle.yaml:7", "sim"],
            ["vehicle.yaml:8", "preset"],
        ]

    def test_no_more_than_a_screen(self, write: Write) -> None:
        lines = refusal(write("".join(f"key{n}: 1\n" for n in range(100))))
        assert len(lines) == 21
        assert lines[-1] == "vehicle.yaml: and 80 more"


class TestRules:
    """Rules that tie several settings together name the line of the one that the file sets."""

    def test_critical_margin_not_below_margin(self, write: Write) -> None:
        (line,) = refusal(write("control:\n  pause_s: 1\n  critical_margin_m: 1.0\n"))
        assert line.startswith("vehicle.yaml:3: control.critical_margin_m = 1 m (d_c) must be smaller than ")
        assert line.endswith("[control.critical_margin_m: vehicle.yaml:3, control.margin_m: preset flight]")

    def test_assumption_2_2(self, write: Write) -> None:
        text = "preset: table_i\ncontrol:\n  allow_turning_radius_above_margin: false\n"
        (line,) = refusal(write(text))
        assert line.startswith("preset table_i: control.margin_m = 1 m (d_s) must be greater than ")
        assert "Assumption 2.2" in line
        assert load_settings(write(text.replace("false", "true"))).control.turning_radius_m > 1.0
        # What is governed turns in the room that there is.
        assert load_settings(write(text + "  speed_law: governor\n")).control.turning_radius_m > 1.0

    def test_rule_between_sections(self, write: Write) -> None:
        (line,) = refusal(write("vehicle:\n  body_radius_m: 0.8\n"))
        assert line.startswith("vehicle.yaml:2: vehicle.body_radius_m = 0.8 m must be smaller than ")

    def test_rule_broken_by_the_default(self, write: Write) -> None:
        (line,) = refusal(write("fleet: {largest_group: 6}\n"))
        assert line.endswith(
            "[fleet.tunnel_height_m: default, fleet.largest_group: vehicle.yaml:1, control.vertical_margin_m: default]"
        )

    def test_no_rule_is_judged_over_a_preset_that_was_not_meant(self, write: Write) -> None:
        (line,) = refusal(write("preset: tabel_i\ncontrol:\n  max_yaw_rate_radps: 0.3\n"))
        assert line.startswith("vehicle.yaml:1: preset: ")
