"""When a mission is done: the one rule, in flight and in simulation. Pure.

In flight there is no truth. A mission is done when nothing is left that the vehicle knows of and can get to, and that
for a while. Two witnesses say so, each from what it alone knows: the known ground and the map. Who knows nothing is not
asked: the ground while ways are not searched (``choice: coin``) or more is known than can be searched, the map while
its process is dead. Where nobody knows, nothing is ever done.

The navigation graph will be the third: whether it has an exit that was seen and not taken. Until then an untaken exit
is one of the ground's: what lies behind it is unseen, and a way leads to it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

SUSTAINED_S = 30.0
"""Nothing has to be left for so long. Meanwhile the vehicle flies on, and sees the walls about it from elsewhere: looks
of one second find a chink in the scan and lose it again."""

ALONE_S = 120.0
"""So long where the ground has to say it without the map: a place without a way out of it may be a wall taken for one,
and the law finds out of it by following walls."""

SETTLED_S = 180.0
"""What is still open may be what the camera cannot see, water or glass or a shaft, or a pocket that no wall leads into.
When flying so long brought nothing new, the mission is done with it, or it would never end."""

NEWS_SHARE = 0.002
"""So much more floor and roof than before is something new."""

ENOUGH_SEEN = 0.97
"""Share of floor and roof that has to be seen. Not all: no reachable place looks into every niche and shadow."""

SETTLED_SEEN = 0.85
"""So much of it has to be seen even when nothing new comes."""


class MapWord(NamedTuple):
    """What the map says.

    Attributes:
        frontier_m: length of the longest frontier that can be got to or looked into; 0 where there is none.
        seen_share: share of floor and roof over what is free that was seen.
        surfaces_seen: cells of floor and roof that were seen.
        has_room: more is free than the room to turn in: who has not even seen that has seen nothing.
    """

    frontier_m: float
    seen_share: float
    surfaces_seen: int
    has_room: bool


class Completion:
    """Says when the mission is done, from one look after the other.

    Args:
        fits_m: a frontier of the map that is shorter is no opening, since the vehicle does not fit through: 2 d_c.
    """

    def __init__(self, fits_m: float) -> None:
        self.done_at_s: float | None = None
        """When the mission was done; None while it is not."""
        self._fits_m = fits_m
        self._none_left_since_s: float | None = None
        self._most_seen = 0
        self._news_s = -math.inf

    def update(self, t_s: float, ground: bool | None, word: MapWord | None) -> bool:
        """Whether the mission is done. It may say no again later: a new opening is news.

        Args:
            t_s: now.
            ground: whether the known ground has a way to something unseen (`remaining.is_way_left`); None: not known.
            word: of the map; None where it has none.
        """
        if word is not None and word.surfaces_seen > self._most_seen * (1.0 + NEWS_SHARE):
            self._most_seen, self._news_s = word.surfaces_seen, t_s
        if ground or (ground is None and word is None) or (word is not None and self._is_left(ground, word)):
            self._none_left_since_s = None
        elif self._none_left_since_s is None:
            self._none_left_since_s = t_s
        since_s = self._none_left_since_s
        sustained = since_s is not None and t_s - since_s >= (ALONE_S if word is None else SUSTAINED_S)
        is_done = sustained or (not ground and word is not None and self._is_settled(t_s, ground, word))
        if not is_done:
            self.done_at_s = None
        elif self.done_at_s is None:
            self.done_at_s = t_s
        return is_done

    def _is_left(self, ground: bool | None, word: MapWord) -> bool:
        """Whether the map knows of more. Alone it counts every frontier; beside the ground only what has room."""
        open_m = 0.0 if ground is None else self._fits_m
        is_open = word.frontier_m > 0.0 and word.frontier_m >= open_m
        return is_open or word.seen_share < ENOUGH_SEEN or not word.has_room

    def _is_settled(self, t_s: float, ground: bool | None, word: MapWord) -> bool:
        """Whether nothing new has come for long; alone the map must know of no opening for that."""
        no_opening = ground is False or word.frontier_m < self._fits_m
        return t_s - self._news_s >= SETTLED_S and word.seen_share >= SETTLED_SEEN and no_opening and word.has_room
