"""What came of a fault: what went over the wire, and where the vehicle truly was."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from companion.config.settings import Settings
from companion.gate.faults import Fault
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd, MavComponent
from companion.mavlink.modes import personality
from tests.integration.rig import PILOTS_MODE
from tests.integration.seen import CommandSeen, SetpointSeen, TextSeen
from tests.integration.witness import Witness
from validation.fault_matrix.injection import Final, Injection
from validation.fault_matrix.scene import Flight
from validation.fault_matrix.true_way import STANDING_FOR_S, STANDING_MPS, Truth, contacts, standing_s

AIM_S = 0.15
"""From fault to brake, beyond the configured limit."""
MOST_S = 0.5
"""Above this the flight has failed, whatever else it did."""
ZERO_MPS = 0.02
SETTLED_S = 0.3
"""A zero after which the vehicle is commanded to move again within this time was no stop."""
NEWEST_S = 1.0
BRAKES = "gate: brake: "
"""Before the reason, in the gate's texts to the pilot."""
_KINDS = {"px4": AutopilotKind.PX4, "ardupilot": AutopilotKind.ARDUPILOT}


@dataclass(frozen=True, slots=True)
class Outcome:
    """One flight of the matrix.

    Attributes:
        name: of the fault.
        group: of the fault.
        personality: px4 or ardupilot.
        speed_mps: at which it flew when the fault came.
        wall_m: true distance to the wall then.
        brake_s: from the fault to the first braking setpoint on the wire, or command to hold or land, less what the
            configuration says must pass; None: there was none.
        travelled_m: how far it truly went on towards the wall.
        least_m: least true distance to any wall from then on, from the middle of the body.
        contacts: with anything.
        final: how it stood in the end.
        gate: what the gate reported to the pilot, oldest first.
        problem: what was not as it must be, in words; None: nothing.
        attempts: flights that it took to come as far as the fault, on a computer that did not stand still.
        stood_still_s: the longest time for which the gate, the autopilot or the wires waited for a processor.
        standing_s: from the fault until it stood, in truth; None: it did not.
        mode: of the autopilot in the end.
        texts: what the autopilot told its pilot after the fault.
    """

    name: str
    group: str
    personality: str
    speed_mps: float
    wall_m: float
    brake_s: float | None
    travelled_m: float
    least_m: float
    contacts: int
    final: Final
    gate: tuple[str, ...]
    problem: str | None
    attempts: int = 1
    stood_still_s: float = 0.0
    standing_s: float | None = None
    mode: str = ""
    texts: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether everything was as it must be."""
        return self.problem is None


def judged(
    flight: Flight, injection: Injection, fault_s: float, end_s: float, verified: str | None, told: int = 0
) -> Outcome:
    """The outcome of a flight whose processes have ended.

    Args:
        flight: that is over.
        injection: its fault.
        fault_s: when it came, in s of `time.monotonic`.
        end_s: until when the flight is judged.
        verified: what the fault's own check found wrong.
        told: texts of the autopilot before the fault.
    """
    before, after = flight.truth.looks(until_s=fault_s), flight.truth.looks(fault_s, end_s)
    # Not the world's count: it goes on while the flight is being ended, and ends where the fault is the world's end.
    touched = contacts([*before, *after], flight.settings.vehicle.body_radius_m)
    seen = flight.relay.seen
    setpoints = [one for one in seen.setpoints(fault_s) if one.t_s <= end_s]
    commands = [one for one in seen.commands(fault_s) if one.t_s <= end_s]
    final = final_state(flight.personality, flight.witness, setpoints, commands, after, end_s)
    began_s = brake_begins_s(setpoints, stops(flight.personality, commands))
    brake_s = None if began_s is None else began_s - fault_s - injection.limit_s
    gate = tuple(text.text for text in seen.texts(fault_s) if _is_of_gate(text, end_s))
    least_m = min((look.d_m for look in after if look.d_m is not None), default=math.nan)
    at_wall = stopped_at_the_wall(final, gate, least_m, flight.settings)
    is_right = ended_right(injection, final, at_wall=at_wall)
    return Outcome(
        name=injection.name,
        group=injection.group,
        personality=flight.personality,
        speed_mps=before[-1].speed_mps,
        wall_m=before[-1].d_m or math.nan,
        brake_s=brake_s,
        travelled_m=max((look.x_m for look in after), default=math.nan) - before[-1].x_m,
        least_m=least_m,
        contacts=touched,
        final=final,
        gate=gate,
        problem=_problem(injection, brake_s, touched, final, verified, is_right=is_right),
        standing_s=standing_s(after, fault_s),
        mode=_mode(flight.witness, end_s),
        texts=tuple(flight.witness.texts[told:]),
    )


def _mode(witness: Witness, end_s: float) -> str:
    beats = [beat for beat in tuple(witness.beats) if beat.t_s <= end_s]
    return f"{beats[-1].mode}{'' if beats[-1].armed else ', disarmed'}" if beats else "not heard"


def _problem(
    injection: Injection, brake_s: float | None, touched: int, final: Final, verified: str | None, *, is_right: bool
) -> str | None:
    if touched:
        return f"{touched} contacts"
    if not is_right:
        return f"{final}, not {' or '.join(sorted(injection.expects))}"
    if injection.needs_stop and brake_s is not None and brake_s > MOST_S:
        return f"braked {brake_s:.2f} s too late"
    if injection.needs_stop and brake_s is None and final not in (Final.FAILSAFE, Final.PILOT):
        return "nothing on the wire stopped it"
    return verified


def ended_right(injection: Injection, final: Final, *, at_wall: bool) -> bool:
    """Whether a fault may end so; a flight that goes on after it may be `stopped_at_the_wall`."""
    return final in injection.expects or (at_wall and Final.FLEW_ON in injection.expects)


def stopped_at_the_wall(final: Final, gate: Sequence[str], least_m: float, settings: Settings) -> bool:
    """Whether the gate holds it for the wall and for nothing else: then it flew on, as far as the wall let it.

    Who flies at a dead end is stopped there by itself or, where a busy computer made it late, by the gate.

    Args:
        final: how it stands.
        gate: the gate's texts since the fault.
        least_m: least true distance to any wall since the fault, not that in the end: stopped, it drifts and makes
            room. A gate that brakes for a wall far away believed a lie.
        settings: of the flight.
    """
    reasons = {text.removeprefix(BRAKES) for text in gate if text.startswith(BRAKES)}
    near = least_m <= settings.control.critical_margin_m
    return final is Final.BRAKED and reasons == {Fault.DISTANCE} and near


def brake_begins_s(setpoints: Sequence[SetpointSeen], others_s: Sequence[float]) -> float | None:
    """When the stop began: the first zero velocity in the plane that was not taken back, or another way to stop.

    Args:
        setpoints: since the fault, oldest first.
        others_s: times of commands that stop as well.
    """
    moving_s = [one.t_s for one in setpoints if not _is_zero(one)]
    zeros_s = [
        one.t_s
        for one in setpoints
        if _is_zero(one) and not any(one.t_s < time_s <= one.t_s + SETTLED_S for time_s in moving_s)
    ]
    return min((*zeros_s[:1], *others_s[:1]), default=None)


def _is_of_gate(text: TextSeen, end_s: float) -> bool:
    return text.sender[1] == MavComponent.ONBOARD_COMPUTER2 and text.t_s <= end_s


def _is_zero(one: SetpointSeen) -> bool:
    return math.hypot(one.vx, one.vy) <= ZERO_MPS


def stops(autopilot: str, commands: Sequence[CommandSeen]) -> list[float]:
    """Times of the commands to hold or to land."""
    ours = personality(_KINDS[autopilot])
    asked = [ours.set_mode_parameters(mode) for mode in (ours.hold, ours.land)]
    return [
        one.t_s
        for one in commands
        if one.command == MavCmd.NAV_LAND or (one.command == MavCmd.DO_SET_MODE and one.params[:3] in asked)
    ]


def final_state(
    autopilot: str,
    witness: Witness,
    setpoints: Sequence[SetpointSeen],
    commands: Sequence[CommandSeen],
    looks: Sequence[Truth],
    end_s: float,
) -> Final:
    """How the vehicle stands at ``end_s``."""
    beat = [beat for beat in tuple(witness.beats) if beat.t_s <= end_s][-1]
    if not beat.armed or beat.mode == "land":
        return Final.LANDED
    newest = [look.speed_mps for look in looks if look.t_s > end_s - STANDING_FOR_S]
    if not newest or math.fsum(newest) / len(newest) > STANDING_MPS:
        return Final.FLYING
    if beat.mode == PILOTS_MODE[autopilot]:
        return Final.PILOT
    if beat.mode in ("hold", "brake"):
        return Final.HELD if stops(autopilot, [one for one in commands if one.passed]) else Final.FAILSAFE
    senders = {one.sender[1] for one in setpoints if one.passed and one.t_s > end_s - NEWEST_S}
    if not senders:
        return Final.FAILSAFE
    return Final.BRAKED if MavComponent.ONBOARD_COMPUTER2 in senders else Final.FLEW_ON
