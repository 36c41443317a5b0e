"""How sure a share is that was counted in a number of missions: the exact bounds of Clopper and Pearson.

They hold at least as often as they say, however few missions there are and however near the share is to 0 or 1.
"""

from __future__ import annotations

from scipy.special import betaincinv

CONFIDENCE = 0.95
"""Of all bounds of a campaign: at least so often such an interval holds what it is about."""


def between(count: int, of: int) -> tuple[float, float]:
    """The bounds of a share from both sides: each is missed in half of what `CONFIDENCE` leaves, at most.

    Raises:
        ValueError: there is nothing of which it could be a share.
    """
    _check(count, of)
    missed = (1.0 - CONFIDENCE) / 2.0
    return 1.0 - _upper(of - count, of, missed), _upper(count, of, missed)


def at_most(count: int, of: int) -> float:
    """The upper bound of a share alone: for what must not happen.

    Of none in n it is 1 - 0.05^(1/n), the rule of three: about 3/n.

    Raises:
        ValueError: there is nothing of which it could be a share.
    """
    _check(count, of)
    return _upper(count, of, 1.0 - CONFIDENCE)


def _upper(count: int, of: int, missed: float) -> float:
    """The share of which so few would be found with the probability ``missed``."""
    return 1.0 if count == of else float(betaincinv(count + 1.0, of - count, 1.0 - missed))


def _check(count: int, of: int) -> None:
    if not 0 <= count <= of or of == 0:
        raise ValueError(f"{count} of {of} is no share")
