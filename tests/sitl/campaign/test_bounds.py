"""How sure a share is: against published values and by the meaning of the bounds."""

from __future__ import annotations

import math

import pytest

from sitl.campaign.bounds import at_most, between


@pytest.mark.parametrize(
    ("count", "of", "low", "high"),
    # Newcombe, "Two-sided confidence intervals for the single proportion", Statistics in Medicine 17 (1998), table I.
    [(81, 263, 0.2527, 0.3676), (15, 148, 0.0578, 0.1617), (0, 20, 0.0, 0.1684), (1, 29, 0.0009, 0.1776)],
)
def test_clopper_and_pearson_as_published(count: int, of: int, low: float, high: float) -> None:
    assert between(count, of) == pytest.approx((low, high), abs=5e-5)
    assert between(of - count, of) == pytest.approx((1.0 - high, 1.0 - low), abs=5e-5)


def found(least: int, most: int, of: int, share: float) -> float:
    """The probability of finding from ``least`` to ``most`` of ``of`` where each comes with ``share``."""
    return math.fsum(math.comb(of, k) * share**k * (1.0 - share) ** (of - k) for k in range(least, most + 1))


@pytest.mark.parametrize(("count", "of"), [(1, 2), (3, 20), (19, 20), (17, 460), (959, 1000)])
def test_at_its_bounds_what_was_found_is_as_rare_as_they_say(count: int, of: int) -> None:
    """Protects what a bound means: were the share there, so many, or so few, would come in 2.5 % of all campaigns."""
    low, high = between(count, of)
    assert found(count, of, of, low) == pytest.approx(0.025, rel=1e-6)
    assert found(0, count, of, high) == pytest.approx(0.025, rel=1e-6)
    assert found(0, count, of, at_most(count, of)) == pytest.approx(0.05, rel=1e-6)


@pytest.mark.parametrize("of", [1, 20, 1000, 30000])
def test_of_none_it_is_the_rule_of_three(of: int) -> None:
    assert at_most(0, of) == pytest.approx(1.0 - 0.05 ** (1.0 / of), abs=1e-9)
    assert at_most(0, of) <= 3.0 / of


# Quantiles of the beta distribution, B(0.95; k + 1, n - k), from R's qbeta.
@pytest.mark.parametrize(("count", "of", "bound"), [(1, 20, 0.2161061), (3, 100, 0.0757108), (19, 20, 0.9974386)])
def test_the_upper_bound_alone(count: int, of: int, bound: float) -> None:
    assert at_most(count, of) == pytest.approx(bound, abs=1e-6)


def test_none_and_all_reach_the_ends_and_none_of_none_is_no_share() -> None:
    assert at_most(7, 7) == 1.0
    assert between(0, 7)[0] == 0.0
    assert between(7, 7)[1] == 1.0
    for count, of in ((0, 0), (3, 2), (-1, 2)):
        with pytest.raises(ValueError, match="is no share"):
            between(count, of)
        with pytest.raises(ValueError, match="is no share"):
            at_most(count, of)
