"""How the flight stands, in the words that go over the link."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from companion.autopilot.telemetry import Telemetry as Autopilot
from companion.clock import Clock
from companion.flight.company import Company
from companion.flight.events import Details, Event
from companion.flight.phase import PhaseMachine
from companion.flight.prospect import Prospect
from companion.flight.reporting import MEANING
from companion.link.words import Place, Telemetry
from companion.mapping.process.client import MapClient
from companion.mavlink.ids import MavSeverity
from companion.model import Pose
from companion.pipeline import Explorer, Tick

WARN_S = 15.0
"""So long a warning is told that nothing takes back."""

MOST_WARNINGS = 8


class Situation:
    """Gathers what is known; a watcher of the ticks, and a sink of events.

    Args:
        vehicle: its name.
        flight: the name of the flight's folder.
        margin_m: d_s.
        reserve_percent: what shall be left of the battery at home.
        phases: know the phase.
        autopilot: its last word.
        mapper: how the map stands.
        explorer: where the vehicle flies to.
        clock: the time.

    Attributes:
        prospect: gives the prospect of coming home, when there is one.
        company: the other vehicles, where there are any.
        ended_because: why the flight ended; empty before.
    """

    def __init__(
        self,
        vehicle: str,
        flight: str,
        margin_m: float,
        reserve_percent: float,
        phases: PhaseMachine,
        autopilot: Autopilot,
        mapper: MapClient,
        explorer: Explorer,
        clock: Clock,
    ) -> None:
        self.prospect: Callable[[], Prospect | None] = lambda: None
        self.company: Company | None = None
        self.ended_because = ""
        self._vehicle, self._flight = vehicle, flight
        self._margin_m, self._reserve_percent = margin_m, reserve_percent
        self._phases = phases
        self._autopilot = autopilot
        self._mapper = mapper
        self._explorer = explorer
        self._clock = clock
        self._tick: Tick | None = None
        self._warned: deque[tuple[float, str]] = deque(maxlen=MOST_WARNINGS)
        self._number = 0

    def __call__(self, tick: Tick) -> None:
        """Take note of a tick."""
        self._tick = tick

    def sink(self, event: Event, details: Details) -> None:
        """Take note of a warning."""
        texts = event.value
        text = texts.console or texts.status
        if texts.severity <= MavSeverity.WARNING and text is not None:
            self._warned.append((self._clock.now_s(), text.format_map(details)))

    def telemetry(self) -> Telemetry:
        """How it stands now."""
        now_s = self._clock.now_s()
        self._number += 1
        state, status = self._autopilot.state(now_s), self._mapper.status
        pose = self._autopilot.poses.newest()
        prospect = self.prospect()
        way = None if prospect is None else prospect.way
        tick = self._tick
        measurement = None if tick is None or not self._phases.phase.airborne else tick.measurement
        battery_percent = state.battery_percent if prospect is None else prospect.charge_percent
        return Telemetry(
            vehicle=self._vehicle,
            flight=self._flight,
            number=self._number,
            t_s=now_s,
            phase=self._phases.phase.in_words,
            paused=self._phases.paused,
            mode=self._mode(),
            x_m=None if pose is None else _known(pose.x_m),
            y_m=None if pose is None else _known(pose.y_m),
            z_m=None if pose is None else _known(pose.z_m),
            yaw_rad=None if pose is None else _known(pose.yaw_rad),
            frame=self._frame(),
            d_m=None if measurement is None else _known(measurement.d_m),
            margin_m=self._margin_m,
            h_m=None if measurement is None else _known(measurement.h_m),
            height_m=self._explorer.navigator.height_m,
            target_m=self._target_m(pose),
            battery_percent=_known(battery_percent),
            home_m=None if way is None else _known(way.length_m),
            home_s=None if way is None else _known(way.time_s),
            left_at_home_percent=None if prospect is None else _known(prospect.left_percent),
            reserve_percent=self._reserve_percent,
            completeness=_known(status.completeness),
            frontiers=status.frontiers,
            warnings=self._warnings(now_s),
            ended_because=self.ended_because,
        )

    def _frame(self) -> tuple[float, float, float, float] | None:
        frame = None if self.company is None else self.company.frame
        return None if frame is None else (frame.x_m, frame.y_m, frame.z_m, frame.yaw_rad)

    def _mode(self) -> str:
        tick = self._tick
        if tick is None or not self._phases.phase.steered:
            return ""
        return f"stopped, no {', '.join(tick.missing)}" if tick.missing else MEANING[tick.mode]

    def _target_m(self, pose: Pose | None) -> Place | None:
        target = self._explorer.navigator.status.target
        if target is None or pose is None or not self._phases.phase.steered:
            return None
        place = (target.x_m, target.y_m, pose.z_m)
        return place if all(map(math.isfinite, place)) else None

    def _warnings(self, now_s: float) -> tuple[str, ...]:
        """What is wrong now, each once: what lasts first."""
        lasting = []
        if self._tick is not None and self._phases.phase.steered and self._tick.missing:
            lasting.append(f"stopped: no {', '.join(self._tick.missing)}; it goes on by itself when that is back")
        if self._mapper.status.problem:
            lasting.append(f"map: {self._mapper.status.problem}")
        recent = [text for t_s, text in reversed(self._warned) if now_s - t_s <= WARN_S]
        return tuple(dict.fromkeys([*lasting, *recent]))[:MOST_WARNINGS]


def _known(value: float | None) -> float | None:
    """A number, or None where it is none."""
    return float(value) if value is not None and math.isfinite(value) else None
