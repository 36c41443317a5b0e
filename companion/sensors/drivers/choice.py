"""Several rangefinders that look the same way: which of them is believed, and whether they contradict each other.

Two that see different things would make the height jump with every other message. So one is believed: the one that the
settings name, else the first that has measured something.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from companion.model import Beam

BOTH_S = 0.5
"""Readings of two sensors that are further apart than this are not compared."""
SUSTAINED_S = 2.0
"""A contradiction that lasts for so long is no edge that one of them passes before the other."""
AGAIN_S = 30.0
NOISE_M, NOISE_SHARE = 0.3, 0.1
"""Two sensors that differ by less than the sum may be mounted apart, and noisy: good ones err by centimetres."""
MOST_SENDERS = 16
"""Compared, for each direction."""

Sender = tuple[int, int]
"""The MAVLink component that a reading comes from, and the number of the sensor there."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """The sensor that is to be believed for a direction; None: any."""

    component: int | None
    number: int | None

    def fits(self, sender: Sender) -> bool:
        """Whether it is that one."""
        return self.component in (None, sender[0]) and self.number in (None, sender[1])


class Choice:
    """Believes one sensor for each direction.

    Args:
        wanted: by direction, those that the settings name.
    """

    def __init__(self, wanted: Mapping[Beam, Wanted]) -> None:
        self._wanted = wanted
        self._believed: dict[Beam, Sender] = {}
        self._newest: dict[Beam, dict[Sender, tuple[float, float]]] = {}
        self._since_s: dict[tuple[Beam, Sender], float] = {}
        self._told_s: dict[Beam, float] = {}

    def against(self, beam: Beam, sender: Sender, *, measured: bool) -> str:
        """Why a reading does not count; empty: it does.

        Args:
            beam: its direction.
            sender: whose it is.
            measured: whether it has measured something.
        """
        if not self._wanted.get(beam, Wanted(None, None)).fits(sender):
            return f"from {_name(sender)}, and not from the one that sensors.mavlink names"
        if measured:
            self._believed.setdefault(beam, sender)
        believed = self._believed.get(beam, sender)
        if believed == sender:
            return ""
        return f"from {_name(sender)}; {_name(believed)} looks the same way, measured first, and is believed"

    def contradiction(self, beam: Beam, sender: Sender, range_m: float, t_s: float) -> str:
        """What there is to tell of a measured range: that it has differed from another's for long; empty: nothing.

        Args:
            beam: its direction.
            sender: whose it is.
            range_m: what it has measured.
            t_s: when.
        """
        newest = self._newest.setdefault(beam, {})
        if sender not in newest and len(newest) >= MOST_SENDERS:
            return ""
        newest[sender] = (range_m, t_s)
        believed = self._believed.get(beam)
        if believed is None or believed == sender:
            return ""
        believed_m, then_s = newest.get(believed, (math.nan, -math.inf))
        # Where the two cannot be compared nothing is known of them: it begins anew.
        differ = abs(range_m - believed_m) > NOISE_M + NOISE_SHARE * min(range_m, believed_m)
        if t_s - then_s > BOTH_S or not differ:
            self._since_s.pop((beam, sender), None)
            return ""
        since_s = self._since_s.setdefault((beam, sender), t_s)
        if t_s - since_s < SUSTAINED_S or t_s - self._told_s.get(beam, -math.inf) < AGAIN_S:
            return ""
        self._told_s[beam] = t_s
        return (
            f"rangefinders {beam}: {_short(believed)} {believed_m:.2f} m, {_short(sender)} {range_m:.2f} m "
            f"contradict each other; {_name(believed)} is believed (sensors.mavlink chooses another)"
        )


def _short(sender: Sender) -> str:
    return f"{sender[0]}/{sender[1]}"


def _name(sender: Sender) -> str:
    return f"component {sender[0]}, id {sender[1]}"
