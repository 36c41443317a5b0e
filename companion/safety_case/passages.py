"""How narrow and how low a place may be that a configuration flies through. Pure.

Two numbers each, since to go on is easier than to go in. Into a place as wide and high as the first it flies by itself,
and keeps d_c there, but for a centimetre or two (three where d_s is only 0.1 m more). Where it is in one already, it
goes on down to the second. Between the two nothing is promised of what it finds its way into; below the second it
stands, turns and tries again.
"""

from __future__ import annotations

from dataclasses import dataclass

from companion.config.settings import Settings
from companion.control.edges import CORRIDOR_SHARE
from companion.control.governor import room_m

TURNS_IN_M = 0.11
"""Into a drift that is wider than twice what it keeps by so much on either side it turns by itself. Flown in
simulation, with d_s and d_c: 1 and 0.8 m into 1.92 m in 12 of 12 flights, 0.7 and 0.58 m into 1.46 m in 8 of 8, 0.56
and 0.46 m into 1.2 m in 12 of 12 within 600 s; but 0.66 and 0.58 m into 1.43 m in 7 of 8, up to 0.07 m inside d_c."""

TURNS_IN_BY_MARGIN_M = 0.15
"""As much more than d_s with ``law: paper``, which knows no narrow places: at the mouth it comes round the near corner
at d_s, and must not have come to the far one by then."""

CORRIDOR_M = 0.05
"""So much wider than the corridor of a tangent (`CORRIDOR_SHARE` of d_s to either side) must be what it leads into."""

SWAYS_M = 0.1
"""So far from the middle of a drift noise and disturbances carry it: with 0.05 m one of four flights stood there for
minutes, with 0.08 m one of ten."""

CLEARS_M = 0.1
"""So much more than the slab of heights that counts as obstacle must be free above and below: depth is noisy, and H is
held to some centimetres."""


@dataclass(frozen=True, slots=True)
class Passages:
    """What a configuration flies through.

    Attributes:
        enters_width_m: into a drift so wide and more it turns by itself.
        least_width_m: where it is in one, it goes on down to this width.
        enters_height_m: under the edge of a roof so high above the ground and more it flies straight on, at H.
        least_height_m: where the roof is so low, it goes on half-way between it and the ground.
    """

    enters_width_m: float
    least_width_m: float
    enters_height_m: float
    least_height_m: float

    def __str__(self) -> str:
        """For people, in one line."""
        return (
            f"flies into places {self.enters_width_m:.2f} m wide and {self.enters_height_m:.2f} m high, or more; once "
            f"inside it goes on down to {self.least_width_m:.2f} m and {self.least_height_m:.2f} m"
        )


def passages(settings: Settings) -> Passages:
    """The least width and height that a configuration flies through.

    In a drift the law stands as soon as anything beside or ahead is nearer than d_c (12); the governor keeps `room_m`
    more. In height the slab that counts as obstacle (`Settings.half_slab_m`) must be free: ahead at the height at which
    it flies, and under a low roof on either side of the middle, where law (6) then leads it.
    """
    control = settings.control
    keeps_m = control.critical_margin_m + (room_m(control) if control.speed_law == "governor" else 0.0)
    least_width_m = 2.0 * (keeps_m + SWAYS_M)
    if control.law == "paper":
        half_mouth_m = control.margin_m + TURNS_IN_BY_MARGIN_M
    else:
        half_mouth_m = max(keeps_m + TURNS_IN_M, CORRIDOR_SHARE * control.margin_m + CORRIDOR_M)
    return Passages(
        enters_width_m=round(max(2.0 * half_mouth_m, least_width_m), 3),
        least_width_m=round(least_width_m, 3),
        enters_height_m=round(control.height_m + settings.half_slab_m + CLEARS_M, 3),
        least_height_m=round(2.0 * (settings.half_slab_m + CLEARS_M), 3),
    )
