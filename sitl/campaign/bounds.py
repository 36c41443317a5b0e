"""How sure a share is that was counted in a number of missions."""

from __future__ import annotations

import math
from statistics import NormalDist

CONFIDENCE = 0.95
"""Of all bounds of a campaign: so often such an interval holds what it is about."""


def wilson(count: int, of: int) -> tuple[float, float]:
    """Wilson's score interval of a share, two-sided: holds for shares near 0 and 1 too, where the usual one does not.

    Raises:
        ValueError: there is nothing of which it could be a share.
    """
    _check(count, of)
    z = NormalDist().inv_cdf(0.5 + CONFIDENCE / 2.0)
    share, spread = count / of, z * z / of
    middle = (share + spread / 2.0) / (1.0 + spread)
    half = math.sqrt(spread * (share * (1.0 - share) + spread / 4.0)) / (1.0 + spread)
    return (0.0 if count == 0 else middle - half), (1.0 if count == of else middle + half)


def at_most(count: int, of: int) -> float:
    """The one-sided upper bound of a share by Clopper and Pearson, never too low: for what must not happen.

    Of none in n it is 1 - 0.05^(1/n), the rule of three: about 3/n.

    Raises:
        ValueError: there is nothing of which it could be a share.
    """
    _check(count, of)
    if count == of:
        return 1.0
    low, high = count / of, 1.0
    while high - low > 1e-12:
        middle = (low + high) / 2.0
        # The bound is where so few would be found in 5 % of all cases.
        low, high = (middle, high) if _at_most_probability(count, of, middle) > 1.0 - CONFIDENCE else (low, middle)
    return high


def _at_most_probability(count: int, of: int, share: float) -> float:
    """Of finding at most ``count`` of ``of`` where each comes with the probability ``share``, between 0 and 1."""
    if share <= 0.0:
        return 1.0
    if share >= 1.0:
        return 0.0
    logs = (
        math.lgamma(of + 1) - math.lgamma(k + 1) - math.lgamma(of - k + 1) + k * math.log(share)
        + (of - k) * math.log1p(-share)
        for k in range(count + 1)
    )  # fmt: skip
    return math.fsum(math.exp(value) for value in logs)


def _check(count: int, of: int) -> None:
    if not 0 <= count <= of or of == 0:
        raise ValueError(f"{count} of {of} is no share")
