"""The command that starts the autopilot."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from companion.errors import InputError
from sitl.autopilot.origin import to_global, to_world
from sitl.cli.autopilot import DEFAULT_TO, autopilot, host_to_listen_on

START = "import typer; from sitl.cli.autopilot import autopilot; typer.run(autopilot)"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--personality", "betaflight"], "betaflight"),
        (["--to", "nowhere"], "nowhere"),
        (["--to", "127.0.0.1:0"], "127.0.0.1:0"),
        (["--param", "COM_OF_LOSS_T"], "COM_OF_LOSS_T"),
        (["--param", "NO_SUCH=1"], "NO_SUCH"),
        (["--param", "COM_OF_LOSS_T=nan"], "COM_OF_LOSS_T"),
        (["--start", "0", "0", "nan", "0"], "--start"),
    ],
)
def test_wrong_input_is_named(arguments: list[str], named: str) -> None:
    """What cannot be used is refused before anything listens."""
    app = typer.Typer()
    app.command()(autopilot)
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, InputError)
    assert named in str(result.exception)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_it_says_what_it_serves_and_ends_when_told(number: signal.Signals, code: int) -> None:
    """One line, then quiet; no traceback at the end."""
    process = subprocess.Popen(
        [sys.executable, "-c", START, "--to", "127.0.0.1:9", "--start", "1", "2", "3", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout is not None
        assert process.stderr is not None
        line = process.stdout.readline()
        assert line.startswith("px4, system 1, standing at 1.00 2.00 3.00: UDP from port ")
        process.send_signal(number)
        process.wait(20.0)
        if number is signal.SIGTERM:
            assert process.returncode == code
            assert process.stderr.read() == ""
        else:
            # `companion` turns the interrupt into 130; here it is typer that does.
            assert process.returncode in (code, 1)


def test_the_globe_and_back_is_within_half_a_unit() -> None:
    """1e-7 degrees are 11 mm."""
    for x_m, y_m, z_m in [(0.0, 0.0, 0.0), (120.0, -75.5, 3.25), (-1000.0, 2000.0, -40.0)]:
        assert to_world(*to_global(x_m, y_m, z_m)) == pytest.approx((x_m, y_m, z_m), abs=0.006)


def test_it_listens_on_loopback_unless_somebody_elsewhere_is_named() -> None:
    """Protects a developer's computer: a stub that anybody in the network may command is no harmless program."""
    default = [(text.rpartition(":")[0], 14540) for text in DEFAULT_TO]
    assert host_to_listen_on(default) == "127.0.0.1"
    assert host_to_listen_on([("localhost", 1), ("127.0.1.1", 2)]) == "127.0.0.1"
    assert host_to_listen_on([*default, ("192.168.1.2", 14550)]) == "0.0.0.0"  # noqa: S104 - as was asked
