"""The command `companion`: its messages, its exit codes, and what it does not import."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points, version
from pathlib import Path

import pytest

from companion.cli import main as cli
from companion.config.load import load_settings
from companion.config.show import dump_yaml
from companion.errors import CompanionError, InputError
from companion.interruption import ENDS
from companion.safety_case.passages import passages

COMPANION = [sys.executable, "-c", "from companion.cli.main import main; main()"]

Run = Callable[..., int]


@pytest.fixture
def run() -> Run:
    """Runs one command in this process and gives its exit code."""

    def run_command(*arguments: str) -> int:
        with pytest.raises(SystemExit) as ended:
            cli.main(arguments)
        return int(ended.value.code or 0)

    return run_command


@pytest.fixture
def offer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], None]:
    """Installs the source of a module, with a function `fly` in it, as the command `fly`."""

    def offer_command(source: str) -> None:
        (tmp_path / "other_package.py").write_text(source, encoding="utf-8")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "other_package", raising=False)
        command = EntryPoint(name="fly", value="other_package:fly", group=cli.COMMANDS_GROUP)
        monkeypatch.setattr(cli, "entry_points", lambda group: [command] if group == cli.COMMANDS_GROUP else [])

    return offer_command


class TestConfig:
    """`companion config`."""

    def test_show(self, run: Run, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
        assert run("config", "show", "--preset", "table_ii") == 0
        shown = capsys.readouterr().out
        assert dump_yaml(load_settings(preset="table_ii")) in shown
        file = tmp_path / "shown.yaml"
        file.write_text(shown, encoding="utf-8")
        assert run("config", "show", "--config", str(file)) == 0
        assert run("config", "check", str(file)) == 0
        said = capsys.readouterr().out
        assert "shown.yaml: OK (preset table_ii)\n" in said
        assert said.endswith(f"{passages(load_settings(preset='table_ii'))}\n")

    def test_check_refuses(self, run: Run, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
        file = tmp_path / "bad.yaml"
        file.write_text("control:\n  margin: 1\n  law: no\n", encoding="utf-8")
        assert run("config", "check", str(file)) == 2
        output = capsys.readouterr()
        assert output.out == ""
        assert [line.split(": ")[0] for line in output.err.splitlines()] == [f"{file}:2", f"{file}:3"]

    def test_check_knows_the_drivers(self, run: Run, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
        """Protects from a name that is found wrong only beside the vehicle."""
        file = tmp_path / "vehicle.yaml"
        for drivers, code in (("stream, mavlink", 0), ("realsense", 2), ("stream, stream", 2)):
            file.write_text(f"sensors:\n  drivers: [{drivers}]\n", encoding="utf-8")
            assert run("config", "check", str(file)) == code
        err = capsys.readouterr().err
        assert "there is no sensor driver 'realsense'. Known: mavlink, stream" in err
        assert "sensors.drivers names stream twice" in err

    def test_schema(self, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
        assert run("config", "schema") == 0
        assert "preset" in json.loads(capsys.readouterr().out)["properties"]

    def test_a_terminal_without_greek_letters(self) -> None:
        shown = subprocess.run(
            [*COMPANION, "config", "show"], env={"PYTHONIOENCODING": "ascii"}, capture_output=True, check=True
        )
        assert b"speed_mps: 0.5" in shown.stdout


class TestUsage:
    """What the application says of itself."""

    def test_version(self, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
        assert run("--version") == 0
        assert capsys.readouterr().out == f"{version('mine-companion')}\n"

    @pytest.mark.parametrize(
        "arguments", [[], ["config"], ["no-such"], ["config", "check"], ["config", "show", "--no"]]
    )
    def test_wrong_usage(self, run: Run, capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
        assert run(*arguments) == 2
        shown = "".join(capsys.readouterr())
        assert "Usage: companion" in shown
        assert "\x1b" not in shown

    def test_help_and_config_import_no_library_of_the_simulation(self) -> None:
        source = """
import sys
from companion.cli.main import main
for arguments in (["--help"], ["config", "show"]):
    try:
        main(arguments)
    except SystemExit as ended:
        assert not ended.code, ended.code
print(sorted({"numba", "open3d", "matplotlib", "sitl.cli.sim"} & set(sys.modules)), file=sys.stderr)
"""
        done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
        assert done.stderr == "[]\n"

    def test_output_that_nobody_reads_ends_quietly(self) -> None:
        with subprocess.Popen(
            [*COMPANION, "config", "show"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
        ) as process:
            assert process.stdout is not None
            process.stdout.close()
            assert process.stderr is not None
            assert process.stderr.read() == b""

    @pytest.mark.parametrize("number", ENDS)
    def test_a_signal_when_all_is_done_is_no_traceback(self, number: signal.Signals) -> None:
        """Protects from being told of a failure: Python takes a while to leave, and what was written is written."""
        source = f"""
