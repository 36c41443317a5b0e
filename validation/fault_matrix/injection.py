"""What a fault of the matrix is: how it is injected, and what may come of it."""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the scene knows what an injection asks of it
    from validation.fault_matrix.scene import Flight

PERSONALITIES = ("px4", "ardupilot")
TRIGGER_M = 1.45
"""At this distance from the wall the fault comes: the vehicle still flies at full speed, and would brake by itself at
1.29 m from 0.5 m/s."""


class Final(enum.StrEnum):
    """How a flight stands some seconds after the fault."""

    BRAKED = "braked"
    """In the air, standing, while the gate streams zero velocity."""
    HELD = "held"
    """Commanded to hold, and standing."""
    LANDED = "landed"
    """On the ground or on the way there."""
    FLEW_ON = "flew on"
    """The application's own setpoints pass: it goes on, or has stopped before the wall; the wall is all that the gate
    may have stopped it for."""
    FAILSAFE = "autopilot failsafe"
    """Nothing commands it any more, and the autopilot stopped it."""
    PILOT = "pilot"
    """A person has it."""
    FLYING = "still moving"
    """None of these: never expected."""


@dataclass(frozen=True, slots=True)
class Injection:
    """One fault.

    Attributes:
        name: as it is asked for on the command line.
        group: under which it stands in the table.
        what: what is done, in a line, for the table.
        inject: does it; called at the worst moment, in the harness's own process.
        expects: the final states that are right.
        before: what is done before the take-off.
        exploring: what is done when the flight towards the wall begins.
        undo: takes it away again after the flight was judged, where processes could not end otherwise.
        limit_s: the configured time that must pass before the fault can be told from nothing; the time to brake is
            counted from its end.
        needs_stop: False: nothing has to stop, the flight may go on.
        careless: the application ignores distances and never stops by itself.
        trigger_m: how far from the wall it comes.
        watch_s: how long after the fault the flight is judged.
        settings: what is set besides, as nested mappings like those in a settings file.
        guarded: the odometry of a flight without GPS passes through the gate.
        verify: what else must be true at the end; gives what is not, in words, or None.
        personalities: with which it is flown.
    """

    name: str
    group: str
    what: str
    inject: Callable[[Flight], None]
    expects: frozenset[Final]
    before: Callable[[Flight], None] | None = None
    exploring: Callable[[Flight], None] | None = None
    undo: Callable[[Flight], None] | None = None
    limit_s: float = 0.0
    needs_stop: bool = True
    careless: bool = False
    trigger_m: float = TRIGGER_M
    watch_s: float = 6.0
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    guarded: bool = False
    verify: Callable[[Flight], str | None] | None = None
    personalities: tuple[str, ...] = PERSONALITIES
