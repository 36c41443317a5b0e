"""The autopilot as a pure state machine: messages and the time go in, messages come out."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from companion.mavlink.ids import MavSeverity
from companion.model import Pose
from sitl.autopilot.airframe import Airframe, Surroundings, flat
from sitl.autopilot.battery import Battery
from sitl.autopilot.commands import Commands
from sitl.autopilot.estimator import Estimator
from sitl.autopilot.events import FIRST_SEQUENCE, event_message
from sitl.autopilot.explore_script import ExploreScript
from sitl.autopilot.guidance import motion
from sitl.autopilot.inbox import Inbox
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.origin import to_global
from sitl.autopilot.parameters import Parameters
from sitl.autopilot.personality import Personality
from sitl.autopilot.state import Mode, State
from sitl.autopilot.streams import Streams
from sitl.autopilot.telemetry import Telemetry

STEP_S = 0.01
"""The vehicle's own step."""
_CATCH_UP_S = 0.5
"""After a pause longer than this, time jumps: the vehicle does not fly what it missed."""
_PARAMETERS_PER_STEP = 4
_TEXT_BYTES = 50
_LANDED_S = 1.0
"""So long on the ground, and the land detector believes it."""


class Autopilot:
    """One vehicle with its autopilot. Knows no socket and no clock.

    Args:
        personality: `PX4` or `ARDUPILOT`.
        start: true pose at boot, in the world's east-north-up frame; its height becomes that of the ground there.
        t_s: the time of booting.
        system_id: the vehicle's MAVLink number.
        surroundings: ground and walls; level ground at the start's height by default.
        gps: whether there is a GPS receiver. Without, the parameters are those of a vehicle set up for it.
        parameters: values besides the defaults.
        boot_s: time until it arms with GPS instead of the measured one; other waits after boot shrink alike.
        battery_percent: charge at boot.
        battery_minutes: of flight from full to empty.
        seed: draws noise and disturbance.

    Raises:
        InputError: a parameter that the autopilot does not have, or a value that does not fit.
    """

    def __init__(
        self,
        personality: Personality,
        start: Pose,
        t_s: float = 0.0,
        *,
        system_id: int = 1,
        surroundings: Surroundings | None = None,
        gps: bool = True,
        parameters: Mapping[str, float] | None = None,
        boot_s: float | None = None,
        battery_percent: float = 100.0,
        battery_minutes: float = 15.0,
        seed: int = 1,
    ) -> None:
        self.personality = personality
        self.system_id = system_id
        self._surroundings = flat(start.z_m) if surroundings is None else surroundings
        self._gps = gps
        self._hurry = 1.0 if boot_s is None else boot_s / personality.ready_s
        self._rng = np.random.default_rng(seed)
        cells, capacity_mah = personality.numbers.cells, personality.numbers.capacity_mah
        battery = Battery(battery_percent, battery_minutes, cells, capacity_mah)
        own = Parameters(personality.parameters, personality.encoding, personality.integer, personality.kinds)
        for name, value in ({} if gps else personality.no_gps_parameters).items():
            own.set(name, value)
        for name, value in (parameters or {}).items():
            own.set(name, value)
        self._boot(start, t_s, own, battery, Counter())

    def _boot(self, start: Pose, t_s: float, own: Parameters, battery: Battery, counts: Counter[str]) -> None:
        personality, numbers = self.personality, self.personality.numbers
        battery.boot()
        inertia = numbers.damping, numbers.drift_mps, numbers.turning_drift
        airframe = Airframe(replace(start, t_s=t_s), self._surroundings, *inertia, self._rng)
        estimator = Estimator(airframe.pose, numbers.blind_drift_mps2, numbers.blind_mps, self._rng)
        mode = personality.modes[personality.boot_mode]
        self.state = State(t_s, t_s, own, airframe, estimator, battery, mode, self._gps, self._hurry, counts=counts)
        self.state.transmitter_on = personality.transmitter_at_boot
        self._watch = personality.new_watch()
        self._telemetry = Telemetry(personality, self.state, self.system_id)
        self._streams = Streams(personality.rates_hz, t_s)
        commands = Commands(personality, self.state, self._streams, self._telemetry)
        self._script = ExploreScript(self.state, self.system_id)
        self._inbox = Inbox(personality, self.state, commands, self.system_id, self._script.acknowledged)
        self._sync_next_s = t_s
        self._texts_in_pieces = 0
        self._events = FIRST_SEQUENCE

    @property
    def pose(self) -> Pose:
        """The true pose in the world."""
        return self.state.airframe.pose

    @property
    def mode(self) -> Mode:
        """The mode that the heartbeat shows."""
        return self.state.shown

    def receive(self, message: Message, t_s: float, routed: bool = False) -> list[Message]:
        """Takes one message that arrived at ``t_s``; what is wrong with it is counted in ``state.counts``.

        Args:
            message: any message.
            t_s: when it came.
            routed: it went on to the component that it is for.
        """
        self.state.t_s = max(self.state.t_s, t_s)
        answers = self._inbox.take(message, routed)
        if self._inbox.reboot:
            state = self.state
            self._boot(self.pose, state.t_s, state.parameters, state.battery, state.counts)
        return answers

    def step(self, t_s: float) -> list[Message]:
        """Flies on until ``t_s`` and returns the telemetry that fell due."""
        sent: list[Message] = []
        if t_s - self.pose.t_s > _CATCH_UP_S:
            self.state.counts["pauses"] += 1
            self.state.airframe.skip(t_s - _CATCH_UP_S - self.pose.t_s)
        while self.pose.t_s + STEP_S <= t_s + 5e-7:
            self._advance(self.pose.t_s + STEP_S)
            sent += self._say()
        return sent

    def pilot_takes_over(self) -> None:
        """A pilot's switch: the transmitter is there, and its mode is taken whatever was flown before."""
        self.set_transmitter(True)
        self.state.enter(self.personality.modes[self.personality.pilot_mode])

    def set_transmitter(self, on: bool) -> None:
        """Switches the transmitter on, its sticks in the middle, or off."""
        self.state.transmitter_on = on
        if on:
            self.state.transmitter.heard(self.state.t_s)

    def set_channel(self, number: int, pulse_us: int) -> None:
        """Moves a stick or a switch of the transmitter, whose channels are counted from 1."""
        self.state.channels_us[number - 1] = pulse_us

    def set_gps(self, present: bool) -> None:
        """Covers or uncovers the GPS antenna."""
        self._gps = self.state.gps_present = present

    def _advance(self, t_s: float) -> None:
        state, personality = self.state, self.personality
        state.t_s = t_s
        by_gps = personality.gps_set_up(state) and state.gps_present
        if state.origin is None and by_gps and personality.position_valid(state):
            booted = state.estimator.origin
            state.origin, state.origin_s = to_global(booted.x_m, booted.y_m, booted.z_m), t_s
        was_crashed, was_armed = state.airframe.crashed, state.armed
        self._watch.step(state, STEP_S)
        personality.supervise(state)
        self._script.step()
        state.motion = motion(personality, state, STEP_S)
        state.airframe.step(STEP_S, state.motion)
        state.estimator.step(state.airframe.pose, STEP_S, by_gps)
        state.flown = state.flown or state.flying
        state.on_ground_s = state.on_ground_s + STEP_S if state.armed and state.airframe.on_ground else 0.0
        if state.airframe.crashed and not was_crashed:
            state.say(MavSeverity.CRITICAL, "Crash: Disarming")
            state.disarm("Disarmed by crash")
        if was_armed and not state.armed and state.mode_after_disarming is not None:
            state.enter(state.mode_after_disarming)
        self._detect_landing()
        state.battery.step(STEP_S, state.flying)

    def _detect_landing(self) -> None:
        state = self.state
        if state.landed and state.armed and self.personality.in_the_air(state):
            state.landed = False
        elif not state.landed and (not state.armed or (state.on_ground_s >= _LANDED_S and state.hover_s == 0.0)):
            state.landed = True
        else:
            return
        self.personality.tell_landed(state)

    def _say(self) -> list[Message]:
        state = self.state
        sent = [
            message for name in self._streams.due(state.t_s) if (message := self._telemetry.build(name)) is not None
        ]
        if state.heartbeat_due and self.personality.heartbeat_with_mode:
            sent += [x for x in (self._telemetry.build("HEARTBEAT"),) if x is not None]
        state.heartbeat_due = False
        while state.later and state.later[0][0] <= state.t_s + 5e-7:
            sent.append(state.later.popleft()[1])
        while state.events:
            sent.append(event_message(state.events.popleft(), round(state.since_boot_s * 1e3), self._events))
            self._events = (self._events + 1) % 65536
        while state.texts:
            severity, text = state.texts.popleft()
            sent += self._text(severity, text.encode())
        sent += self._inbox.listed(_PARAMETERS_PER_STEP)
        if state.t_s >= self._sync_next_s - 5e-7:
            self._sync_next_s = max(self._sync_next_s, state.t_s - 1.0) + self.personality.sync_period_s
            sent.append(m.MAVLink_timesync_message(0, math.floor(state.since_boot_s * 1e9)))
        return sent

    def _text(self, severity: MavSeverity, text: bytes) -> list[Message]:
        """A STATUSTEXT, in pieces when it is longer than one holds."""
        if len(text) <= _TEXT_BYTES:
            return [m.MAVLink_statustext_message(int(severity), text)]
        self._texts_in_pieces = self._texts_in_pieces % 65535 + 1
        pieces = [text[i : i + _TEXT_BYTES] for i in range(0, len(text), _TEXT_BYTES)]
        return [
            m.MAVLink_statustext_message(int(severity), piece, self._texts_in_pieces, i)
            for i, piece in enumerate(pieces)
        ]
