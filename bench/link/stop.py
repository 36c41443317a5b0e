"""How soon a stop over the link brakes, and what the link costs the control: ``python -m bench.link.stop``.

The stub, the world, gate and application as processes, over MAVLink, in real time; the ground is this program. In each
flight with the link it presses STOP every few seconds while the vehicle moves, and CONTINUE after it. ``answered`` is
from the press to the acknowledgement, ``braking`` from the press to the first setpoint of those that lead to a stand,
as it leaves the gate, stamped by the kernel when it arrives at the autopilot's end. The gap between setpoints is that
of the application's; flights without the link are made in turn with those that have it.

The figures mean something only when the computer has nothing else to do.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import signal
import subprocess
import tempfile
import threading
import time
from argparse import Namespace
from pathlib import Path

import numpy as np

from bench.common import Row, Usage, parser, quantiles, say, show
from bench.gate.autopilot import Wire
from companion.errors import CompanionError
from companion.link.ground.station import LinkStation
from companion.link.ground.vehicle import LinkedVehicle
from companion.link.words import Answer, Command
from sitl.launch.processes import Crew, FlightPlan, environment, free_tcp_port, free_udp_ports
from sitl.launch.program import tied

START_S = 600.0
MOVES_MPS = 0.2
STANDS_FOR_S, FLIES_FOR_S = 2.0, 5.0
COLUMNS = (
    *("link", "flight", "stops", "answered p50, ms", "answered p99, ms", "braking p50, ms", "braking p99, ms"),
    *("setpoints", "gap p50, ms", "gap p99, ms", "gap worst, ms", "link, %", "link, MB"),
)


class Stops:
    """Presses STOP and CONTINUE, and notes when, and when the answer came."""

    def __init__(self, vehicle: LinkedVehicle, wire: Wire) -> None:
        self.pressed_ns: list[int] = []
        self.answered_ms: list[float] = []
        self._vehicle = vehicle
        self._wire = wire

    def press(self) -> None:
        """Stop, and go on."""
        began_ns = time.monotonic_ns()
        answer = self._asked(Command.STOP)
        if answer is not None and answer.accepted:
            self.answered_ms.append((time.monotonic_ns() - began_ns) / 1e6)
            self.pressed_ns.append(began_ns)
        time.sleep(STANDS_FOR_S)
        self._asked(Command.CONTINUE)

    def braking_ms(self) -> list[float]:
        """From each press to the first setpoint of those that lead to a stand, where it moved before."""
        at_ns = np.array([at for at, _ in self._wire.speeds])
        speeds = np.array([speed for _, speed in self._wire.speeds])
        found = []
        for pressed_ns in self.pressed_ns:
            first = int(np.searchsorted(at_ns, pressed_ns))
            stands = first + int(np.argmax(speeds[first:] < 0.01))
            if first == 0 or first >= len(speeds) or speeds[first - 1] < MOVES_MPS:
                continue
            begins = stands
            while begins > first and speeds[begins - 1] > speeds[begins]:
                begins -= 1
            # The last that is not slower than the one before it was made before the stop.
            begins += speeds[begins] >= speeds[begins - 1]
            found.append((at_ns[begins] - pressed_ns) / 1e6)
        return found

    def _asked(self, command: Command) -> Answer | None:
        answers: list[Answer | None] = []
        answered = threading.Event()

        def on_answer(answer: Answer | None) -> None:
            answers.append(answer)
            answered.set()

        self._vehicle.ask(command, on_answer)
        answered.wait()
        return answers[0]


def flight(is_linked: bool, number: int, arguments: Namespace, folder: Path) -> Row:
    """One flight: its row."""
    (gate_port,) = free_udp_ports(1)
    endpoint = f"tcp/127.0.0.1:{free_tcp_port()}"
    plan = FlightPlan(
        folder=folder,
        world=arguments.world,
        seed=arguments.seed,
        time_limit_s=arguments.seconds,
        settings={
            "autopilot": {"url": f"udpin://127.0.0.1:{gate_port}"},
            "mission": {"skip_checks": ["clock", "depth"]},
            "link": {"enabled": is_linked, "listen": [endpoint], "finish_s": 5.0},
        },
        autopilot=("--boot-s", "2"),
    )
    crew, row = Crew(plan), Row({"link": "on" if is_linked else "off", "flight": number})
    with contextlib.ExitStack() as stack:
        wire = stack.enter_context(Wire(gate_port))
        crew.ports = dataclasses.replace(crew.ports, application=wire.port)
        stack.enter_context(crew)
        ground = stack.enter_context(LinkStation(folder / "ground", connect=[endpoint])) if is_linked else None
        log = folder / "flight.log"
        gate = subprocess.Popen(  # noqa: S603 - our own
            crew.application("--fix"),
            stdout=stack.enter_context(log.open("wb")),
            stderr=subprocess.STDOUT,
            env=environment(),
            preexec_fn=tied(),
        )
        stack.callback(gate.kill)
        _until_it_says("\nexploring", log, gate)
        began_ns = time.monotonic_ns()
        stops: Stops | None = None
        if ground is None:
            time.sleep(arguments.seconds)
        else:
            stops = Stops(_heard(ground), wire)
            _press(stops, wire, arguments.seconds)
            row |= _usage(os.getpid())
        ended_ns = time.monotonic_ns()
        gate.send_signal(signal.SIGINT)
        gate.wait(START_S)
    arrived = [at_ns for at_ns, _ in wire.speeds if began_ns <= at_ns < ended_ns]
    gaps_ms = np.diff(arrived) / 1e6
    row |= {"setpoints": len(arrived), **quantiles("gap", gaps_ms), "gap worst, ms": float(gaps_ms.max())}
    if stops is not None and stops.answered_ms:
        braking_ms = stops.braking_ms()
        row |= {"stops": len(braking_ms), **quantiles("answered", stops.answered_ms)}
        row |= {"answered": stops.answered_ms, "braking": braking_ms}
        row |= quantiles("braking", braking_ms) if braking_ms else {}
    return row


def _press(stops: Stops, wire: Wire, for_s: float) -> None:
    end_s = time.monotonic() + for_s
    next_s = time.monotonic() + FLIES_FOR_S
    while time.monotonic() < end_s:
        time.sleep(0.013)
        if time.monotonic() >= next_s and wire.speeds and wire.speeds[-1][1] > MOVES_MPS:
            stops.press()
            next_s = time.monotonic() + FLIES_FOR_S


def _heard(ground: LinkStation) -> LinkedVehicle:
    give_up_s = time.monotonic() + 30.0
    while time.monotonic() < give_up_s:
        for vehicle in ground.vehicles():
            if vehicle.telemetry is not None:
                return vehicle
        time.sleep(0.05)
    raise CompanionError("the vehicle was not heard over the link")


def _until_it_says(words: str, log: Path, gate: subprocess.Popen[bytes]) -> None:
    give_up_s = time.monotonic() + START_S
    while words not in log.read_text(encoding="utf-8", errors="replace"):
        if gate.poll() is not None or time.monotonic() > give_up_s:
            raise CompanionError(f"it never explored: {log.read_text(encoding='utf-8', errors='replace')[-1500:]}")
        time.sleep(0.05)


def _usage(ours: int) -> Row:
    """What the process of the link uses: the one that listens for the ground."""
    import psutil

    for process in psutil.Process(ours).children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if any(
                one.status == psutil.CONN_LISTEN for one in process.net_connections("tcp")
            ) and "spawn_main" in " ".join(process.cmdline()):
                usage, age_s = Usage.of(process.pid), time.time() - process.create_time()
                return {"link, %": 100.0 * usage.cpu_s / age_s, "link, MB": usage.rss_mb}
    return {}


def summary(which: str, rows: list[Row]) -> Row:
    """All flights of one kind together."""
    answered = [value for row in rows for value in row.get("answered", ())]  # type: ignore[attr-defined]
    braking = [value for row in rows for value in row.get("braking", ())]  # type: ignore[attr-defined]
    made: Row = {"link": which, "flight": "all", "stops": len(braking) or None}
    made |= quantiles("answered", answered) if answered else {}
    made |= quantiles("braking", braking) if braking else {}
    for column in ("gap p50, ms", "gap p99, ms", "gap worst, ms", "link, %", "link, MB"):
        values = [float(str(row[column])) for row in rows if column in row]
        made[column] = float(np.median(values)) if values else math.nan
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in made.items()}


def main() -> None:
    """Fly in turn, print each flight, then all."""
    made = parser(__doc__)
    made.add_argument("--flights", type=int, default=2, metavar="N", help="of each kind")
    made.add_argument("--seconds", type=float, default=120.0, metavar="S", help="of exploring")
    made.add_argument("--world", default="complex", metavar="NAME|MESH")
    made.add_argument("--seed", type=int, default=1)
    arguments = made.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    rows: list[Row] = []
    for number in range(1, arguments.flights + 1):
        for is_linked in (False, True):
            say(f"flight {number} of {arguments.flights}, link {'on' if is_linked else 'off'}")
            with tempfile.TemporaryDirectory(prefix="bench-link-") as folder:
                rows.append(flight(is_linked, number, arguments, Path(folder)))
    groups = [summary(which, [row for row in rows if row["link"] == which]) for which in ("off", "on")]
    show([*rows, *groups], COLUMNS, arguments.json)


if __name__ == "__main__":
    main()
