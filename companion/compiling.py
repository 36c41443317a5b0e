"""Where compiled functions are kept from one start to the next, and what is said while they are compiled.

A package on a file system that may not be written, for a user without a home, would be compiled at each start: a minute
and a half without a word. So there are more places than numba knows, and whoever waits is told for what.
"""

from __future__ import annotations

import logging
import os
import shutil
import stat
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import event
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

PATIENCE_S = 2.0
"""What is compiled within this time is not worth a word."""
LINE_PERIOD_S = 10.0

_log = logging.getLogger(__name__)


class OwnPlaceLocator(InTreeCacheLocator):
    """Where a service manager gives us a place (``CacheDirectory=``), else a folder of ours in /var/tmp."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        super().__init__(function, file)  # type: ignore[no-untyped-call]
        subpath: str = self.get_suitable_cache_subpath(file)  # type: ignore[no-untyped-call]
        self._cache_path = str(own_place() / subpath)

    def ensure_cache_path(self) -> None:
        """Make the folder.

        Raises:
            OSError: it cannot be written, or is somebody else's, who could have us run what they like.
        """
        place = own_place()
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = place.lstat()
        if found.st_uid != os.getuid() or not stat.S_ISDIR(found.st_mode) or found.st_mode & 0o022:
            raise PermissionError(f"{place} can be written by others")
        super().ensure_cache_path()  # type: ignore[no-untyped-call]


def own_place() -> Path:
    """The folder of `OwnPlaceLocator`, which may not be there yet."""
    given = os.environ.get("CACHE_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else Path(f"/var/tmp/companion-{os.getuid()}")  # noqa: S108 - looked at before use


PLACES = (UserProvidedCacheLocator, InTreeCacheLocator, UserWideCacheLocator, OwnPlaceLocator)
"""numba's own locators, the first of them for NUMBA_CACHE_DIR, and ours."""


def find_place(function: Callable[..., Any], file: str) -> Any:
    """The first of `PLACES` that can be written; None when there is none."""
    for place in PLACES:
        found = place.from_function(function, file)  # type: ignore[no-untyped-call]
        if found is not None:
            return found
    return None


@cache
def bring(before: Path, folder: Path, module: str, stamp: str) -> None:
    """Begin with what was compiled beside the sources, which may lie where nothing can be written any more."""
    if before != folder:
        for path in before.glob(f"{module}.*.{stamp}.*nb[ci]"):
            part = folder / f"{path.name}.{os.getpid()}"
            if not (folder / path.name).exists():
                with suppress(OSError):
                    shutil.copyfile(path, part)
                    part.replace(folder / path.name)


class Patience(event.Listener):
    """Says what is waited for, when compiling takes long.

    Args:
        say: takes a line.
        now_s: the time.

    Attributes:
        kept_in: a folder in which what is compiled is kept; empty: it is not.
    """

    def __init__(self, say: Callable[[str], object], now_s: Callable[[], float] = time.monotonic) -> None:
        self.kept_in = ""
        self._say = say
        self._now_s = now_s
        self._depth = 0
        self._began_s = self._spent_s = 0.0
        self._next_s = PATIENCE_S

    def on_start(self, _event: event.Event) -> None:
        """A function is compiled, perhaps for another one that is being compiled."""
        if self._depth == 0:
            self._began_s = self._now_s()
        self._depth += 1
        self._look()

    def on_end(self, _event: event.Event) -> None:
        """It has been."""
        self._look()
        self._depth -= 1
        if self._depth == 0:
            self._spent_s += self._now_s() - self._began_s

    def _look(self) -> None:
        spent_s = self._spent_s + self._now_s() - self._began_s
        if spent_s < self._next_s:
            return
        self._next_s = spent_s + LINE_PERIOD_S
        kept = (
            f"kept for the next start in {self.kept_in}"
            if self.kept_in
            else "not kept for the next start: no folder for it may be written; set NUMBA_CACHE_DIR to one"
        )
        self._say(f"compiling the fast parts, {spent_s:.0f} s so far, in all a minute or two ({kept})")


patience = Patience(_log.warning)
event.register("numba:compile", patience)  # type: ignore[no-untyped-call]
