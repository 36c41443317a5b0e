"""ArduCopter's own mission that hands the vehicle over in the air: its item NAV_GUIDED_ENABLE (92).

The autopilot tells which item it flies, and answers what is in it. It flies on in its mission's mode meanwhile, and
hovers: so it is asked for guided, from where on it is flown like any other.
"""

from __future__ import annotations

import contextlib
import math

from companion.autopilot.interface import Link, LinkError, Message
from companion.autopilot.vehicle_state import VehicleState, integer, number
from companion.mavlink.ids import MavCmd, MavComponent
from companion.mavlink.modes import mode_name, personality

CURRENT_HZ = 2.0
"""Of MISSION_CURRENT: so soon after it has come to the item the vehicle is taken."""
STALE_S = 2.0
ASK_S = 1.0
"""An item is asked for again when no answer has come."""


class Handover:
    """Follows the mission of the autopilot, as long as it is asked.

    Args:
        link: to an autopilot.
    """

    def __init__(self, link: Link) -> None:
        mission = personality(link.kind).mission
        self._mode = None if mission is None else mode_name(link.kind, mission)
        self._link = link
        self._current = link.watch("MISSION_CURRENT")
        self._asked_s = -math.inf
        self._item: tuple[int, bool] | None = None  # number of the newest that was told, and whether it hands over
        link.events("MISSION_ITEM_INT", self._on_item)

    def is_ours(self, state: VehicleState, now_s: float) -> bool:
        """Whether the vehicle is in the air, in its own mission, at an item that hands it over. Asks what is unknown.

        Args:
            state: of the vehicle.
            now_s: when.
        """
        if self._mode is None or state.mode != self._mode or not state.armed or state.landed is not False:
            self._item = None
            return False
        current = self._current.newest
        number_now = None if current is None or self._current.age_s(now_s) > STALE_S else integer(current, "seq")
        if number_now is None or not 0 <= number_now <= 65535:
            return False
        if self._item is None or self._item[0] != number_now:
            self._ask(number_now, now_s)
            return False
        return self._item[1]

    def _ask(self, item: int, now_s: float) -> None:
        if now_s - self._asked_s < ASK_S:
            return
        self._asked_s = now_s
        where = {"target_system": self._link.system_id, "target_component": MavComponent.AUTOPILOT1}
        with contextlib.suppress(LinkError):  # the vehicle hovers until it works
            self._link.send("MISSION_REQUEST_INT", {"seq": item, "mission_type": 0, **where})

    def _on_item(self, message: Message) -> None:
        item, kind = integer(message, "seq"), integer(message, "mission_type")
        if item is not None and kind in (0, None):
            enables = integer(message, "command") == MavCmd.NAV_GUIDED_ENABLE and number(message, "param1") > 0.0
            self._item = item, enables
