"""PX4's flight modes: their numbers, what they do, and what it calls them."""

from __future__ import annotations

from sitl.autopilot.state import Behaviour, Mode

_NAMES = {
    "MANUAL": (1, 0, Behaviour.COAST),
    "ALTCTL": (2, 0, Behaviour.COAST),
    "POSCTL": (3, 0, Behaviour.HOLD),
    "AUTO.TAKEOFF": (4, 2, Behaviour.TAKEOFF),
    "AUTO.LOITER": (4, 3, Behaviour.HOLD),
    "AUTO.RTL": (4, 5, Behaviour.RETURN),
    "AUTO.LAND": (4, 6, Behaviour.LAND),
    "OFFBOARD": (6, 0, Behaviour.SETPOINTS),
}
_LANDING = (Behaviour.LAND, Behaviour.RETURN)
MODES = {
    name: Mode(name, main << 16 | sub << 24, behaviour, behaviour not in _LANDING)
    for name, (main, sub, behaviour) in _NAMES.items()
}
DESCEND = Mode("AUTO.LAND", MODES["AUTO.LAND"].custom_mode, Behaviour.DESCEND, armable=False)
"""Shown like a landing, but nothing holds the position."""
LABELS = {
    "MANUAL": ("Manual", 0), "ALTCTL": ("Altitude", 1), "POSCTL": ("Position", 2), "AUTO.LOITER": ("Hold", 4),
    "AUTO.RTL": ("Return", 5), "OFFBOARD": ("Offboard", 7), "AUTO.TAKEOFF": ("Takeoff", 10), "AUTO.LAND": ("Land", 11),
}  # fmt: skip
"""What a text and an event call a mode."""
STICKS = ("MANUAL", "ALTCTL", "POSCTL")
"""Flown by a person."""
