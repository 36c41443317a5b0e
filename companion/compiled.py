"""How functions are compiled: by numba, into a cache that is fresh as long as everything is that it was compiled from.

numba looks at one file only, that of the function. A function that it calls, and a number that it uses, become part of
the compiled code all the same, wherever they stand. So here the cache is stamped with the sources of the function's
module and of all modules of ours that this one imports, and those that they import: after a change of any of them
numba compiles anew, and nobody has to delete ``*.nbi`` files. The stamp is part of the files' names: what is stale is
not even read (it may name types that are no more) but removed.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Self, TypeVar

from numba import config, njit
from numba.core.dispatcher import Dispatcher

from companion.compiling import bring, find_place, patience

_ROOT = Path(__file__).resolve().parents[1]
_OURS = ("companion.", "sitl.", "bench.")
_IMPORT = re.compile(
    r"^(?:from|import) +((?:companion|sitl|bench)[.\w]*)(?: +import +(\([^)]*\)|[^#\n]*))?", re.MULTILINE
)

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> Dispatcher[_Function]:
    """Compile a function when it is first called, without the GIL; a division by zero raises as it does in Python."""
    return _made(function, nogil=True)


def compiled_unchecked(function: _Function) -> Dispatcher[_Function]:
    """The same, but a division by zero gives what numpy gives: only so can loops with divisions be vectorized."""
    return _made(function, nogil=True, error_model="numpy")


def inner(function: _Function) -> _Function:
    """Like `compiled`, without the entry for Python, which takes long to compile for functions of many arrays.

    Never to be called from Python, not even in a test: there is nothing to call, and the process would crash.
    """
    made: Any = _made(function, nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
    inner_function: _Function = made
    return inner_function


def _made(function: _Function, **options: Any) -> Dispatcher[_Function]:
    # Where nothing can be kept, numba refuses to try.
    kept = find_place(function, function.__code__.co_filename) is not None
    made: Dispatcher[_Function] = njit(function, cache=kept, **options)
    return made


class SourceLocator:
    """A cache locator as numba has them: its files lie where numba would put them, under a stamp of all sources.

    Args:
        place: the locator of numba's that says where.
        stamp: from `source_stamp`.
    """

    def __init__(self, place: Any, stamp: str) -> None:
        self._place = place
        self._stamp = stamp

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> Self | None:
        """The locator of a function of ours; None for others, and when nothing can be written anywhere."""
        if not function.__module__.startswith(_OURS):
            return None
        place = find_place(function, file)
        if place is None:
            return None
        stamp = source_stamp(Path(file).resolve())
        folder = Path(place.get_cache_path())
        patience.kept_in = str(folder)
        _sweep(folder, Path(file).stem, stamp)
        bring(Path(file).resolve().with_name("__pycache__"), folder, Path(file).stem, stamp)
        return cls(place, stamp)

    def ensure_cache_path(self) -> None:
        """Make the folder of the cache."""
        self._place.ensure_cache_path()

    def get_cache_path(self) -> str:
        """The folder of the cache."""
        return str(self._place.get_cache_path())

    def get_source_stamp(self) -> str:
        """What has to be the same for the cache to be fresh."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """What tells functions of one name apart."""
        return f"{self._place.get_disambiguator()}.{self._stamp}"


def source_stamp(file: Path) -> str:
    """16 digits of SHA-256 over the sources of a module and of all modules of ours that it imports, directly or not."""
    files: set[Path] = set()
    waiting = [file]
    while waiting:
        one = waiting.pop()
        if one not in files:
            files.add(one)
            waiting += _source(one)[1]
    return hashlib.sha256(b"".join(_source(one)[0] for one in sorted(files))).hexdigest()[:16]


@cache
def _sweep(folder: Path, module: str, stamp: str) -> None:
    """Remove what was compiled from other sources of a module."""
    for path in folder.glob(f"{module}.*.nb[ci]"):
        if f".{stamp}." not in path.name:
            with suppress(OSError):  # another process was faster, or the folder is not ours
                path.unlink()


@cache
def _source(file: Path) -> tuple[bytes, list[Path]]:
    """SHA-256 of a file, and the modules of ours that it imports when it is loaded."""
    source = file.read_bytes()
    found = []
    for module, names in _IMPORT.findall(source.decode()):
        for name in (module, *(f"{module}.{part}" for part in re.findall(r"\w+", names))):
            place = _ROOT.joinpath(*name.split("."))
            found += [path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()]
    return hashlib.sha256(source).digest(), found


_NUMBAS = "UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator,ZipCacheLocator"
_settings: Any = config
_settings.CACHE_LOCATOR_CLASSES = f"{__name__}.SourceLocator,{_settings.CACHE_LOCATOR_CLASSES or _NUMBAS}"
