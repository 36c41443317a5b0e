"""Plans in which a law may lose itself: one pillar, two edges alike, a pocket as narrow as the vehicle needs."""

from __future__ import annotations

import math

from sitl.mines.hazards.building import box, main_and_branch, mine, rough, together
from sitl.mines.model import World
from sitl.mines.plan import round_drift, square_drift


def pillar() -> World:
    """A hall with one pillar, which can be flown round for ever, and a drift that leaves it."""
    hall = square_drift(2.0, 0.0, 9.0, 0.0, width_m=11.0)
    away = round_drift(9.0, 0.0, 28.0, 4.0, width_m=4.0)
    shell = rough([hall, away], y_edges_m=())
    stands = box((5.5, -1.2, -0.5), (8.0, 1.2, 3.5))
    return mine("pillar", "a hall of 18 x 11 m with one pillar in it, and one drift away", together(shell, [stands]))


def mirrored_edges() -> World:
    """A smooth fork, its two ways mirror images of one another: nothing tells one edge from the other."""
    reach_m, turn_rad = 14.0, math.radians(50.0)
    x_m, y_m = 14.0 + reach_m * math.cos(turn_rad), reach_m * math.sin(turn_rad)
    drifts = [
        round_drift(0.0, 0.0, 14.0, 0.0, width_m=4.0),
        round_drift(14.0, 0.0, x_m, y_m, width_m=4.0),
        round_drift(14.0, 0.0, x_m, -y_m, width_m=4.0),
    ]
    return mine("mirrored-edges", "a fork with a way at 50 degrees to either side, alike", rough(drifts, roughness_m=0))


def pocket() -> World:
    """Two dead ends off a drift, hardly wider than 2 d_s = 2 m: one that it fits into, one that it does not."""
    drifts = [
        *main_and_branch(),
        round_drift(9.0, 0.0, 9.0, 9.0, width_m=2.4),
        round_drift(13.0, 0.0, 13.0, -9.0, width_m=2.05),
    ]
    return mine("pocket", "a drift with dead ends 2.4 m and 2.05 m wide", rough(drifts, roughness_m=0.05))
