"""What the safety gate costs: delay, processor and memory, with an autopilot that sends 1,000 messages a second.

python -m bench.gate
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil

from bench.common import Row, Usage, parser, quantiles, show
from bench.gate.autopilot import FakeAutopilot
from bench.gate.child import WARM_UP_S, timed, timed_socket
from companion.config.settings import Settings
from companion.gate.plan import Plan
from companion.gate.protocol import GATE_FD
from companion.safety_case.gate_plan import to_plan
from sitl.launch.processes import free_udp_ports
from sitl.launch.program import tied

RATES_HZ = (20.0, 200.0)
"""Of setpoints: as they are flown, and ten times as many for the sake of numbers."""
KILLS, SHORT_S = 5, 3.0
START_S, STOP_S = 15.0, 5.0
COLUMNS = (
    *("path", "setpoints/s", "messages/s", "up p50, ms", "up p99, ms", "down p50, ms", "down p99, ms"),
    *("added p50, ms", "added p99, ms", "CPU, %", "RSS, MB", "first stop, ms"),
)


def through_gate(hz: float, seconds: float, realtime: bool, profile: Path | None = None) -> Row:
    """One flight through a gate, which ends with the death of the application."""
    with tempfile.TemporaryDirectory(prefix="bench-gate-") as name, timed_socket() as wire:
        folder = Path(name)
        child, file = _application(hz, seconds, folder)
        (port,) = free_udp_ports(1)
        plan = _plan(port, child, realtime)
        autopilot = FakeAutopilot(wire, ("127.0.0.1", port))
        with _gate(plan, folder, profile) as gate:
            _warm_up(autopilot)
            before, sent_before = Usage.of(gate.pid), autopilot.sent
            _until(autopilot, file.exists, seconds + START_S)
            after = Usage.of(gate.pid)
            (application,) = psutil.Process(gate.pid).children()
            stopped_s = _kill_and_wait(autopilot, application.pid)
            gate.send_signal(signal.SIGTERM)
            autopilot.land()
            if profile is not None:
                # It writes its profile when it has ended by itself, some seconds after the landing.
                _until(autopilot, lambda: gate.poll() is not None, START_S)
            down_us = json.loads(file.read_text(encoding="ascii"))
            row = _row("gate" if realtime else "gate, not real time", hz, autopilot.setpoint_delays_us, down_us)
            past_s = after.t_s - before.t_s
            return row | {
                "messages/s": (autopilot.sent - sent_before) / past_s,
                "CPU, %": 100.0 * (after.cpu_s - before.cpu_s) / past_s,
                "RSS, MB": after.rss_mb,
                "first stop, ms": 1e3 * stopped_s,
            }


def straight(hz: float, seconds: float) -> Row:
    """The same flight without a gate: the autopilot has the other end of the application's socket."""
    with tempfile.TemporaryDirectory(prefix="bench-gate-") as name, contextlib.ExitStack() as stack:
        command, file = _application(hz, seconds, Path(name))
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        stack.enter_context(ours)
        stack.enter_context(theirs)
        autopilot = FakeAutopilot(timed(ours), None)
        environment = {**os.environ, GATE_FD: str(theirs.fileno())}
        child = subprocess.Popen(command, env=environment, pass_fds=(theirs.fileno(),), preexec_fn=tied())  # noqa: S603 - our own
        stack.callback(_end, child)
        _warm_up(autopilot)
        begun_s, sent_before = time.monotonic(), autopilot.sent
        _until(autopilot, file.exists, seconds + START_S)
        sent_hz = (autopilot.sent - sent_before) / (time.monotonic() - begun_s)
        down_us = json.loads(file.read_text(encoding="ascii"))
        return _row("straight", hz, autopilot.setpoint_delays_us, down_us) | {"messages/s": sent_hz}


def _application(hz: float, seconds: float, folder: Path) -> tuple[tuple[str, ...], Path]:
    """The command of the application, and the file in which it leaves how late the autopilot's messages came."""
    file = folder / "delays.json"
    return (sys.executable, "-m", "bench.gate.child", str(hz), str(seconds), str(file)), file


