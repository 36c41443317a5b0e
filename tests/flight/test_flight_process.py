"""The application as the gate starts it: its exit codes, its last word, and that there is no way around the gate."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest

from companion.config.autopilot import AutopilotSettings
from companion.config.load import load_settings
from companion.errors import EXIT_INTERRUPTED, InputError
from companion.flight import __main__ as application
from companion.flight import mission
from companion.flight.gate_socket import GateSocket
from companion.flight.operator_commands import InterruptedFlightError
from companion.flight.preflight import CheckResult
from companion.flight.request import FlightRequest, sealed
from companion.gate.protocol import GATE_FD, Goodbye
from companion.interruption import ENDS
from tests.flight.fake_gate import FakeGate
from tests.shared.compiled_work import COMPILED_WORK

SETTINGS = load_settings()
FLIGHT = FlightRequest("run", SETTINGS, "flight")


@contextmanager
def handed(request: FlightRequest) -> Iterator[str]:
    """A request in sealed memory, as a file descriptor's number."""
    number = request.sealed()
    try:
        yield str(number)
    finally:
        os.close(number)


@pytest.fixture(autouse=True)
def signals() -> Iterator[None]:
    """The process under test sets handlers, which are this one's too."""
    before = {number: signal.getsignal(number) for number in ENDS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeGate]:
    with FakeGate() as fake:
        monkeypatch.setattr(GateSocket, "from_environment", lambda: fake.link)
        yield fake


def test_without_a_gate_nothing_runs(capfd: pytest.CaptureFixture[str]) -> None:
    """Protects the one promise of the gate: that nothing reaches the vehicle which it has not checked."""
    environment = {key: value for key, value in os.environ.items() if key != GATE_FD}
    command = [sys.executable, "-m", "companion.flight", "--request-fd", "0"]
    ended = subprocess.run(command, env=environment, check=False, timeout=60.0)
    assert ended.returncode == 2
    assert "companion run" in capfd.readouterr().err


def test_without_an_autopilot_it_says_where_the_gate_looked_and_goodbye() -> None:
    """The address behind the gate means nothing to a person: the one in the settings does."""
    url = "udpin://127.0.0.1:14599"
    quick = SETTINGS.model_copy(update={"autopilot": AutopilotSettings(url=url, connect_timeout_s=0.5)})
    with FakeGate() as fake, handed(FlightRequest("check", quick, "flight")) as number:
        ended = fake.run("--request-fd", number, inherit=(int(number),))
        assert ended.returncode == 1, ended.stderr
        assert f"on {url} within 0.5 s" in ended.stderr
        assert "Traceback" not in ended.stderr
        assert fake.heard() == [Goodbye(1)]


def test_a_gate_that_dies_before_the_flight_ends_the_application() -> None:
    patient = SETTINGS.model_copy(
        update={"autopilot": AutopilotSettings(url="udpin://127.0.0.1:14599", connect_timeout_s=60.0)}
    )
    with FakeGate() as fake, handed(FlightRequest("check", patient, "flight")) as number:
        fake.die()
        ended = fake.run("--request-fd", number, inherit=(int(number),), timeout_s=45.0)
    assert ended.returncode == 1
    assert "the safety gate is gone" in ended.stderr


def summary(**changes: Any) -> dict[str, Any]:
    return {"interrupted": False, "as_it_should": True, "ended_because": "complete", "end": None} | changes


NOT_HOME = {"ended_because": "inputs lost"}


