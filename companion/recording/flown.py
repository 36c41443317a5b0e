"""The settings that a flight was flown with, out of its recording."""

from __future__ import annotations

import tempfile
from pathlib import Path

from companion.config.load import load_settings
from companion.config.settings import Settings
from companion.errors import InputError
from companion.recording.read import Recording


def flown_settings(recording: Recording) -> Settings:
    """The settings of the flight, through the same loader as any other file.

    Raises:
        InputError: this version refuses them.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "settings.yaml"
        file.write_text(recording.info.settings_yaml, encoding="utf-8")
        try:
            return load_settings(file)
        except InputError as error:
            reasons = str(error).replace(str(file), "its settings")
            raise InputError(f"{recording.path}: flown with settings that this version refuses:\n{reasons}") from None
