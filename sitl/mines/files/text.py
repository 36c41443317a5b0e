"""Numbers in text, many at once."""

from __future__ import annotations

import warnings
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

_Number = TypeVar("_Number", np.int64, np.float64)


def integers(text: bytes) -> NDArray[np.int64]:
    """All the numbers of a text that holds nothing but integers and blanks.

    Raises:
        ValueError: something else is in it.
    """
    return _numbers(text, np.int64)


def reals(text: bytes) -> NDArray[np.float64]:
    """All the numbers of a text that holds nothing but numbers and blanks, in double precision.

    Raises:
        ValueError: something else is in it.
    """
    return _numbers(text, np.float64)


def _numbers(text: bytes, kind: type[_Number]) -> NDArray[_Number]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, dtype=kind, sep=" ")
        except DeprecationWarning as error:
            raise ValueError(str(error)) from None
