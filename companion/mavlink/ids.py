"""Numbers of MAVLink that have one meaning wherever they stand, and texts that come from it."""

from __future__ import annotations

AUTOPILOT_COMPONENT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
ONBOARD_COMPONENT = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: this application."""
GATE_COMPONENT = 192
"""MAV_COMP_ID_ONBOARD_COMPUTER2: the safety gate."""


def printable(text: str) -> str:
    """A text from the wire as it may be shown: nothing in it steers a terminal, or is no character at all."""
    return "".join(letter if letter.isprintable() else " " for letter in text).strip()
