"""The way home over what was flown: there is one, however badly the ground was seen from afar."""

from __future__ import annotations

import numpy as np
import pytest

from companion.control.homing.homeward import Homeward
from companion.control.known_ground import Place
from tests.control.scene import law_parameters
from tests.control.test_informed import known


@pytest.mark.parametrize("slope", [-0.27, 0.27])
def test_a_steep_ramp_that_was_seen_as_level_ground_leads_back(slope: float) -> None:
    """Protects from "way home closed" 44 m from home: seen from its top, the ramp was up to 1.8 m too high in the grid.

    Where that is more than what makes two levels, the way ended from one cell to the next, though it had been flown.
    """
    ground = known()
    places = [Place(2.25 + far_m, 2.25, slope * far_m) for far_m in np.arange(0.0, 14.0, 0.25).tolist()]
    for place in places:
        ground.fly(place)
    home = Homeward(law_parameters(), ground, places[0])
    for place in places[4:]:
        cost_m = home.cost_m(place, 0.0)
        assert cost_m is not None
        assert cost_m == pytest.approx(place.x_m - 2.25, abs=1.0)
