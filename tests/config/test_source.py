"""One YAML text: files that cannot be read, what YAML allows and a settings file does not, and what scalars are."""

from __future__ import annotations

import math
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.config.load import load_settings
from companion.config.source import MAX_FILE_BYTES, Source
from companion.errors import InputError
from tests.config.conftest import Write, refusal

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