import atexit, os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background is started with SIGINT ignored
from companion.cli.start import main
atexit.register(os.kill, os.getpid(), {int(number)})
sys.argv = ["companion", "--version"]
main()
"""
        done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=False)
        assert done.stdout.startswith(version("mine-companion"))
        assert (done.returncode, done.stderr) == (-number, "")

    @pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["config", "show"], ["safety", "budget"]])
    def test_a_full_disk_is_one_line_and_a_failure(self, arguments: list[str]) -> None:
        """Protects from a traceback, and from a file that is taken for whole."""
        with open("/dev/full", "wb") as full:  # noqa: PTH123 - as a shell redirects
            done = subprocess.run([*COMPANION, *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
        assert done.returncode == 1
        assert done.stderr == "standard output: No space left on device; what would be printed from here on is lost\n"


class TestCommandsFromElsewhere:
    """The entry-point group `companion.commands`."""

    def test_help_shows_it_without_importing_it(
        self, run: Run, offer: Callable[[str], None], capsys: pytest.CaptureFixture[str]
    ) -> None:
        offer('raise RuntimeError\ndef fly() -> None:\n    """Fly to\n    the moon.\n\n    Slowly.\n    """\n')
        assert run("--help") == 0
        shown = " ".join(capsys.readouterr().out.split())
        assert "fly Fly to the moon." in shown
        assert "Slowly" not in shown

    @pytest.mark.parametrize("source", ["import other\n", "x ="])
    def test_help_of_one_that_cannot_be_read(self, run: Run, offer: Callable[[str], None], source: str) -> None:
        offer(source)
        assert run("--help") == 0

    def test_it_runs_with_its_options(
        self, run: Run, offer: Callable[[str], None], capsys: pytest.CaptureFixture[str]
    ) -> None:
        offer("def fly(height_m: float = 1.0) -> None:\n    print(height_m * 2)\n")
        assert run("fly", "--height-m", "3") == 0
        assert capsys.readouterr().out == "6.0\n"

    @pytest.mark.parametrize(
        "source", ["import no_such_library\n", "def fly() -> None:\n    import no_such_library.part\n"]
    )
    def test_a_library_that_is_not_installed(
        self, run: Run, offer: Callable[[str], None], capsys: pytest.CaptureFixture[str], source: str
    ) -> None:
        offer(source)
        assert run("fly") == 1
        assert capsys.readouterr().err.startswith("companion fly: the module no_such_library")

    @pytest.mark.parametrize("name", ["sim", "sitl"])
    def test_the_extra_that_the_simulation_needs(self, name: str) -> None:
        (simulate,) = [command for command in entry_points(group=cli.COMMANDS_GROUP) if command.name == name]
        message = cli._missing(simulate, ModuleNotFoundError(name="open3d"))
        assert message.endswith("it needs pip install 'mine-companion[sim]'")

    @pytest.mark.parametrize("source", ["import companion.no_such\n", "import other_package.part\n"])
    def test_a_missing_module_of_ours_is_a_bug(self, offer: Callable[[str], None], source: str) -> None:
        offer(source)
        with pytest.raises(ModuleNotFoundError):
            cli.main(["fly"])


class TestFailures:
    """How a command ends that cannot go on."""

    @pytest.mark.parametrize(
        ("raised", "code", "said"),
        [
            ("companion.errors.InputError('a.yaml: wrong')", InputError.exit_code, "a.yaml: wrong\n"),
            ("companion.errors.CompanionError('[red]no\\nway')", CompanionError.exit_code, "[red]no\nway\n"),
            ("KeyboardInterrupt", 130, ""),
        ],
    )
    def test_one_plain_message(
        self,
        run: Run,
        offer: Callable[[str], None],
        capsys: pytest.CaptureFixture[str],
        raised: str,
        code: int,
        said: str,
    ) -> None:
        offer(f"import companion.errors\ndef fly() -> None:\n    raise {raised}\n")
        assert run("fly") == code
        assert capsys.readouterr().err == said

    def test_interrupted_while_it_is_imported(self, run: Run, offer: Callable[[str], None]) -> None:
        offer("raise KeyboardInterrupt\n")
        assert run("fly") == 130

    def test_a_bug_keeps_its_traceback(self, offer: Callable[[str], None]) -> None:
        offer("def fly() -> None:\n    raise ZeroDivisionError\n")
        with pytest.raises(ZeroDivisionError):
            cli.main(["fly"])
