"""The phases of a flight, and the one machine that says which of them it is. Pure.

    CHECKING -> WAITING -> TAKING_OFF -> EXPLORING -> HOMING -> LEAVING -> ENDED

The end has priority: once the vehicle is being left, nothing leads back to steering it, and no phase is entered twice.
A person may pause a flight that is steered; whatever turns it back or ends it ends the pause as well.
"""

from __future__ import annotations

import enum


class FlightPhase(enum.IntEnum):
    """What the application is doing, in the order in which it does it."""

    CHECKING = 0
    """On the ground: connecting, pre-flight checks."""
    WAITING = 1
    """On the ground: ready, a start is waited for."""
    TAKING_OFF = 2
    """Arming and climbing to the height."""
    EXPLORING = 3
    """The navigator steers: one setpoint a tick."""
    HOMING = 4
    """The navigator steers, back to where it took off."""
    LEAVING = 5
    """No setpoint any more: the autopilot was told to hold or land, or somebody else has the vehicle."""
    ENDED = 6
    """The vehicle is down, somebody else's, or flies by itself; the map is written."""

    @property
    def airborne(self) -> bool:
        """Whether the vehicle may be armed by us: from the order to take off on."""
        return self >= FlightPhase.TAKING_OFF

    @property
    def in_words(self) -> str:
        """For people: "taking off"."""
        return self.name.lower().replace("_", " ")

    @property
    def steered(self) -> bool:
        """Whether the navigator steers: one setpoint a tick."""
        return self in (FlightPhase.EXPLORING, FlightPhase.HOMING)


class PhaseEvent(enum.Enum):
    """What may lead to another phase."""

    READY = "ready"
    """The checks have passed, and a start is waited for."""
    STARTED = "started"
    """The order to take off."""
    ENGAGED = "engaged"
    """At height, and the autopilot follows our setpoints."""
    TURNED_BACK = "turned back"
    """The exploring is over, and home is where it flies now."""
    STOPPED = "stopped"
    """Take-off, exploring or the way home is over, for whatever reason."""
    LEFT = "left"
    """Nothing more is to be expected of us: the vehicle is down, somebody else's, or flies by itself."""


_TRANSITIONS = {
    PhaseEvent.READY: ((FlightPhase.CHECKING,), FlightPhase.WAITING),
    PhaseEvent.STARTED: ((FlightPhase.CHECKING, FlightPhase.WAITING), FlightPhase.TAKING_OFF),
    PhaseEvent.ENGAGED: ((FlightPhase.TAKING_OFF,), FlightPhase.EXPLORING),
    PhaseEvent.TURNED_BACK: ((FlightPhase.EXPLORING,), FlightPhase.HOMING),
    PhaseEvent.STOPPED: (
        (FlightPhase.TAKING_OFF, FlightPhase.EXPLORING, FlightPhase.HOMING),
        FlightPhase.LEAVING,
    ),
    PhaseEvent.LEFT: (
        (FlightPhase.TAKING_OFF, FlightPhase.EXPLORING, FlightPhase.HOMING, FlightPhase.LEAVING),
        FlightPhase.ENDED,
    ),
}


class PhaseMachine:
    """Owns the phase of one flight; everybody else reads it.

    Attributes:
        phase: the phase now.
        paused: whether a person lets a steered flight wait.
    """

    def __init__(self) -> None:
        self.phase = FlightPhase.CHECKING
        self.paused = False

    def update(self, event: PhaseEvent) -> FlightPhase:
        """The phase after an event. One that means nothing in this phase changes nothing."""
        before, after = _TRANSITIONS[event]
        if self.phase in before:
            self.phase, self.paused = after, False
        return self.phase

    def pause(self, paused: bool) -> bool:
        """Let it wait, or go on; whether the flight is one that can be paused now."""
        if self.phase.steered:
            self.paused = paused
        return self.phase.steered
