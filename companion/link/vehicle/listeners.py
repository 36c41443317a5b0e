"""Who at the ground was heard, and whether they have the whole map. Pure."""

from __future__ import annotations

import math

MOST = 64
"""Of more than these, those that were not heard for longest are forgotten."""

GONE_S = 10.0
"""Whoever was not heard for this long is not waited for."""


class Listeners:
    """Those at the ground."""

    def __init__(self) -> None:
        self._heard_s: dict[str, float] = {}
        self._have_all: dict[str, bool] = {}
        """Of those who follow the map."""

    def heard(self, who: str, now_s: float, has_all: bool | None = None) -> None:
        """One was heard; whether it has the whole map, if that is known."""
        self._heard_s.pop(who, None)
        self._heard_s[who] = now_s
        if has_all is not None:
            self._have_all[who] = has_all
        while len(self._heard_s) > MOST:
            oldest = next(iter(self._heard_s))
            del self._heard_s[oldest]
            self._have_all.pop(oldest, None)

    def there_is_more(self) -> None:
        """The map has changed: nobody is known to have all of it."""
        self._have_all = dict.fromkeys(self._have_all, False)

    def silent_s(self, now_s: float) -> float:
        """Since anybody was heard; infinite before."""
        return now_s - max(self._heard_s.values(), default=-math.inf)

    def recent(self, now_s: float) -> list[str]:
        """Who is still there, the newest first."""
        return [who for who, heard_s in reversed(self._heard_s.items()) if now_s - heard_s <= GONE_S]

    def have_all(self, now_s: float) -> bool:
        """Whether everybody who follows the map, and is still there, has all of it."""
        return all(has_all or now_s - self._heard_s[who] > GONE_S for who, has_all in self._have_all.items())
