"""Families have the densities of scipy and are fitted at least as likely; the test of fit rejects what is wrong."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from planning.transforms import Array
from tests.twin.durations.known_distributions import KNOWN, Frozen
from twin.durations.bounded import Pert, Triangular, Uniform
from twin.durations.fittable import golden_section
from twin.durations.lifetimes import Exponential, Gamma, Weibull
from twin.durations.lognormal import Lognormal
from twin.durations.normal import TruncatedNormal
from twin.fit.candidates import (
    FAMILIES,
    LEVEL,
    Candidate,
    anderson_darling,
    fit_candidates,
    fit_family,
    section_model,
)
from twin.fit.shifted import Family, ShiftedFamily

T = np.linspace(0.0, 14.0, 141)[None]

IDS = [f"{family.title} {theta}" for family, theta, _ in KNOWN]


@pytest.mark.parametrize(("family", "theta", "reference"), KNOWN, ids=IDS)
def test_densities_and_probabilities_are_scipys(
    family: Family, theta: list[float], reference: Frozen
) -> None:
    row = np.array([theta], dtype=float)
    density = np.exp(family.log_density(T, row))[0]
    assert density == pytest.approx(reference.pdf(T[0]), rel=1e-9, abs=1e-12)
    assert family.cdf(T, row)[0] == pytest.approx(reference.cdf(T[0]), abs=1e-12)


@pytest.mark.parametrize(("family", "theta", "reference"), KNOWN, ids=IDS)
def test_a_scenario_draws_from_the_distribution_that_was_fitted(
    family: Family, theta: list[float], reference: object
) -> None:
    u = np.linspace(0.01, 0.99, 99)
    quantiles = section_model(family.section(np.array(theta, dtype=float))).ppf(u)
    assert family.cdf(quantiles[None], np.array([theta], dtype=float))[0] == (
        pytest.approx(u, abs=1e-5)
    )


def test_every_family_is_known() -> None:
    assert {family for family, _, _ in KNOWN} == set(FAMILIES)


def likelihood(family: Family, x: Array) -> float:
    return float(family.log_density(x[None], family.fit(x[None])).sum())


SAMPLES = {
    "gamma": stats.gamma(4, 0, 2).rvs(40, random_state=1),
    "nearly fixed": stats.norm(8, 0.01).rvs(40, random_state=2),
    "wide": stats.lognorm(1.5).rvs(40, random_state=3),
    "many": stats.weibull_min(3, 0, 5).rvs(500, random_state=4),
    "few": stats.uniform(2, 3).rvs(10, random_state=5),
}


@pytest.mark.parametrize("sample", SAMPLES.values(), ids=SAMPLES.keys())
@pytest.mark.parametrize(
    ("family", "reference"),
    [
        (Exponential, stats.expon),
        (Lognormal, stats.lognorm),
        (Gamma, stats.gamma),
        (Weibull, stats.weibull_min),
    ],
    ids=lambda v: getattr(v, "title", ""),
)
def test_nothing_scipy_finds_is_likelier(
    family: Family, reference: stats.rv_continuous, sample: Array
) -> None:
    x = np.sort(sample)
    parameters = reference.fit(x, floc=0)
    expected = reference.logpdf(x, *parameters).sum()
    assert likelihood(family, x) >= expected - 1e-6 * abs(expected) - 1e-6


@pytest.mark.parametrize("sample", SAMPLES.values(), ids=SAMPLES.keys())
def test_no_cut_off_normal_is_likelier(sample: Array) -> None:
    x = np.sort(sample)
    if x.std() > 0.9 * x.mean():
        return  # nearly exponential: the bound of 99 % cut off is reached

    def negative(theta: Array) -> float:
        row = np.array([[theta[0], np.exp(theta[1])]])
        return -float(TruncatedNormal.log_density(x[None], row).sum())

    found = optimize.minimize(
        negative, [x.mean(), np.log(x.std())], method="Nelder-Mead"
    )
    assert likelihood(TruncatedNormal, x) >= -found.fun - 1e-4


@pytest.mark.parametrize("name", ["gamma", "wide", "many", "few"])
@pytest.mark.parametrize(
    "family",
    [ShiftedFamily(f) for f in (Lognormal, Gamma, Weibull)],
    ids=lambda f: f.title,
)
def test_no_offset_of_a_fine_grid_is_likelier(family: ShiftedFamily, name: str) -> None:
    x = np.sort(SAMPLES[name])
    most = x[0] - 0.5 * (x[-1] - x[0]) / len(x)
    best = max(
        likelihood(family.base, x - offset)
        for offset in np.linspace(0, max(most, 0), 400)
    )
    assert likelihood(family, x) >= best - 1e-3


@pytest.mark.parametrize("name", ["gamma", "many", "few"])
@pytest.mark.parametrize("family", [Triangular, Pert], ids=["t", "p"])
def test_bounds_and_mode_are_nearly_the_likeliest(family: Family, name: str) -> None:
    """Ten thousand random bounds and modes are hardly better."""
    x = np.sort(SAMPLES[name])
    spread = x[-1] - x[0]
    rng = np.random.default_rng(0)
    n = 10_000
    low = rng.uniform(max(x[0] - spread, 0.0), x[0], n)
    high = rng.uniform(x[-1], x[-1] + spread, n)
    mode = rng.uniform(low, high)
    theta = np.stack([low, mode, high], axis=1)
    best = max(
        float(family.log_density(x[None], part).sum(axis=1).max())
        for part in np.array_split(theta, 10)
    )
    assert likelihood(family, x) >= best - 0.5


def test_bounds_of_uniform_samples_are_right_on_average() -> None:
    x = np.sort(np.random.default_rng(0).uniform(3.0, 5.0, (4000, 12)), axis=1)
    theta = Uniform.fit(x)
    assert theta.mean(axis=0) == pytest.approx([3.0, 5.0], abs=0.01)


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.floats(0.001, 1000), min_size=10, max_size=30, unique=True),
    st.integers(0, len(FAMILIES) - 1),
)
def test_samples_are_fitted_alike_alone_and_together(
    values: list[float], which: int
) -> None:
    family = FAMILIES[which]
    x = np.sort(values)
    both = np.stack([x, np.sort(x[-1] + 1 - x)])
    together = family.fit(both)
    for row, theta in zip(both, together, strict=True):
        assert family.fit(row[None])[0] == pytest.approx(theta, rel=1e-9, abs=1e-9)


def test_golden_section_finds_maxima() -> None:
    tops = np.array([0.0, 0.3, 1.0])
    found = golden_section(
        lambda at: -((at - tops) ** 2), np.zeros(3), np.ones(3), steps=40
    )
    assert found == pytest.approx(tops, abs=1e-6)


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
    right: str, sample: Frozen
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
