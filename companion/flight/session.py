"""Everything that listens: the link, the telemetry, the sensors. Shared by the pre-flight check and the flight."""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass

from companion.autopilot.interface import Link
from companion.autopilot.link import MavsdkLink
from companion.autopilot.rc_switch import RcSwitch
from companion.autopilot.telemetry import Telemetry
from companion.clock import Clock
from companion.config.settings import Settings
from companion.errors import InputError
from companion.flight.company import Company
from companion.flight.control_loop import ControlLoop, Rate, Watcher
from companion.flight.gate_client import GateClient
from companion.flight.phase import PhaseMachine
from companion.flight.tasks import background
from companion.model import Setpoint
from companion.pipeline import Explorer
from companion.sensors.drivers.driver import DriverContext, SensorDriver, load_drivers
from companion.sensors.sink import SensorSink
from companion.sensors.synchronizer import Synchronizer

DRIVER_REST_S = 1.0
"""A driver that failed is started again after this long."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Session:
    """What is listened to."""

    settings: Settings
    clock: Clock
    link: Link
    telemetry: Telemetry
    sink: SensorSink
    inputs: Synchronizer
    gate: GateClient
    flight: PhaseMachine
    rc_switch: RcSwitch | None
    """The transmitter's switch; None where none is configured."""

    def control_loop(
        self,
        explorer: Explorer,
        send: Callable[[Setpoint], bool] | None = None,
        watchers: tuple[Watcher, ...] = (),
        company: Company | None = None,
    ) -> ControlLoop:
        """The loop over these inputs, which tells the gate of every tick; see `ControlLoop`."""
        rate = Rate(self.clock, self.settings.control.period_s)
        return ControlLoop(self.inputs, explorer, rate, self.flight, send, watchers, self.gate.ticked, company)


@asynccontextmanager
async def open_session(
    settings: Settings, clock: Clock, gate: GateClient, flight: PhaseMachine
) -> AsyncIterator[Session]:
    """Connect to the autopilot through the gate and start the sensors; everything ends with the block.

    Raises:
        LinkError: no autopilot answered.
        GateLostError: the gate ended before anything flew.
        InputError: a driver's settings can never work.
    """
    async with background(gate.run()), MavsdkLink(settings.autopilot, clock, gate.socket) as link:
        telemetry = Telemetry(link, clock, settings)
        sink = SensorSink(clock)
        drivers = load_drivers(settings, DriverContext(clock, link))
        async with background(telemetry.run(), *(_keep_running(driver, sink, clock) for driver in drivers)):
            inputs, switch = Synchronizer(sink, telemetry.poses), settings.mission.rc_switch
            rc_switch = None if switch.channel is None else RcSwitch(switch, link)
            yield Session(settings, clock, link, telemetry, sink, inputs, gate, flight, rc_switch)


async def _keep_running(driver: SensorDriver, sink: SensorSink, clock: Clock) -> None:
    """A driver that fails takes its readings away and nothing else: the vehicle stops until they are back."""
    while True:
        try:
            await driver.run(sink)
        except InputError:
            raise
        except Exception:  # noqa: BLE001 - a driver may be anybody's, and may fail in any way
            _log.exception("sensor driver %s failed; it is started again in %g s", driver.name, DRIVER_REST_S)
        await clock.sleep(DRIVER_REST_S)
