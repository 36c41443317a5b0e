"""Numbers in text, many at once."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray


def integers(text: bytes) -> NDArray[np.int64]:
    """All the numbers of a text that holds nothing but integers and blanks.

    Raises:
        ValueError: something else is in it.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, dtype=np.int64, sep=" ")
        except DeprecationWarning as error:
            raise ValueError(str(error)) from None


def reals(text: bytes) -> NDArray[np.float64]:
    """All the numbers of a text that holds nothing but numbers and blanks, in double precision.

    Raises:
        ValueError: something else is in it.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except DeprecationWarning as error:
            raise ValueError(str(error)) from None