@pytest.mark.parametrize(
    ("end", "code", "said"),
    [
        (summary(), 0, ""),
        (summary(as_it_should=False, ended_because="gate lost"), 1, "the flight ended because: gate lost"),
        (
            summary(as_it_should=False, end=NOT_HOME),
            1,
            "the flight ended because: complete; the way home: inputs lost",
        ),
        (summary(interrupted=True), 130, ""),
        (InterruptedFlightError("stopped before the take-off"), 130, "stopped before the take-off"),
        (InputError("no such thing"), 2, "no such thing"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_every_end_in_words_has_its_exit_code_and_a_goodbye(
    end: dict[str, Any] | BaseException,
    code: int,
    said: str,
    gate: FakeGate,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    async def fly(*_: object) -> dict[str, Any]:
        if isinstance(end, BaseException):
            raise end
        return end

    monkeypatch.setattr(mission, "fly", fly)
    with handed(FLIGHT) as number:
        assert application.main(["--request-fd", number]) == code
    assert gate.heard() == [Goodbye(code)]
    assert said in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN, "a late signal makes no death of a good end"


TALKS = """
import sys
from companion.flight import __main__ as application, mission
async def fly(request, gate, show):
    for line in range(100):
        show("exploring")
    return {"interrupted": False, "as_it_should": True}
mission.fly = fly
sys.exit(application.main())
"""


def test_a_log_on_a_full_disk_does_not_end_a_flight() -> None:
    """Every line that is shown is shown from within the flight: before, the first one that was refused broke it off."""
    with FakeGate() as fake, handed(FLIGHT) as number, open("/dev/full", "wb") as full:  # noqa: PTH123 - as a shell does
        ended = fake.run("--request-fd", number, inherit=(int(number),), program=("-c", TALKS), stdout=full)
        assert ended.returncode == 0, ended.stderr
        assert ended.stderr.count("No space left on device") == 1
        assert fake.heard() == [Goodbye(0)]


COMPILED = f"""
{COMPILED_WORK}
from companion.flight import __main__ as application, mission

async def fly(request, gate, show):
    ended = interrupted((signal.SIGINT, signal.SIGTERM) * 6)
    # A terminal that is closed is no death in the air: the gate asks for the end of the flight in its place.
    os.kill(os.getpid(), signal.SIGHUP)
    return {{"interrupted": ended == 12, "as_it_should": False}}

mission.fly = fly
sys.exit(application.main())
"""


@pytest.mark.timeout(120)
def test_what_ends_it_while_it_compiles_or_computes_is_no_crash() -> None:
    """The gate would take a crash for a death, and start the application again that somebody wanted to end."""
    with FakeGate() as fake, handed(FLIGHT) as number:
        ended = fake.run("--request-fd", number, inherit=(int(number),), program=("-c", COMPILED), timeout_s=110.0)
        assert ended.returncode == EXIT_INTERRUPTED, ended.stderr
        assert fake.heard() == [Goodbye(EXIT_INTERRUPTED)]


def test_an_error_that_nobody_expected_says_no_goodbye(gate: FakeGate, monkeypatch: pytest.MonkeyPatch) -> None:
    """The gate has to take it for what it is: a death of the application, after which the vehicle is stopped."""

    async def fly(*_: object) -> dict[str, Any]:
        raise ZeroDivisionError

    monkeypatch.setattr(mission, "fly", fly)
    with handed(FLIGHT) as number, pytest.raises(ZeroDivisionError):
        application.main(["--request-fd", number])
    assert gate.heard() == []


@pytest.mark.parametrize(("ok", "code"), [(True, 0), (False, 1)])
def test_checks_decide_the_exit_code(
    ok: bool, code: int, gate: FakeGate, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def check(*_: object) -> list[CheckResult]:
        return [CheckResult("link", ok, "0.1 s", "below 3 s", "why")]

    monkeypatch.setattr(mission, "check", check)
    with handed(replace(FLIGHT, what="check")) as number:
        assert application.main(["--request-fd", number]) == code
    assert gate.heard() == [Goodbye(code)]
    output = capsys.readouterr()
    assert "link" in output.out
    assert ("link" in output.err) is not ok


def test_what_was_asked_reaches_the_flight(gate: FakeGate, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[tuple[FlightRequest, GateSocket]] = []

    async def fly(request: FlightRequest, link: GateSocket, *_: object) -> dict[str, Any]:
        found.append((request, link))
        return summary()

    monkeypatch.setattr(mission, "fly", fly)
    asked = FlightRequest("run", SETTINGS, "table_i", 7, fix=True, skip=("depth", "-odd"))
    with handed(asked) as number:
        application.main(["--request-fd", number])
    assert found == [(asked, gate.link)]


def test_a_request_that_was_not_handed_over_is_refused(gate: FakeGate, capsys: pytest.CaptureFixture[str]) -> None:
    assert application.main(["--request-fd", "99999"]) == 2
    assert "handed over" in capsys.readouterr().err
    other = sealed("test", "{}")
    assert application.main(["--request-fd", str(other)]) == 2
    assert "is no request" in capsys.readouterr().err
    os.close(other)
    assert gate.heard() == [Goodbye(2), Goodbye(2)]


def test_the_end_of_the_service_before_a_flight_is_an_interrupt(
    gate: FakeGate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Loading takes up to a minute; systemd must not see a failure, nor the gate a death."""

    async def fly(*_: object) -> dict[str, Any]:
        os.kill(os.getpid(), signal.SIGTERM)
        return summary()

    monkeypatch.setattr(mission, "fly", fly)
    with handed(FLIGHT) as number:
        assert application.main(["--request-fd", number]) == 130
    assert gate.heard() == [Goodbye(130)]
