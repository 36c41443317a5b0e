"""The settings file of an application that flies with us: the one place for what each personality needs in it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from companion.config.load import load, merge
from companion.config.settings import Settings
from companion.mavlink.firmware import ARDUCOPTER_BRAKE_MPS2

Sections = Mapping[str, Any]
"""Nested mappings, like those in a settings file."""

OF_PERSONALITY: Mapping[str, Sections] = {
    "px4": {},
    "ardupilot": {"control": {"governor": {"brake_mps2": ARDUCOPTER_BRAKE_MPS2}}},
}
"""What an autopilot needs that is not the default; without it pre-flight refuses to fly it."""


def write_settings(file: Path, preset: str, personality: str, *layers: Sections) -> Settings:
    """Write a settings file: what the personality needs, and over it the layers, the last one uppermost.

    Args:
        file: is made, or made anew.
        preset: below everything.
        personality: px4 or ardupilot.
        layers: what is set besides.

    Returns:
        What is in force with it.

    Raises:
        InputError: these settings cannot be used.
    """
    sections = dict(OF_PERSONALITY[personality])
    for layer in layers:
        sections = merge(sections, layer)
    # JSON is YAML.
    file.write_text(json.dumps({"preset": preset, **sections}, indent=2) + "\n", encoding="utf-8")
    return load(file).settings
