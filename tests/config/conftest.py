"""Settings files that tests write, and what is said about those that cannot be used."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from companion.config.load import load_settings
from companion.errors import InputError

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a settings file and gives its path."""

    def write_file(text: str) -> Path:
        file = tmp_path / "vehicle.yaml"
        file.write_text(text, encoding="utf-8")
        return file

    return write_file


def refusal(file: Path | None, preset: str | None = None) -> list[str]:
    """The lines of the refusal, with the folder of the file cut off."""
    with pytest.raises(InputError) as caught:
        load_settings(file, preset)
    folder = "" if file is None else f"{file.parent}/"
    return str(caught.value).replace(folder, "").splitlines()
