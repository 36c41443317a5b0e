"""How sure a share is: against published values and by the meaning of the bounds."""

from __future__ import annotations

import pytest

from sitl.campaign.bounds import at_most, wilson


@pytest.mark.parametrize(
    ("count", "of", "low", "high"),
    # Newcombe, "Two-sided confidence intervals for the single proportion", Statistics in Medicine 17 (1998), table I.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_as_published(count: int, of: int, low: float, high: float) -> None:
    assert wilson(count, of) == pytest.approx((low, high), abs=5e-5)
    assert wilson(of - count, of) == pytest.approx((1.0 - high, 1.0 - low), abs=5e-5)


@pytest.mark.parametrize("of", [1, 20, 1000, 30000])
def test_of_none_it_is_the_rule_of_three(of: int) -> None:
    assert at_most(0, of) == pytest.approx(1.0 - 0.05 ** (1.0 / of), abs=1e-9)
    assert at_most(0, of) <= 3.0 / of


# Quantiles of the beta distribution, B(0.95; k + 1, n - k), from R's qbeta.
@pytest.mark.parametrize(("count", "of", "bound"), [(1, 20, 0.2161061), (3, 100, 0.0757108), (19, 20, 0.9974386)])
def test_clopper_and_pearson(count: int, of: int, bound: float) -> None:
    assert at_most(count, of) == pytest.approx(bound, abs=1e-6)


def test_all_of_all_has_no_bound_and_none_of_none_no_share() -> None:
    assert at_most(7, 7) == 1.0
    for count, of in ((0, 0), (3, 2), (-1, 2)):
        with pytest.raises(ValueError, match="is no share"):
            wilson(count, of)
        with pytest.raises(ValueError, match="is no share"):
            at_most(count, of)
