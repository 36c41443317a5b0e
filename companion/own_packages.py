"""Packages that lie in front of our own on the way that Python looks for them.

A shell prepared for ROS, conda or another project names its packages in PYTHONPATH, and Python looks there first: the
numpy of somebody else would be taken for the one that this program was installed with, and fail, or, worse, not fail.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Collection
from importlib.metadata import packages_distributions
from pathlib import Path

VARIABLE = "PYTHONPATH"
_EVERYBODYS = frozenset({"bench", "docs", "examples", "test", "tests", "validation"})
"""Names that packages leave lying about by mistake, and projects have for folders of their own."""
_OURS = frozenset({"companion", "sitl"})
"""Whoever sets PYTHONPATH to a copy of this program means that one."""


def leave_out_foreign() -> list[str]:
    """Take out of PYTHONPATH the folders that hold a package of the same name as one of ours, here and for children.

    Returns:
        For each of them, which it was and why, for the user.
    """
    named = [place for place in os.environ.get(VARIABLE, "").split(os.pathsep) if place]
    if not named:
        return []
    installed = {Path(sysconfig.get_path(kind)).resolve() for kind in ("purelib", "platlib")}
    ours = packages_distributions().keys() - _EVERYBODYS - _OURS
    said, kept = [], []
    for place in named:
        found = [] if Path(place).resolve() in installed else _packages(Path(place), ours)
        if not found:
            kept.append(place)
            continue
        many = "" if len(found) == 1 else f" and {len(found) - 1} more"
        said.append(
            f"{VARIABLE}: {place} is left out: it holds another {found[0]}{many} than this program was installed with "
            f"(unset {VARIABLE} to be rid of this line)"
        )
        sys.path[:] = [entry for entry in sys.path if entry != str(Path(place).absolute()) and entry != place]
    os.environ[VARIABLE] = os.pathsep.join(kept)
    return said


def _packages(folder: Path, wanted: Collection[str]) -> list[str]:
    """Which of these can be imported from a folder."""
    try:
        names = {entry.name.partition(".")[0] for entry in folder.iterdir() if _is_importable(entry)}
    except OSError:
        return []
    return sorted(names & set(wanted))


def _is_importable(entry: Path) -> bool:
    return entry.suffix in (".py", ".so") or (entry.is_dir() and any(entry.glob("__init__.*")))
