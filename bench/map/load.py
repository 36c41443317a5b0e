"""Whether the map disturbs the control: setpoints on the wire and ticks, with the map's process and without it.

python -m bench.map.load                # three flights of each kind, in turn; about a minute and a half each
python -m bench.map.load --quick        # one short flight of each kind

Real time and the real parts: autopilot (stub), world, safety gate and application as processes, over MAVLink. Every
flight has the same camera and the same voxels, 640 x 480 at 30 Hz and 0.05 m by default; only the map differs:

- ``off``: no process of the map, no image is handed to anybody.
- ``busy``: the same, with a process beside it that has the map's priority and only computes. What that does to the
  control, this computer does whatever it is kept busy with: a virtual machine whose processors are all in use is given
  fewer of them.
- ``camera``: as it is flown. A tick hands over the image that it has seen: 20 a second at most.
- ``full``: besides, whenever the map has a free place for an image, looked at every 5 ms, it gets the newest one again,
  turned by up to 0.3 rad, so that there is always new space to map. Its process is hardly ever idle, and each of these
  images is copied by the event loop that also makes the ticks.

The gap between setpoints is that of the application's SET_POSITION_TARGET_LOCAL_NED as they leave the gate, stamped by
the kernel when they arrive at the autopilot's end. What the gate itself says when the application is late does not
count, and stands under ``by gate``; when the gate had to stop the vehicle for it, which takes a second at least, that
is a gap too, and counted under ``braked``. ``stolen`` is what the host took of the processors of a virtual machine, and
``waited`` for how long a thread of the application was ready and was given none, both in % of the time. Ticks are those
of the recording, which is made without depth images: a disk is another matter. ``offer`` is how long the event loop is
held up by handing one image over. Processor time is that of each process over the measured time, 100 % being one core;
``all`` is that of the whole computer, this bench and other people included. On a vehicle's computer there is neither
world nor autopilot: here they run before all others, when the user may do so.

The figures mean something only when the computer has nothing else to do. Compare within one run.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import signal
import subprocess
import tempfile
import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.common import Row, Usage, camera_rate, parser, quantiles, say, show, write
from bench.gate.autopilot import Wire
from bench.map.load_child import MAP, MAPS, OFFERS
from companion.config.load import load_settings
from companion.errors import CompanionError
from companion.flight.request import FlightRequest, application, module, sealed
from companion.recording.flight_stats import figures
from companion.safety_case.gate_plan import to_plan
from sitl.launch.processes import Crew, FlightPlan, environment, free_udp_ports
from sitl.launch.program import tied

SETTLE_S = 3.0
"""After the words "exploring": the last of the take-off does not count."""
START_S = 600.0
HARDWARE_NICENESS = -10
APART = ("gap p50, ms", "gap p99, ms", "gap worst, ms", "tick p50, ms", "tick p99, ms", "tick worst, ms")
OFFER = ("offer p50, ms", "offer worst, ms")
USED = ("application, %", "map, %", "gate, %", "world, %", "autopilot, %", "all, %")
HOST = ("waited, %", "stolen, %")
COLUMNS = ("map", "flight", "setpoints", "by gate", "braked", *APART, *HOST, "images/s", *OFFER, *USED)


@dataclass(frozen=True, slots=True)
class Host:
    """What the kernel has counted so far, in s.

    Attributes:
        used_s: of all processors by anybody.
        stolen_s: of all processors by the host.
        waited_s: of all threads of one process, ready to run.
    """

    used_s: float
    stolen_s: float
    waited_s: float

    @classmethod
    def now(cls, pid: int) -> Host:
        """By the word of the kernel."""
        first = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()[1:]
        # The last two are parts of the first two.
        user, nice, system, _, _, interrupt, soft, stolen = (int(ticks) for ticks in first[:8])
        a_second = os.sysconf("SC_CLK_TCK")
        tasks = Path(f"/proc/{pid}/task").iterdir()
        waited_ns = [int((task / "schedstat").read_text(encoding="ascii").split()[1]) for task in tasks]
        used = user + nice + system + interrupt + soft
        return cls(used / a_second, stolen / a_second, sum(waited_ns) * 1e-9)


def flight(which: str, number: int, arguments: Namespace, folder: Path) -> Row:
    """One flight: its row."""
    (gate_port,) = free_udp_ports(1)
    width_px, height_px, rate_hz = arguments.camera
    camera = {"width_px": width_px, "height_px": height_px, "rate_hz": rate_hz}
    plan = FlightPlan(
        folder=folder,
        world=arguments.world,
        seed=arguments.seed,
        time_limit_s=SETTLE_S + arguments.seconds + 1.0,
        settings={
            "autopilot": {"url": f"udpin://127.0.0.1:{gate_port}"},
            "sensors": {"camera": camera},
            "mapping": {"voxel_m": arguments.voxel, "max_range_m": arguments.range},
            # A busy computer renders and stamps less well than pre-flight wants: it is the computer that is measured.
            "mission": {"skip_checks": ["clock", "depth"]},
            "record": {"depth": False},
        },
        autopilot=("--boot-s", "2"),
        world_options=("--config", str(folder / "vehicle.yaml")),
    )
    crew = Crew(plan)
    with Wire(gate_port) as wire:
        crew.ports = dataclasses.replace(crew.ports, application=wire.port)
        # In this order: the application must not inherit the precedence of the hardware.
        with crew, _application(crew, which, folder) as gate, _before_all_others():
            _wait_for(folder / "gate.log", gate, "\nexploring")
            time.sleep(SETTLE_S)
            pids = {"gate": gate.pid, "application": _child(gate.pid, "companion.flight", "bench.map.load_child")}
            pids |= {name: _child(os.getpid(), f"sitl\0{name}") for name in ("world", "autopilot")}
            if which != "off":
                pids["map"] = _child(pids["application"], "spawn_main")
            begun_ns, before, host_before = time.monotonic_ns(), _used(pids), Host.now(pids["application"])
            braked_before = _braked(folder / "gate.log")
            time.sleep(arguments.seconds)
            braked_after = _braked(folder / "gate.log")
            ended_ns, after, host_after = time.monotonic_ns(), _used(pids), Host.now(pids["application"])
            try:
                gate.wait(START_S)
            except subprocess.TimeoutExpired:
                raise CompanionError(f"the flight did not end: {_words(folder / 'gate.log')}") from None
            crew.check()
    found = figures(next(folder.glob("*/flight.mcap")))
    past_s = (ended_ns - begun_ns) / 1e9
    arrived = [(at_ns, component) for at_ns, component in wire.setpoints if begun_ns <= at_ns < ended_ns]
    # The autopilot, the gate and a ground station have numbers of their own: whose there are most is who steers.
    components = [component for _, component in arrived]
    steers = max(set(components), key=components.count)
    gaps_ms = np.diff([at_ns for at_ns, component in arrived if component == steers]) / 1e6
    offers_ms = 1e3 * np.array(json.loads((folder / "offers.json").read_text(encoding="ascii")))
    tick = found.tick_s
    assert tick is not None
    return {
        "map": which,
        "flight": number,
        "setpoints": len(gaps_ms) + 1,
        "by gate": len(arrived) - len(gaps_ms) - 1,
        "braked": braked_after - braked_before,
        **quantiles("gap", gaps_ms),
        "gap worst, ms": float(gaps_ms.max()),
        "tick p50, ms": 1e3 * tick.median,
        "tick p99, ms": 1e3 * tick.p99,
        "tick worst, ms": 1e3 * tick.largest,
        "images/s": _images_hz(folder, found.engaged_s),
        "offer p50, ms": float(np.percentile(offers_ms, 50)) if offers_ms.size else None,
        "offer worst, ms": float(offers_ms.max()) if offers_ms.size else None,
        **{f"{name}, %": 100.0 * (after[name].cpu_s - before[name].cpu_s) / past_s for name in pids},
        "all, %": 100.0 * (host_after.used_s - host_before.used_s) / past_s,
        "stolen, %": 100.0 * (host_after.stolen_s - host_before.stolen_s) / past_s,
        "waited, %": 100.0 * (host_after.waited_s - host_before.waited_s) / past_s,
        "map, MB": after["map"].rss_mb if "map" in after else None,
    }


@contextlib.contextmanager
def _application(crew: Crew, which: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The gate as `companion run` starts it, whose child is the application with one map or another."""
    settings = load_settings(crew.config)
    request_fd = FlightRequest("run", settings, "flight", crew.plan.seed, fix=True).sealed()
    child = application(request_fd, "bench.map.load_child")
    plan = dataclasses.replace(
        to_plan(settings, command=child, restart_command=child, inherit=(request_fd,)), restarts=0
    )
    plan_fd = sealed("plan", plan.dumps())
    with (folder / "gate.log").open("wb") as log:
        gate = subprocess.Popen(  # noqa: S603 - our own
            [*module("companion.gate"), "--plan-fd", str(plan_fd)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**environment(), MAP: which, OFFERS: str(folder / "offers.json")},
            pass_fds=(request_fd, plan_fd),
            start_new_session=True,
            preexec_fn=tied(),
        )
    for number in (request_fd, plan_fd):
        os.close(number)
    try:
        yield gate
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(gate.pid, signal.SIGKILL)
        gate.wait()


