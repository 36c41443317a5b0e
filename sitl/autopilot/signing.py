"""The autopilot's side of MAVLink signing, by pymavlink: not the implementation of the vehicle's computer."""

from __future__ import annotations

import time
from typing import Any

from sitl.autopilot.mavlink import dialect

_EPOCH_S = 1_420_070_400
_TICKS_PER_S = 100_000


class Signing:
    """One key for all that is said and heard: everything is signed, and nothing unsigned or wrongly signed is heard.

    Args:
        key: of 32 bytes.
    """

    def __init__(self, key: bytes) -> None:
        # Shared by all parsers: it holds the newest stamp of each sender.
        self._state = dialect.MAVLinkSigning()
        self._state.secret_key = key
        self._state.sign_outgoing = True

    def advance(self) -> None:
        """Our stamps follow the clock, and whoever is ahead of it."""
        ticks = int((time.time() - _EPOCH_S) * _TICKS_PER_S)
        self._state.timestamp = max(self._state.timestamp, ticks)

    def attach(self, mavlink: Any) -> None:
        """Makes an encoder or parser of pymavlink use the key."""
        mavlink.signing = self._state
        check, stamps = mavlink.check_signature, self._state.stream_timestamps

        def checked(raw: bytearray, system_id: int, component_id: int) -> bool:
            # pymavlink believes the stamp before it looks at the signature: anybody could make a sender unheard.
            sender = (raw[-13], system_id, component_id)
            before = stamps.get(sender)
            good = bool(check(raw, system_id, component_id))
            if not good:
                stamps.pop(sender, None)
                if before is not None:
                    stamps[sender] = before
            return good

        mavlink.check_signature = checked
