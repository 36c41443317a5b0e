"""Loading settings: what is put over what, and what is said about a file that cannot be used."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.config.load import load, load_settings, preset_names
from companion.config.settings import Settings
from companion.config.source import MAX_FILE_BYTES, Source
from companion.errors import InputError
from companion.model import Beam

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a settings file and gives its path."""

    def write_file(text: str) -> Path:
        file = tmp_path / "vehicle.yaml"
        file.write_text(text, encoding="utf-8")
        return file

    return write_file


def refusal(file: Path | None, preset: str | None = None) -> list[str]:
    """The lines of the refusal, with the folder of the file cut off."""
    with pytest.raises(InputError) as caught:
        load_settings(file, preset)
    folder = "" if file is None else f"{file.parent}/"
    return str(caught.value).replace(folder, "").splitlines()


class TestLayers:
    """Defaults < preset < file."""

    def test_presets_that_ship(self) -> None:
        assert preset_names() == ("flight", "table_i", "table_ii")

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


TOO_DEEP = "nested too deeply, more than 20 levels; remove the inner ones"


class TestFilesThatCannotBeRead:
    """One message that names the file and what to do."""

    def test_missing(self, tmp_path: Path) -> None:
        assert refusal(tmp_path / "no.yaml") == ["no.yaml: no such file; check the path"]

    def test_folder(self, tmp_path: Path) -> None:
        assert refusal(tmp_path) == [f"{tmp_path.name}: is a folder; give the YAML file in it"]

    def test_path_through_a_file(self, write: Write) -> None:
        (line,) = refusal(write("") / "below")
        assert "cannot be read: Not a directory" in line

    def test_path_that_no_system_accepts(self) -> None:
        (line,) = refusal(Path("a\0b.yaml"))
        assert line == r"'a\x00b.yaml': cannot be read: embedded null byte"

    def test_unreadable(self, write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
        file = write("")

        def refuse(*_: object) -> None:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(Path, "open", refuse)  # root reads everything, whatever the file's mode
        assert refusal(file) == ["vehicle.yaml: cannot be read: Permission denied"]

    def test_not_utf8(self, tmp_path: Path) -> None:
        file = tmp_path / "vehicle.yaml"
        file.write_bytes(b"control:\n  law: \xff\n")
        assert refusal(file) == ["vehicle.yaml:2: not UTF-8 text: byte 16; save the file as UTF-8"]

    def test_too_large(self, write: Write) -> None:
        (line,) = refusal(write("#" * (MAX_FILE_BYTES + 1)))
        assert "larger than" in line

    def test_endless_device(self) -> None:
        (line,) = refusal(Path("/dev/zero"))
        assert "larger than" in line

    @pytest.mark.parametrize(
        ("text", "line"),
        [
            ("control: [\n1,\n", "vehicle.yaml:3: not valid YAML: expected the node content, but found '<stream end>'"),
            ("a: b: c", "vehicle.yaml:1: not valid YAML: mapping values are not allowed here"),
            ("a: 1\n---\nb: 1\n", "vehicle.yaml:2: a second document begins here; a settings file holds one"),
            (
                "a: \x07",
                "vehicle.yaml:1: not valid YAML: unacceptable character #x0007: special characters are not allowed",
            ),
            ('a: "\\U00110000"', "vehicle.yaml: not valid YAML: chr() arg not in range(0x110000)"),
            (
                "%YAML 1.1\n---\na: no",
                "vehicle.yaml:1: another version of YAML than 1.2; remove the line that begins with %YAML",
            ),
            (
                "# a\u2028b: 1",
                r"vehicle.yaml:1: not usable: a line separator; remove it or write \u2028",
            ),
            ("\n" + "[" * 500, f"vehicle.yaml:2: {TOO_DEEP}"),
        ],
    )
    def test_not_yaml(self, write: Write, text: str, line: str) -> None:
        assert refusal(write(text)) == [line]

    @pytest.mark.parametrize("text", ["- a\n", "flight\n", "1\n", "false\n"])
    def test_not_a_mapping(self, write: Write, text: str) -> None:
        (line,) = refusal(write(text))
        assert line.startswith("vehicle.yaml:1: the file must hold sections such as 'control:'")


class TestForm:
    """What YAML allows and a settings file does not."""

    def test_duplicate_key(self, write: Write) -> None:
        lines = refusal(write("control:\n  margin_m: 1\n  pause_s: 1\n  margin_m: 2\n"))
        assert lines == ["vehicle.yaml:2: control.margin_m: given twice, again in line 4; remove one of the two"]

    def test_duplicate_section(self, write: Write) -> None:
        (line,) = refusal(write("control:\n  margin_m: 1\ncontrol:\n  pause_s: 1\n"))
        assert "given twice, again in line 3" in line

    @pytest.mark.parametrize(
        ("text", "tag"),
        [
            ("control: !!python/object/apply:os.system [x]\n", "python/object/apply:os.system"),
            ("control: !mine {}\n", "!mine"),
            ("control: !!set {a}\n", "set"),
        ],
    )
    def test_tags_construct_nothing(self, write: Write, text: str, tag: str) -> None:
        assert refusal(write(text)) == [f"vehicle.yaml:1: control: tags such as {tag} are not used here; remove it"]

    def test_aliases_do_not_multiply(self, write: Write) -> None:
        bomb = "a: &a [x]\n" + "".join(
            f"{b}: &{b} [{', '.join(['*' + a] * 9)}]\n" for a, b in zip("ab", "bc", strict=True)
        )
        assert any("aliases (*name) are not used here" in line for line in refusal(write(bomb)))

    def test_an_alias_of_nothing(self, write: Write) -> None:
        (line, *_) = refusal(write("control: *a\n"))
        assert line == "vehicle.yaml:1: control: aliases (*name) are not used here; write the value out"

    def test_alias_of_itself(self, write: Write) -> None:
        (line, *_) = refusal(write("control: &a {margin_m: *a}\n"))
        assert line.startswith("vehicle.yaml:1: control.margin_m: aliases")

    @pytest.mark.parametrize("text", ["control: {[1]: 2}", "control: {? {a: 1} : 2}", 'control: {"\\ud800": 2}'])
    def test_keys_that_are_no_text(self, write: Write, text: str) -> None:
        assert refusal(write(text)) == ["vehicle.yaml:1: control.?: a key must be plain text"]

    @pytest.mark.parametrize(
        "inner",
        [
            "[" * 150 + "]" * 150,
            "{" * 50_000,
            "!a " + "[" * 50_000,
            "{? " + "[" * 50_000,
            "[&a " * 20_000,
        ],
        ids=["closed", "braces", "tagged", "key", "anchors"],
    )
    def test_nested_deeply(self, write: Write, inner: str) -> None:
        """Protects the stack, and whoever waits: it ends with the first level that is too deep."""
        began = time.process_time()
        assert refusal(write(f"control: {{law: {inner}")) == [f"vehicle.yaml:1: {TOO_DEEP}"]
        assert time.process_time() - began < 2.0

    @pytest.mark.parametrize("text", ["!!int many", "!!float many", "!!bool many", "1" * 5000, "0x" + "f" * 5000])
    def test_scalars_that_are_not_what_they_say(self, write: Write, text: str) -> None:
        (line, *_) = refusal(write(f"fleet:\n  largest_group: {text}\n"))
        assert line.startswith("vehicle.yaml:2: fleet.largest_group: value ")
        assert line.endswith("is not a number, true or false; correct it")

    def test_text_that_cannot_be_stored(self, write: Write) -> None:
        (line, *_) = refusal(write('control:\n  law: "\\ud800"\n'))
        assert line == r"vehicle.yaml:2: control.law: text that cannot be stored: '\ud800'; use plain characters"


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

    def test_element_of_a_list(self, write: Write) -> None:
        (line,) = refusal(write("sensors:\n  beams:\n    directions:\n      - down\n      - frnt\n"))
        assert line.startswith('vehicle.yaml:5: sensors.beams.directions.1: not usable: value "frnt", expected ')

    def test_unknown_preset(self, write: Write) -> None:
        assert refusal(None, "fligt") == ['no preset is called "fligt"; known: flight, table_i, table_ii']
        (line,) = refusal(write("control:\npreset: [x]\n"))
        assert line == 'vehicle.yaml:2: preset: no preset is called ["x"]; known: flight, table_i, table_ii'

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


SCALARS = {
    "text": "no off yes on y n No OFF 1_000 0x_1 0b11 0o8 0O17 0X1f -0x1 1:30 190:20:30 2001-12-14 = << . -. "
    "e3 1e 1.5.2 inf nan -.nan +. tRUE nULL ~~ 1e3_0 '1' \"true\" '' !!str\u00a01",
    "int": "0 -0 +1 017 08 0o17 0x1F 99999999999999999999 !!int\u00a012",
    "float": "1e3 1E+3 1.e3 .5 -.5e-1 5. 0.0 1e400 .inf -.INF +.Inf .nan !!float\u00a01",
    "bool": "true True TRUE false False FALSE !!bool\u00a0true",
    "null": "~ null Null NULL",
}
"""What the core schema of YAML 1.2 makes of plain text; a no-break space stands for a space."""


@pytest.mark.parametrize(("kind", "texts"), SCALARS.items())
def test_scalars_are_those_of_yaml_1_2(kind: str, texts: str) -> None:
    kinds: dict[type, str] = {str: "text", int: "int", float: "float", bool: "bool", type(None): "null"}
    for text in texts.split(" "):
        value = Source("", f"a: {text}\n".replace("\u00a0", " ")).data["a"]
        assert kinds[type(value)] == kind, text


def test_numbers_are_read_as_yaml_1_2_counts_them() -> None:
    text = "[017, 0o17, 0x1F, +1, -0, 1e3, -.5e-1, 5., -.inf, 0.1]"
    assert Source("", f"a: {text}").data["a"] == [17, 15, 31, 1, 0, 1000.0, -0.05, 5.0, -math.inf, 0.1]


YAML_CHARACTERS = " \n\t:-?[]{},&*!|>#%'\"\\.0x1e_~\x85\u2028\ufeff"
YAML_WORDS = ["control", "margin_m", "preset", ": ", ":\n  ", "&a ", "*a", "<<", "!!int ", "%YAML 1.", "---\n", ".inf"]
YAML_LIKE = st.lists(st.sampled_from([*YAML_CHARACTERS, *YAML_WORDS]), max_size=30).map("".join)


@given(st.one_of(st.binary(max_size=200), st.text(max_size=100).map(str.encode), YAML_LIKE.map(str.encode)))
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_file_is_loaded_or_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_bytes(content)
    try:
        load_settings(file)
    except InputError as error:
        message = str(error)
        message.encode()  # can be printed
        assert all(line.startswith((f"{file}:", "preset ", "default: ")) for line in message.splitlines())
