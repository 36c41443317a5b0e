"""Which message is due when: intervals, as SET_MESSAGE_INTERVAL changes them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

TOLERANCE_S = 5e-7
"""Times are sums of periods."""


class Streams:
    """Intervals of messages, on a grid of their own, without catching up on missed ones.

    Args:
        rates_hz: by name, what comes unasked.
        t_s: now.
    """

    def __init__(self, rates_hz: Mapping[str, float], t_s: float) -> None:
        self._default_s = {name: 1.0 / rate for name, rate in rates_hz.items()}
        self._interval_s = dict(self._default_s)
        self._next_s = dict.fromkeys(rates_hz, t_s)

    def interval_us(self, name: str) -> int:
        """As MESSAGE_INTERVAL tells it: -1 when the message does not come."""
        interval_s = self._interval_s.get(name)
        return -1 if interval_s is None else round(interval_s * 1e6)

    def set_interval_us(self, name: str, interval_us: float, t_s: float) -> None:
        """As SET_MESSAGE_INTERVAL asks: 0 is the default, below 0 is off."""
        interval_s = self._default_s.get(name) if interval_us == 0.0 else interval_us * 1e-6
        if interval_s is None or interval_s < 0.0:
            self._interval_s.pop(name, None)
            self._next_s.pop(name, None)
        else:
            self._interval_s[name] = interval_s
            self._next_s[name] = t_s

    def due(self, t_s: float) -> Iterator[str]:
        """Names of the messages to send now."""
        for name, next_s in self._next_s.items():
            if t_s >= next_s - TOLERANCE_S:
                interval_s = self._interval_s[name]
                self._next_s[name] = max(next_s + interval_s, t_s - interval_s)
                yield name
