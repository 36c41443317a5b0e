"""How soon an order of a MAVLink ground station is acknowledged, and braked for on the wire to the autopilot.

One flight on the stub: pauses of the application, each followed by "go on", and at the end a stop, which is the gate's.

python -m bench.flight.ground_orders                                 # PX4, 40 pauses
python -m bench.flight.ground_orders --personality ardupilot --orders 100
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench.common import Row, parser, say, show
from companion.errors import CompanionError
from companion.mavlink.ids import MavCmd, MavComponent
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.launch.processes import Crew, FlightPlan, free_udp_ports
from tests.integration.relay import UdpRelay
from tests.integration.rig import process, wait_for_words
from tests.integration.whole import end_family
from tests.integration.witness import Witness

MOVES_MPS, STANDS_MPS = 0.1, 0.02
START_S, MOVES_S, ANSWER_S, REST_S = 120.0, 30.0, 3.0, 1.0
SEED = 3


class Station(Witness):
    """A ground station on a link of its own to the autopilot, which forwards."""

    def __init__(self, port: int) -> None:
        self.acknowledged_s: dict[int, float] = {}  # by component
        super().__init__(port)

    def orders(self, component: int, parameter: float) -> float:
        """DO_PAUSE_CONTINUE; when it was sent."""
        self.acknowledged_s.pop(component, None)
        sent_s = time.monotonic()
        self.send(m.MAVLink_command_long_message(1, component, MavCmd.DO_PAUSE_CONTINUE, 0, parameter, *[0.0] * 6))
        return sent_s

    def _overhear(self, message: Message) -> None:
        if message.get_type() == "COMMAND_ACK" and message.command == MavCmd.DO_PAUSE_CONTINUE:
            self.acknowledged_s.setdefault(message.get_srcComponent(), time.monotonic())


def main() -> None:
    """Fly, order, print the table."""
    made = parser(__doc__)
    made.add_argument("--personality", choices=("px4", "ardupilot"), default="px4")
    made.add_argument("--orders", type=int, default=40, metavar="N", help="pauses")
    arguments = made.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = _flown(Path(folder), arguments.personality, arguments.orders)
    show(rows, ("order", "number", "p50_ms", "p99_ms", "worst_ms"), arguments.json)


def _flown(folder: Path, personality: str, orders: int) -> list[Row]:
    (gate_port,) = free_udp_ports(1)
    settings: dict[str, dict[str, Any]] = {"autopilot": {"url": f"udpin://127.0.0.1:{gate_port}"}}
    plan = FlightPlan(folder, personality, world="complex", seed=SEED, settings=settings)
    log = folder / "application.log"
    crew = Crew(plan)
    with (
        UdpRelay(gate_port, port=crew.ports.application) as relay,
        crew,
        Station(crew.ports.ground) as station,
        process(log, crew.application("--fix")) as gate,
    ):
        try:
            wait_for_words(log, gate, "\nexploring", START_S)
            pauses = []
            for number in range(orders):
                pauses.append(_order(station, relay, MavComponent.ONBOARD_COMPUTER))
                time.sleep(REST_S)
                station.orders(MavComponent.ONBOARD_COMPUTER, 1.0)
                say(f"{number + 1} of {orders}: {1e3 * pauses[-1][0]:.0f} ms, {1e3 * pauses[-1][1]:.0f} ms")
            stop = _order(station, relay, MavComponent.ONBOARD_COMPUTER2)
        finally:
            end_family(gate.pid)
    return [*_rows("pause", pauses), *_rows("stop", [stop])]


def _order(station: Station, relay: UdpRelay, component: int) -> tuple[float, float]:
    """Once it moves: the time to the acknowledgement, and to the first setpoint on the wire that stands."""
    _until(lambda: _speed_mps(relay) > MOVES_MPS, "the vehicle moves", MOVES_S)
    sent_s = station.orders(component, 0.0)
    _until(lambda: component in station.acknowledged_s, "an acknowledgement", ANSWER_S)
    _until(lambda: _braked_s(relay, sent_s) is not None, "a setpoint that stands", ANSWER_S)
    braked_s = _braked_s(relay, sent_s)
    assert braked_s is not None
    return station.acknowledged_s[component] - sent_s, braked_s - sent_s


def _speed_mps(relay: UdpRelay) -> float:
    newest = relay.seen.setpoints(time.monotonic() - 0.2)
    return math.hypot(newest[-1].vx, newest[-1].vy) if newest else 0.0


def _braked_s(relay: UdpRelay, since_s: float) -> float | None:
    stands = (one.t_s for one in relay.seen.setpoints(since_s) if math.hypot(one.vx, one.vy) < STANDS_MPS)
    return next(stands, None)


def _until(ready: Callable[[], object], what: str, timeout_s: float) -> None:
    give_up_s = time.monotonic() + timeout_s
    while not ready():
        if time.monotonic() > give_up_s:
            raise CompanionError(f"not within {timeout_s:g} s: {what}")
        time.sleep(0.002)


def _rows(name: str, found_s: list[tuple[float, float]]) -> list[Row]:
    rows: list[Row] = []
    for what, values_s in zip(("acknowledged", "braked for on the wire"), zip(*found_s, strict=True), strict=True):
        p50, p99, worst = np.percentile(1e3 * np.asarray(values_s), (50, 99, 100))
        rows.append(
            {"order": f"{name} {what}", "number": len(values_s), "p50_ms": p50, "p99_ms": p99, "worst_ms": worst}
        )
    return rows


if __name__ == "__main__":
    main()
