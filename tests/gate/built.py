"""What the tests of the gate's parts are made of: a plan, frames of everybody, and a gate with a vehicle in the air."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import lru_cache
from typing import Any

from companion.gate.faults import Fault, Stage
from companion.gate.gate import Gate
from companion.gate.plan import Geofence, Limits, Plan, Reaction, Stopping, Thresholds
from companion.gate.protocol import Beat, Phase
from companion.mavlink.codec import Encoder, Frame, Framer, decode
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.messages import BY_NAME
from companion.mavlink.modes import Personality, personality

SYSTEM = 1
AUTOPILOT, APPLICATION, GATE = 1, 191, 192
GROUND = (255, 190)

PLAN = Plan(
    autopilot_url="udpin://127.0.0.1:14540",
    system_id=SYSTEM,
    gps=False,
    period_s=0.05,
    silence_s=0.5,
    limits=Limits(speed_mps=0.55, climb_mps=0.44, yaw_rate_radps=0.66, accel_mps2=2.0),
    fence=Geofence(),
    thresholds=Thresholds(
        setpoint_s=0.12,
        beat_s=0.12,
        depth_s=0.6,
        ranges_s=0.4,
        pose_s=0.25,
        pose_jump_m=0.5,
        pose_frozen_s=0.3,
        heartbeat_s=3.0,
        link_s=0.4,
        map_s=30.0,
        hang_s=10.0,
        aiding_s=0.5,
        gps_s=1.0,
        odometry_s=0.25,
        not_obeyed_mps=0.2,
        hard_limit_m=0.5,
        battery_percent=15.0,
        battery_v=None,
        messages_hz=400.0,
    ),
    reactions=dict.fromkeys(Fault, Reaction(Stage.BRAKE, 5.0, 30.0)) | {Fault.MAP: Reaction(Stage.PASS, None, None)},
    recover_s=1.0,
    stopping=Stopping(delay_s=0.15, brake_mps2=0.8, creep_m=0.0),
    attached=(),
    signing=None,
    command=("true",),
    restart_command=("true",),
    restarts=3,
    inherit=(),
    realtime=False,
)

BEAT = Beat(0.0, 0.1, 0.05, 0.02, 5.0, 0.5, Phase.EXPLORING)
AUTOPILOT_NUMBER = {AutopilotKind.PX4: 12, AutopilotKind.ARDUPILOT: 3}
VALID = 0x1F
SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"


def frame(name: str, component: int = APPLICATION, system: int = SYSTEM, **fields: Any) -> Frame:
    """One message of somebody, as the gate gets it."""
    return _framed(name, component, system, tuple(fields.items()))


@lru_cache(maxsize=256)
def _framed(name: str, component: int, system: int, fields: tuple[tuple[str, Any], ...]) -> Frame:
    (found,) = Framer().frames(Encoder(system, component).pack(name, **dict(fields)))
    return found


def told(name: str, **fields: Any) -> Frame:
    """One message of the autopilot that is new each time: what `frame` gives, but for the bytes on the wire."""
    layout = BY_NAME[name]
    payload = layout.packing.pack(*(fields.get(field, 0) for field in layout.fields))
    return Frame(b"", layout.message_id, SYSTEM, AUTOPILOT, payload, signed=False)


def read(raw: bytes) -> tuple[Frame, dict[str, Any]]:
    """What the gate has sent."""
    (found,) = Framer().frames(raw)
    fields = decode(found)
    assert fields is not None
    return found, fields


def setpoint(vx: float = 0.0, vy: float = 0.0, vz: float = 0.0, yaw_rate: float = 0.0, **fields: Any) -> Frame:
    """One of the application, right in everything that is not said."""
    right = {"target_system": SYSTEM, "target_component": 1, "coordinate_frame": 8, "type_mask": 0x5C7}
    return frame(SETPOINT, **(right | {"vx": vx, "vy": vy, "vz": vz, "yaw_rate": yaw_rate} | fields))


def command(number: int, *parameters: float, component: int = APPLICATION, **fields: Any) -> Frame:
    """A COMMAND_LONG of the application."""
    values = {f"param{i}": value for i, value in enumerate(parameters, 1)}
    right = {"target_system": SYSTEM, "target_component": 1, "command": number}
    return frame("COMMAND_LONG", component, **(right | values | fields))


def texts_of(gate: Gate, now_s: float = 0.0) -> list[str]:
    """The texts that the gate has given out since the last call."""
    return [notice.text for notice in gate.drain_notices(now_s) if notice.text]


class Air:
    """A gate, an autopilot and an application, moved through time by hand.

    Each `run` lets everybody speak as they should, but for what is switched off by the attributes.
    """

    def __init__(self, plan: Plan = PLAN, kind: AutopilotKind = AutopilotKind.PX4) -> None:
        self.now_s = 1000.0
        self.plan = plan
        self.kind = kind
        self.gate = Gate(plan, self.now_s)
        self.beat = BEAT
        self.beats = self.setpoints = self.positions = self.heartbeats = True
        self.obeys = True
        """Whether the autopilot takes the modes that it is asked for."""
        self.mode = self.ours.hold
        self.armed = False
        self.position: dict[str, Any] = {"x": 0.0, "y": 0.0, "z": -1.5, "vx": 0.0, "vy": 0.0, "vz": 0.0}
        self.wanted = (0.0, 0.0, 0.0, 0.0)
        self.sent: list[tuple[float, str, dict[str, Any]]] = []
        self.passed: list[tuple[float, dict[str, Any]]] = []
        self.notices: list[str] = []
        self._ticks = 0

    @property
    def ours(self) -> Personality:
        """The modes of the autopilot."""
        return personality(self.kind)

    def stage(self) -> Stage:
        return self.gate.stage

    def tell(self, name: str, component: int = AUTOPILOT, system: int = SYSTEM, **fields: Any) -> None:
        """Something comes over the autopilot's link."""
        self.gate.on_autopilot_message(frame(name, component, system, **fields), self.now_s)

    def heartbeat(self) -> None:
        """The autopilot's."""
        base = 128 if self.armed else 0
        self.tell("HEARTBEAT", autopilot=AUTOPILOT_NUMBER[self.kind], base_mode=base, custom_mode=self.mode)

    def ask(self, sent: Frame) -> bytes | None:
        """The application sends something; what goes down in answer."""
        return self.gate.on_application_message(sent, self.now_s).raw

    def set_mode(self, mode: int) -> bytes | None:
        """The application asks for a mode, and gets it when that passes."""
        raw = self.ask(command(176, *self.ours.set_mode_parameters(mode)))
        if raw is not None and self.obeys:
            self.mode = mode
            self.heartbeat()
        return raw

    def run(self, duration_s: float) -> None:
        """Everybody goes on for so long: the gate 100, the autopilot 50, the application 20 times a second."""
        for _ in range(round(duration_s / 0.01)):
            self.now_s += 0.01
            self._ticks += 1
            if self.heartbeats and self._ticks % 100 == 0:
                self.heartbeat()
            if self.positions and self._ticks % 2 == 0:
                self._tell_position()
            if self.beats and self._ticks % 5 == 0:
                self.gate.on_word(replace(self.beat, t_s=self.now_s).packed(), self.now_s)
            if self.setpoints and self._ticks % 5 == 0:
                self._steer()
            for raw in self.gate.cycle(self.now_s):
                self._obey(raw)
            self.notices += texts_of(self.gate)

    def take_off(self) -> None:
        """To where the application explores."""
        self.heartbeat()
        self.beat = replace(BEAT, phase=Phase.CLIMBING)
        self.run(0.2)
        assert self.ask(command(400, 1.0)) is not None
        self.armed = True
        assert self.set_mode(self.ours.offboard) is not None
        self.run(1.0)
        self.beat = BEAT
        self.run(0.5)
        assert self.gate.airborne
        assert self.stage() is Stage.PASS, self.notices

    def faults(self) -> Counter[str]:
        """What the gate has said of faults: the first word of each notice."""
        return Counter(notice.split()[0].strip(":") for notice in self.notices)

    def stops(self) -> list[float]:
        """When the gate itself asked for a standstill."""
        return [t_s for t_s, name, _ in self.sent if name == SETPOINT]

    def modes(self) -> list[float]:
        """The modes that the gate asked for, by the parameter that tells them."""
        return [fields["param2"] for _, name, fields in self.sent if name == "COMMAND_LONG"]

    def _tell_position(self) -> None:
        self.position = self.position | {
            "x": self.position["x"] + 0.02 * self.position["vx"] + 1e-5 * (self._ticks % 7)
        }
        stamp_ms = round(self.now_s * 1e3)
        self.gate.on_autopilot_message(told("LOCAL_POSITION_NED", time_boot_ms=stamp_ms, **self.position), self.now_s)
        self.gate.on_autopilot_message(told("ATTITUDE", time_boot_ms=stamp_ms), self.now_s)

    def _steer(self) -> None:
        raw = self.ask(setpoint(*self.wanted))
        if raw is not None:
            self.passed.append((self.now_s, read(raw)[1]))

    def _obey(self, raw: bytes) -> None:
        found, fields = read(raw)
        name = {0: "HEARTBEAT", 76: "COMMAND_LONG", 77: "COMMAND_ACK", 84: SETPOINT, 253: "STATUSTEXT"}[
            found.message_id
        ]
        assert (found.system_id, found.component_id) == (SYSTEM, GATE)
        self.sent.append((self.now_s, name, fields))
        if name == "COMMAND_LONG" and self.obeys:
            wanted = fields["param2"], fields["param3"]
            for mode in (self.ours.hold, self.ours.land):
                if self.ours.set_mode_parameters(mode)[1:] == wanted:
                    self.mode = mode


KINDS = [AutopilotKind.PX4, AutopilotKind.ARDUPILOT]


def in_the_air(plan: Plan = PLAN, kind: AutopilotKind = AutopilotKind.PX4) -> Air:
    """A vehicle that explores at 0.1 m/s, and nothing is wrong."""
    air = Air(plan, kind)
    air.take_off()
    air.wanted = (0.1, 0.0, 0.0, 0.2)
    air.run(1.0)
    air.sent.clear()
    air.passed.clear()
    return air


def reacting(fault: Fault, first: Stage, hold_s: float | None, land_s: float | None) -> Plan:
    """A plan with another answer to one fault."""
    return replace(PLAN, reactions=PLAN.reactions | {fault: Reaction(first, hold_s, land_s)})
