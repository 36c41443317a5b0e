"""The limit of bandwidth: a bucket that fills with what may be sent."""

from __future__ import annotations

BURST_S = 0.25
"""What was not sent for this long may be sent at once."""

OVERHEAD_BYTES = 120
"""What the network adds to each message: about the headers of IP, TCP, TLS and Zenoh."""


class Bandwidth:
    """What may be sent now.

    Args:
        limit_kbps: in kbit/s.
        now_s: the time.
    """

    def __init__(self, limit_kbps: float, now_s: float) -> None:
        self.bytes_per_s = 1000.0 * limit_kbps / 8.0
        self._free = self._most = self.bytes_per_s * BURST_S
        self._at_s = now_s

    def take(self, size_bytes: int, now_s: float) -> float:
        """Something of this size goes out, whatever is free; how long whoever can wait should wait before, in s."""
        self._free = min(self._most, self._free + (now_s - self._at_s) * self.bytes_per_s)
        self._at_s = now_s
        self._free -= size_bytes + OVERHEAD_BYTES
        return max(0.0, -self._free / self.bytes_per_s)
