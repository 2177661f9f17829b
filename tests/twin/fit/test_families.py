"""Families have scipy's densities, and are fitted at least as likely as scipy fits them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from planning.transforms import Array
from tests.twin.durations.known_distributions import KNOWN
from twin.durations.bounded import Pert, Triangular, Uniform
from twin.durations.fittable import Family, ShiftedFamily, golden_section
from twin.durations.lifetimes import Exponential, Gamma, Weibull
from twin.durations.normal import Lognormal, TruncatedNormal
from twin.fit.fitting import FAMILIES, section_model

T = np.linspace(0.0, 14.0, 141)[None]

IDS = [f"{family.title} {theta}" for family, theta, _ in KNOWN]


@pytest.mark.parametrize(("family", "theta", "reference"), KNOWN, ids=IDS)
def test_densities_and_probabilities_are_scipys(
    family: Family, theta: list[float], reference: object
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
    family: Family, reference: object, sample: Array
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