@contextlib.contextmanager
def _before_all_others() -> Iterator[None]:
    """Autopilot, world and wire are hardware on a vehicle, which waits for nobody. Without the right: nothing."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    ours = os.getpid()
    _set_niceness([ours, _child(ours, "sitl\0world"), _child(ours, "sitl\0autopilot")], HARDWARE_NICENESS)
    try:
        yield
    finally:
        _set_niceness([ours], before)


def _set_niceness(pids: Sequence[int], niceness: int) -> None:
    with contextlib.suppress(PermissionError):
        for pid in pids:
            for thread in Path(f"/proc/{pid}/task").iterdir():
                os.setpriority(os.PRIO_PROCESS, int(thread.name), niceness)


def _child(pid: int, *words: str) -> int:
    """The child of a process that has one of these words in its command line."""
    for thread in Path(f"/proc/{pid}/task").iterdir():
        for child in (thread / "children").read_text(encoding="ascii").split():
            line = Path(f"/proc/{child}/cmdline").read_bytes().decode(errors="replace")
            if any(word in line for word in words):
                return int(child)
    raise CompanionError(f"process {pid} has no child with {' or '.join(words)} in its command line")


def _used(pids: dict[str, int]) -> dict[str, Usage]:
    return {name: Usage.of(pid) for name, pid in pids.items()}


def _images_hz(folder: Path, engaged_s: float | None) -> float | None:
    """Images that the map has put in, by its own count, a second of the flight."""
    summary = json.loads(next(folder.glob("*/summary.json")).read_text(encoding="utf-8"))
    return float(summary["map_frames"]) / engaged_s if engaged_s else None


def _wait_for(log: Path, process: subprocess.Popen[bytes], words: str) -> None:
    give_up_s = time.monotonic() + START_S
    while words not in log.read_text(encoding="utf-8", errors="replace"):
        if process.poll() is not None or time.monotonic() > give_up_s:
            raise CompanionError(f"it never explored: {_words(log)}")
        time.sleep(0.05)


def _flown(which: str, number: int, arguments: Namespace, folder: Path) -> Row:
    """The row of a flight, or what broke it off: on a computer that stands still for a second the autopilot lands."""
    try:
        return flight(which, number, arguments, folder)
    except (CompanionError, FileNotFoundError) as error:
        log = folder / "gate.log"
        said = _words(log) if isinstance(error, FileNotFoundError) and log.exists() else str(error)
        say(f"it broke off, and is left out: {said}")
        return {"failed": said}


def _braked(log: Path) -> int:
    """How often the gate has stopped the vehicle so far; with the time of day, for it says each thing twice."""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    return sum(line[:1].isdigit() and " gate: brake:" in line for line in lines)


def _words(log: Path) -> str:
    return log.read_text(encoding="utf-8", errors="replace")[-1500:]


def summary(which: str, rows: Sequence[Row], base: Sequence[Row]) -> list[Row]:
    """The median and the worst over the flights of one kind, and the ratio of both to those without a map."""
    columns = ("braked", *APART, *HOST, "images/s", *OFFER, *USED)
    made: list[Row] = []
    for how in ("median", "worst"):
        row: Row = {"map": which, "flight": how}
        made.append(row | {column: _over(rows, column, how) for column in columns})
    for how in ("median", "worst"):
        row = {"map": which, "flight": f"{how} / {base[0]['map']}"}
        for column in APART:
            mine, theirs = _over(rows, column, how), _over(base, column, how)
            row[column] = mine / theirs if mine is not None and theirs else None
        made.append(row)
    return made


def _over(rows: Sequence[Row], column: str, how: str) -> float | None:
    values = [float(str(row[column])) for row in rows if row.get(column) is not None]
    if not values:
        return None
    return float(np.median(values)) if how == "median" else max(values)


def main() -> None:
    """Fly in turn, print each flight, then medians, worst and ratios."""
    made = parser(__doc__)
    made.add_argument("--flights", type=int, default=3, metavar="N", help="of each kind")
    made.add_argument("--seconds", type=float, default=30.0, metavar="S", help="measured of each flight")
    made.add_argument("--maps", default=",".join(MAPS), help=f"kinds, separated by commas: {', '.join(MAPS)}")
    made.add_argument("--camera", type=camera_rate, default=(640, 480, 30.0), metavar="WxH@HZ", help="else 640x480@30")
    made.add_argument("--voxel", type=float, default=0.05, metavar="M")
    made.add_argument("--range", type=float, default=6.0, metavar="M", help="mapping.max_range_m")
    made.add_argument("--world", default="complex", metavar="NAME|MESH")
    made.add_argument("--seed", type=int, default=1)
    made.add_argument("--quick", action="store_true", help="one flight of 10 s of each kind")
    made.add_argument("--keep", type=Path, metavar="DIR", help="keep the files of the flights there")
    arguments = made.parse_args()
    if arguments.quick:
        arguments.flights, arguments.seconds = 1, 10.0
    # As after Ctrl-C: all processes of a flight end with it.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    kinds = arguments.maps.split(",")
    rows: list[Row] = []
    with contextlib.ExitStack() as stack:
        parent = arguments.keep or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bench-map-load-")))
        parent.mkdir(parents=True, exist_ok=True)
        for number in range(1, arguments.flights + 1):
            for which in kinds:
                say(f"flight {number} of {arguments.flights}, map {which}")
                folder = parent / f"{which}-{number}"
                folder.mkdir()
                rows.append({"map": which, "flight": number} | _flown(which, number, arguments, folder))
                if arguments.json is not None:
                    write(rows, arguments.json)
    width_px, height_px, rate_hz = arguments.camera
    print(
        f"{os.cpu_count()} cores; camera {width_px} x {height_px} at {rate_hz:g} Hz, voxels of {arguments.voxel:g} m, "
        f"range {arguments.range:g} m, {arguments.seconds:g} s of each flight"
    )
    base = [row for row in rows if row["map"] == kinds[0]]
    groups = [[row for row in rows if row["map"] == which] for which in kinds]
    lines = [row for group in groups for row in group]
    lines += [row for group in groups for row in summary(str(group[0]["map"]), group, base)]
    show(lines, COLUMNS, arguments.json)


if __name__ == "__main__":
    main()
