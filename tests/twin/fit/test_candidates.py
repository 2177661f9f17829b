"""The test of fit rejects what is wrong and, one time in twenty, what is right."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from twin.durations.normal import Lognormal
from twin.fit.fitting import (
    FAMILIES,
    LEVEL,
    Candidate,
    anderson_darling,
    fit_candidates,
    fit_family,
)


def by_name(found: tuple[Candidate, ...]) -> dict[str, Candidate]:
    return {candidate.family.title: candidate for candidate in found}


def test_anderson_darling_is_the_sum_of_its_definition() -> None:
    x = np.sort(stats.norm(1, 2).rvs(17, random_state=0))
    f = stats.norm(1, 2).cdf(x)
    n = len(x)
    total = sum(
        (2 * i - 1) * (math.log(f[i - 1]) + math.log(1 - f[n - i]))
        for i in range(1, n + 1)
    )
    assert anderson_darling(f[None])[0] == pytest.approx(-n - total / n)


def test_p_values_are_those_of_scipys_test_of_fit() -> None:
    x = stats.gamma(5, 0, 2).rvs(40, random_state=8)
    ours = by_name(fit_candidates(x, resamples=999))["lognormal"]
    scipys = stats.goodness_of_fit(
        stats.lognorm,
        x,
        known_params={"loc": 0},
        statistic="ad",
        n_mc_samples=300,
        rng=np.random.default_rng(0),
    )
    assert ours.anderson_darling == pytest.approx(scipys.statistic, rel=1e-6)
    assert ours.p_value == pytest.approx(scipys.pvalue, abs=0.1)


def test_p_values_of_the_right_family_are_uniform() -> None:
    """Textbook critical values would give p values near 1: parameters were estimated."""
    rng = np.random.default_rng(1)
    model = Lognormal(median_s=8.0, p95_s=11.0)
    p = []
    for k in range(300):
        x = np.sort(model.ppf(rng.random(25)))
        found = fit_family(Lognormal, x, resamples=99, seed=k)
        p.append(found.p_value)
    assert stats.kstest(p, "uniform").pvalue > 0.01
    assert np.mean(np.array(p) < LEVEL) < 0.09


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("right", "sample"),
    [
        ("uniform", stats.uniform(3, 2)),
        ("normal", stats.norm(8, 1)),
        ("exponential", stats.expon(0, 3)),
        ("lognormal", stats.lognorm(0.8, 0, 5)),
        ("gamma", stats.gamma(2, 0, 3)),
        ("Weibull", stats.weibull_min(3.5, 0, 5)),
        ("triangular", stats.triang(0.2, 3, 4)),
        ("PERT", stats.beta(1.8, 4.2, 2, 5)),
        ("shifted gamma", stats.gamma(1.5, 6, 1)),
    ],
)
def test_the_right_family_is_not_rejected_and_near_the_top(
    right: str, sample: object
) -> None:
    found = fit_candidates(sample.rvs(400, random_state=11), resamples=39)
    own = by_name(found)[right]
    assert not own.rejected
    assert own.aicc <= found[0].aicc + 4
    wrong = "exponential" if right != "exponential" else "uniform"
    assert by_name(found)[wrong].rejected


def test_those_that_fit_come_first_each_part_by_aicc() -> None:
    found = fit_candidates(stats.gamma(2, 0, 3).rvs(100, random_state=2), resamples=39)
    keys = [(candidate.rejected, candidate.aicc) for candidate in found]
    assert keys == sorted(keys)
    assert {True, False} == {candidate.rejected for candidate in found}
    assert {candidate.family for candidate in found} == set(FAMILIES)


def test_aicc_follows_its_definition() -> None:
    x = np.sort(stats.gamma(2, 0, 3).rvs(30, random_state=2))
    candidate = by_name(fit_candidates(x, resamples=19))["gamma"]
    shape, scale = candidate.theta
    likelihood = stats.gamma(shape, 0, scale).logpdf(x).sum()
    assert candidate.aicc == pytest.approx(4 - 2 * likelihood + 12 / 27)


def test_the_same_seed_gives_the_same_figures() -> None:
    x = stats.gamma(2, 0, 3).rvs(30, random_state=2)
    first, again = (fit_candidates(x, resamples=39, seed=5) for _ in range(2))
    assert [c.p_value for c in first] == [c.p_value for c in again]
    other = fit_candidates(x, resamples=39, seed=6)
    assert [c.p_value for c in first] != [c.p_value for c in other]


@pytest.mark.parametrize(
    "x",
    [
        np.r_[np.zeros(5), np.arange(1.0, 15.0)],
        np.r_[np.linspace(4.9, 5.1, 30), 500.0],
        np.r_[np.full(10, 3.0), np.full(10, 5.0)],
        np.r_[np.full(19, 5.0), 5.1],
        np.linspace(1e5, 1e6, 20),
        np.linspace(1e-6, 2e-6, 20),
        np.r_[1e-300, np.linspace(0.1, 1, 20)],
    ],
    ids=["zeros", "outlier", "two values", "one off", "long", "short", "nearly 0"],
)
def test_odd_samples_give_finite_figures(x: np.ndarray) -> None:
    found = fit_candidates(x, resamples=19)
    assert found
    for candidate in found:
        assert np.isfinite(candidate.aicc)
        assert np.isfinite(candidate.anderson_darling)
        assert np.all(candidate.model.ppf(np.array([0.01, 0.5, 0.99])) >= 0)


def test_nothing_is_fitted_to_one_value() -> None:
    assert fit_candidates(np.full(20, 3.0)) == ()
    assert fit_candidates(np.linspace(5.0, 5.0001, 20)) == ()
