"""Which software flies: two missions can be compared only where it was the same."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]


@cache
def software() -> str:
    """The version, and a stamp of all sources and presets as they were when this process first asked."""
    stamp = hashlib.sha256()
    for folder in ("companion", "sitl"):
        for file in sorted((_ROOT / folder).rglob("*")):
            if file.suffix in (".py", ".yaml"):
                stamp.update(f"{file.relative_to(_ROOT)}\n".encode())
                stamp.update(file.read_bytes())
    return f"{version('mine-companion')} {stamp.hexdigest()[:12]}"
