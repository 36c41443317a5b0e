"""How functions are compiled that only compiled functions call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def inner(function: _Function) -> _Function:
    """Like ``njit``, without the entry for Python, which takes long to compile for functions of many arrays.

    Never to be called from Python, not even in a test: there is nothing to call, and the process would crash.
    """
    compiled: _Function = njit(**_OPTIONS)(function)
    return compiled
