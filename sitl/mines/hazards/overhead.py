"""What is in the way at flying height and not on the floor, and a roof that no camera sees."""

from __future__ import annotations

import numpy as np

from sitl.mines.hazards.building import HEIGHT_M, Body, beam, box, main_and_branch, mine, rough, together
from sitl.mines.model import World
from sitl.mines.plan import Array, square_drift


def low_beam() -> World:
    """A beam across the drift at the height of the body: 1.35 m of air below it, 1.35 m above."""
    across = beam((11.0, -3.0, 1.5), (11.0, 3.0, 1.5), 0.3)
    return mine("beam", "a beam 0.3 m thick across the drift, 1.5 m above the floor", together(_shell(), [across]))


def cable() -> World:
    """Cables 3 cm thick that hang from the roof to knee height."""
    hanging = [beam((x, y, 0.6), (x, y, HEIGHT_M + 0.5), 0.03) for x, y in ((9.0, -0.5), (11.0, 0.7), (13.0, 0.0))]
    return mine("cable", "three cables of 3 cm that hang in the drift", together(_shell(), hanging))


def net() -> World:
    """A piece of roof mesh that hangs down over a third of the drift: wires of 4 mm, 10 cm apart."""
    x_m, south_m, north_m, low_m, high_m = 11.0, -2.6, -0.3, 0.8, HEIGHT_M + 0.3
    wires: list[Body] = [
        beam((x_m, y, low_m), (x_m, y, high_m), 0.004) for y in np.arange(south_m, north_m + 0.01, 0.1)
    ]
    wires += [beam((x_m, south_m, z), (x_m, north_m, z), 0.004) for z in np.arange(low_m, high_m, 0.1)]
    return mine("net", "wire mesh over a third of the drift, wires of 4 mm 10 cm apart", together(_shell(), wires))


def overhang() -> World:
    """Rock that stands out from the wall by 1.4 m, from 1.1 m above the floor on."""
    rock = box((9.0, 0.7, 1.1), (13.0, 3.0, HEIGHT_M + 0.5))
    return mine("overhang", "an overhang of 1.4 m, 1.1 m above the floor", together(_shell(), [rock]))


def high_roof() -> World:
    """A hall of 9 m and its roof 12 m above the floor: no image shows it, no beam reaches it."""

    def height_m(x_m: Array, y_m: Array) -> Array:
        return np.where((np.abs(x_m - 11.5) < 4.5) & (np.abs(y_m) < 4.5), 12.0, HEIGHT_M)

    hall = square_drift(11.4, 0.0, 11.6, 0.0, width_m=9.0)
    shell = rough([*main_and_branch(), hall], height_m=height_m, x_edges_m=(7.0, 16.0), y_edges_m=(-4.5, 4.5))
    return mine("high-roof", "a drift through a hall 12 m high", shell)


def _shell() -> Body:
    return together(rough(main_and_branch()), [])
