"""How a real autopilot is found and what it is started with: everything but the program itself."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest

from companion.config.settings import Settings
from companion.errors import InputError
from companion.mavlink.firmware import AutopilotKind
from sitl.launch.program import CrewError, Ports, Program, Running
from sitl.launch.real import ARDUPILOT_DEFAULTS, find, of_boot

WITHOUT_GPS = Settings.model_validate({"autopilot": {"gps": False}})


@pytest.fixture
def built(tmp_path: Path) -> Path:
    """As `make px4_sitl` leaves it."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "etc" / "init.d-posix").mkdir(parents=True)
    (tmp_path / "etc" / "init.d-posix" / "rcS").touch()
    program = tmp_path / "bin" / "px4"
    program.touch()
    program.chmod(0o755)
    return program


def test_what_is_not_there_is_refused_with_what_to_set(built: Path, tmp_path: Path) -> None:
    """Protects the user's first minute: the variable, its value, and what is missing."""
    with pytest.raises(InputError, match="PX4_BINARY is not set"):
        find("px4", {})
    with pytest.raises(InputError, match=r"ARDUCOPTER_BINARY=/nowhere: there is no such program"):
        find("ardupilot", {"ARDUCOPTER_BINARY": "/nowhere"})
    with pytest.raises(InputError, match="no such program"):
        find("ardupilot", {"ARDUCOPTER_BINARY": str(tmp_path)})
    with pytest.raises(InputError, match="name their folder etc with PX4_ETC"):
        find("px4", {"PX4_BINARY": str(built), "PX4_ETC": str(tmp_path)})


def test_the_parameters_of_the_boot_are_there_before_it(built: Path, tmp_path: Path) -> None:
    """Protects flights without GPS: what is set after the boot only leaves an estimator that waits for satellites."""
    program = find("px4", {"PX4_BINARY": str(built)}).program(tmp_path, WITHOUT_GPS, {"MIS_TAKEOFF_ALT": 1.5})
    assert program.environment["PX4_PARAM_EKF2_GPS_CTRL"] == "0"
    assert program.environment["PX4_PARAM_MIS_TAKEOFF_ALT"] == "1.5"
    assert "PX4_PARAM_COM_OF_LOSS_T" not in program.environment, "that is what --fix is for"
    assert program.arguments[-1] == str(tmp_path / "etc")

    copter = find("ardupilot", {"ARDUCOPTER_BINARY": str(built)})
    program = copter.program(tmp_path, WITHOUT_GPS, {}, Ports(1, 2, 3))
    assert program.folder is not None
    chosen = (program.folder / program.arguments[program.arguments.index("--defaults") + 1]).read_text(encoding="ascii")
    assert chosen.startswith(ARDUPILOT_DEFAULTS.read_text(encoding="ascii"))
    assert "EK3_SRC1_POSXY 6\n" in chosen
    assert "udpclient:127.0.0.1:2" in program.arguments

    assert of_boot(AutopilotKind.PX4, Settings()) == {}


def test_a_program_that_dies_says_why_and_one_that_stops_is_ended(tmp_path: Path) -> None:
    """Protects an unattended campaign: it neither waits for the dead, nor leaves anybody behind."""
    dies = Running(Program("dies", (sys.executable, "-c", "print('no port')"), "ready"), tmp_path)
    with pytest.raises(CrewError, match=r"dies did not start; its words: no port"):
        dies.wait(20.0)
    sleeps = Running(
        Program("sleeps", (sys.executable, "-c", "import time; print('ready'); time.sleep(60)"), "ready"), tmp_path
    )
    sleeps.wait(20.0)
    sleeps.process.send_signal(signal.SIGSTOP)
    first = sleeps.process.pid
    sleeps.restart()
    assert sleeps.process.pid != first
    sleeps.check()
    sleeps.process.send_signal(signal.SIGSTOP)
    sleeps.end()
    with pytest.raises(CrewError, match="sleeps ended too soon"):
        sleeps.check()