def _warm_up(autopilot: FakeAutopilot) -> None:
    """Be the autopilot until the application flies at its full speed; what was measured before does not count."""
    _until(autopilot, lambda: autopilot.flies, START_S)
    end_s = time.monotonic() + WARM_UP_S
    _until(autopilot, lambda: time.monotonic() >= end_s, math.inf)
    autopilot.setpoint_delays_us.clear()


def _row(path: str, hz: float, up_us: list[float], down_us: list[float]) -> Row:
    up, down = np.array(up_us) / 1e3, np.array(down_us) / 1e3
    return {
        "path": path,
        "setpoints/s": hz,
        "setpoints": up.size,
        **quantiles("up", up),
        "up worst, ms": float(up.max()),
        **quantiles("down", down),
        "down worst, ms": float(down.max()),
    }


def _plan(port: int, child: tuple[str, ...], realtime: bool) -> Plan:
    settings = Settings()
    autopilot = settings.autopilot.model_copy(update={"url": f"udpin://127.0.0.1:{port}"})
    plan = to_plan(settings.model_copy(update={"autopilot": autopilot}), command=child, restart_command=child)
    return replace(plan, realtime=realtime, restarts=0)


@contextlib.contextmanager
def _gate(plan: Plan, folder: Path, profile: Path | None) -> Iterator[subprocess.Popen[bytes]]:
    number = os.memfd_create("plan")
    os.write(number, plan.dumps().encode())
    how = [] if profile is None else ["-m", "cProfile", "-o", str(profile)]
    command = [sys.executable, *how, "-m", "companion.gate", "--plan-fd", str(number)]
    with (folder / "gate.log").open("wb") as log:
        gate = subprocess.Popen(command, pass_fds=(number,), stderr=log, preexec_fn=tied())  # noqa: S603 - our own
    os.close(number)
    try:
        yield gate
    except TimeoutError as error:
        raise TimeoutError((folder / "gate.log").read_text(encoding="utf-8", errors="replace")[-2000:]) from error
    finally:
        _end(gate)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _kill_and_wait(autopilot: FakeAutopilot, pid: int) -> float:
    """Seconds from the death of the application to the first stop of the gate."""
    autopilot.stopped_ns = 0
    begun_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGKILL)
    _until(autopilot, lambda: autopilot.stopped_ns > 0, STOP_S)
    return (autopilot.stopped_ns - begun_ns) / 1e9


def _until(autopilot: FakeAutopilot, ready: Callable[[], bool], timeout_s: float) -> None:
    """Be the autopilot until something has come about."""
    give_up_s = time.monotonic() + timeout_s
    while not ready():
        if time.monotonic() > give_up_s:
            raise TimeoutError
        select.select([autopilot.wire], [], [], autopilot.wait_s())
        autopilot.turn()


def _number(value: object) -> float:
    assert isinstance(value, float)
    return value


def main() -> None:
    """Print the table."""
    options = parser(__doc__)
    options.add_argument("--seconds", type=float, default=20.0, metavar="N", help="of each flight")
    options.add_argument("--profile", type=Path, metavar="FILE", help="one flight of a gate under cProfile instead")
    arguments = options.parse_args()
    if arguments.profile is not None:
        through_gate(20.0, arguments.seconds, realtime=False, profile=arguments.profile)
        return
    rows = []
    for hz in RATES_HZ:
        base = straight(hz, arguments.seconds)
        rows.append(base)
        for realtime in (True, False):
            row = through_gate(hz, arguments.seconds, realtime)
            for share in ("p50", "p99"):
                key = f"up {share}, ms"
                row[f"added {share}, ms"] = _number(row[key]) - _number(base[key])
            rows.append(row)
    for realtime in (True, False):
        # How soon the gate's first stop is on the wire after the application was killed, again and again.
        stops_ms = [_number(through_gate(20.0, SHORT_S, realtime)["first stop, ms"]) for _ in range(KILLS)]
        path = "gate" if realtime else "gate, not real time"
        rows.append({"path": f"{path}, worst of {KILLS} deaths", "setpoints/s": 20.0, "first stop, ms": max(stops_ms)})
    show(rows, COLUMNS, arguments.json)


if __name__ == "__main__":
    main()
