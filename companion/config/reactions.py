"""How the gate answers each fault: what it does at once, and what it does when the fault stays."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from companion.config.section import Section, refuse
from companion.gate.faults import Fault

First = Literal["tell", "brake", "hold", "land"]
Level = Literal["normal", "cautious"]
Answer = tuple[First, float | None, float | None]
"""What at once; then hold and land after so many seconds, None: never."""

ANSWERS: dict[Level, dict[Fault, Answer]] = {
    # Standing still costs nothing and most faults are over within a second or two: five before the autopilot's own
    # hold takes over, thirty before the ground under the vehicle is better than its battery.
    "normal": dict.fromkeys(Fault, ("brake", 5.0, 30.0))
    | {
        # Zero velocity means nothing to an autopilot that does not know its velocity.
        Fault.POSE_FROZEN: ("land", None, None),
        Fault.ESTIMATOR: ("land", None, None),
        Fault.BATTERY: ("land", None, None),
        # Standing by a position that is no longer measured is drifting: the sooner it is down, the nearer to here.
        Fault.AIDING_LOST: ("brake", 1.0, 2.0),
        Fault.GPS_LOST: ("brake", 1.0, 2.0),
        Fault.ODOMETRY_SILENT: ("brake", 1.0, 2.0),
        # Setpoints do not help. Hold is a mode that obeys none, and what was paused in guided stays in it.
        Fault.NOT_OBEYED: ("hold", None, 10.0),
        # It never comes back in this flight; the pilot gets fifteen seconds to choose where it lands.
        Fault.APPLICATION: ("brake", 2.0, 15.0),
        # What is ordered over a link that is dying should be ordered soon.
        Fault.HEARTBEAT_LOST: ("brake", 2.0, 10.0),
        Fault.LINK_LOST: ("brake", 2.0, 10.0),
        # A person ordered a stop, no landing, and is there to order more.
        Fault.GROUND_STOP: ("brake", 1.0, None),
        # Outside of the fence is where nobody wants it to land.
        Fault.FENCE: ("brake", 3.0, None),
        # Before a wall it may turn away by itself, which takes time.
        Fault.DISTANCE: ("brake", 20.0, 60.0),
        Fault.MAP: ("tell", None, None),
    },
    # The same first answers: braking at once is already the strictest that keeps the vehicle in the air. It gives up
    # on them sooner, and a flight without a map ends.
    "cautious": dict.fromkeys(Fault, ("brake", 2.0, 15.0))
    | {
        Fault.POSE_FROZEN: ("land", None, None),
        Fault.ESTIMATOR: ("land", None, None),
        Fault.BATTERY: ("land", None, None),
        Fault.AIDING_LOST: ("brake", 0.5, 1.0),
        Fault.GPS_LOST: ("brake", 0.5, 1.0),
        Fault.ODOMETRY_SILENT: ("brake", 0.5, 1.0),
        Fault.NOT_OBEYED: ("hold", None, 5.0),
        Fault.APPLICATION: ("brake", 1.0, 8.0),
        Fault.HEARTBEAT_LOST: ("brake", 1.0, 5.0),
        Fault.LINK_LOST: ("brake", 1.0, 5.0),
        Fault.GROUND_STOP: ("hold", None, None),
        Fault.FENCE: ("brake", 1.0, None),
        Fault.DISTANCE: ("brake", 10.0, 30.0),
        Fault.MAP: ("tell", None, 60.0),
    },
}

HARMLESS = frozenset({Fault.MAP, Fault.BATTERY})
"""Faults that the pilot may only be told of: the law still flies, and something else ends the flight in time (the
application without its map, the mission and the autopilot's own failsafe with a low battery)."""


class ReactionSettings(Section):
    """The answer to one fault. The delays count from when the fault began."""

    first: First = Field(
        "brake",
        description="at once: tell (the pilot only), brake (the gate streams zero velocity), hold (the autopilot stops "
        "and stays) or land",
    )
    hold_after_s: float | None = Field(
        None, gt=0.0, le=3600.0, description="the autopilot is told to hold after this long, in s; null: never"
    )
    land_after_s: float | None = Field(
        None, gt=0.0, le=3600.0, description="it is told to land after this long, in s; null: never"
    )

    def completed(self, answer: Answer) -> ReactionSettings:
        """With the level's answer where the file says nothing.

        Delays belong to their first answer: who only says ``first: land`` means no delays.
        """
        if "first" in self.model_fields_set and self.first != answer[0]:
            later: dict[First, Answer] = {"brake": ("brake", 5.0, 30.0), "hold": ("hold", None, 30.0)}
            answer = later.get(self.first, (self.first, None, None))
        filled = dict(zip(("first", "hold_after_s", "land_after_s"), answer, strict=True))
        return ReactionSettings(**(filled | {key: getattr(self, key) for key in self.model_fields_set}))

    def check(self, fault: Fault) -> None:
        """Refuse what cannot be meant."""
        key = f"safety.reactions.{fault}"
        if self.first in ("hold", "land") and self.hold_after_s is not None:
            raise refuse(
                f"{key}.hold_after_s = {self.hold_after_s:g} s cannot follow {key}.first: {self.first}: it holds or "
                "lands already; set it to null",
                f"{key}.hold_after_s",
                f"{key}.first",
            )
        if self.first == "land" and self.land_after_s is not None:
            raise refuse(
                f"{key}.land_after_s = {self.land_after_s:g} s cannot follow {key}.first: land: it lands already; set "
                "it to null",
                f"{key}.land_after_s",
                f"{key}.first",
            )
        if self.hold_after_s is not None and self.land_after_s is not None and self.land_after_s <= self.hold_after_s:
            raise refuse(
                f"{key}.land_after_s = {self.land_after_s:g} s must be greater than {key}.hold_after_s = "
                f"{self.hold_after_s:g} s: both count from the beginning of the fault",
                f"{key}.land_after_s",
                f"{key}.hold_after_s",
            )
        if self.first == "tell" and fault not in HARMLESS:
            raise refuse(
                f"{key}.first: tell leaves the vehicle flying although {fault} can bring it to a wall; choose brake, "
                "hold or land",
                f"{key}.first",
            )


def _answer(fault: Fault, what: str) -> Any:
    """The field of a fault, with the answer of the level normal."""
    return Field(ReactionSettings().completed(ANSWERS["normal"][fault]), description=what)


class ReactionsSettings(Section):
    """One answer for each fault, by the fault's name."""

    setpoint_late: ReactionSettings = _answer(Fault.SETPOINT_LATE, "no setpoint while the application explores")
    setpoint_bad: ReactionSettings = _answer(Fault.SETPOINT_BAD, "a setpoint broke a limit; it was replaced by a stop")
    beat_late: ReactionSettings = _answer(Fault.BEAT_LATE, "the application completes no tick: its process hangs")
    depth_stale: ReactionSettings = _answer(Fault.DEPTH_STALE, "no fresh look ahead")
    ranges_stale: ReactionSettings = _answer(Fault.RANGES_STALE, "a rangefinder is silent")
    pose_stale: ReactionSettings = _answer(
        Fault.POSE_STALE, "no fresh position of the autopilot, or none that is a number"
    )
    pose_jump: ReactionSettings = _answer(Fault.POSE_JUMP, "the position went where no velocity leads")
    pose_frozen: ReactionSettings = _answer(
        Fault.POSE_FROZEN, "positions repeat each other to the last bit: the estimator stands"
    )
    estimator: ReactionSettings = _answer(
        Fault.ESTIMATOR, "the autopilot says that it does not know its velocity or position"
    )
    aiding_lost: ReactionSettings = _answer(
        Fault.AIDING_LOST, "nothing tells the autopilot any more where it is, though it does not say so yet"
    )
    gps_lost: ReactionSettings = _answer(Fault.GPS_LOST, "it flies by GPS, and the position fix is gone")
    odometry_silent: ReactionSettings = _answer(
        Fault.ODOMETRY_SILENT, "the odometry that passes through the gate stopped, or repeats itself"
    )
    not_obeyed: ReactionSettings = _answer(Fault.NOT_OBEYED, "asked to stand it moves, or asked to move it stands")
    heartbeat_lost: ReactionSettings = _answer(
        Fault.HEARTBEAT_LOST, "no heartbeat of the autopilot: nobody knows its mode"
    )
    link_lost: ReactionSettings = _answer(Fault.LINK_LOST, "nothing at all from the autopilot")
    distance: ReactionSettings = _answer(
        Fault.DISTANCE, "it would stop nearer than the hard limit, and is still closing"
    )
    fence: ReactionSettings = _answer(Fault.FENCE, "outside of the fence")
    battery: ReactionSettings = _answer(Fault.BATTERY, "less than safety.battery_percent is left")
    ground_stop: ReactionSettings = _answer(
        Fault.GROUND_STOP, "a person at a ground station ordered a stop; never over by itself"
    )
    application: ReactionSettings = _answer(
        Fault.APPLICATION, "the application's process died; never over in this flight"
    )
    map: ReactionSettings = _answer(Fault.MAP, "the process of the map does not answer")
    flood: ReactionSettings = _answer(
        Fault.FLOOD, "the application sends more than it can mean; the surplus is dropped"
    )

    def by_fault(self) -> dict[Fault, ReactionSettings]:
        """For each fault its answer."""
        return {fault: getattr(self, fault.value) for fault in Fault}

    def completed(self, level: Level) -> ReactionsSettings:
        """With the level's answers where the file says nothing."""
        return self.model_copy(
            update={
                fault.value: (given if fault.value in self.model_fields_set else ReactionSettings()).completed(
                    ANSWERS[level][fault]
                )
                for fault, given in self.by_fault().items()
            }
        )
