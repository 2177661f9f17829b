"""Every duration model has the quantiles and moments that scipy says it has."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from planning.errors import ScenarioError
from planning.transforms import Array
from twin.durations import (
    DurationModel,
    Empirical,
    Exponential,
    Fixed,
    Gamma,
    Lognormal,
    Pert,
    Retries,
    Scaled,
    Shifted,
    Triangular,
    TruncatedNormal,
    Uniform,
    Weibull,
)

U = (np.arange(2000) + 0.5) / 2000
SECONDS = st.floats(0.01, 1000)


def truncated(mean: float, sd: float, low: float, high: float) -> object:
    return stats.truncnorm((low - mean) / sd, (high - mean) / sd, mean, sd)


KNOWN: list[tuple[DurationModel, object]] = [
    (Uniform(2.0, 5.0), stats.uniform(2, 3)),
    (Triangular(2.0, 3.0, 7.0), stats.triang(0.2, 2, 5)),
    (Triangular(2.0, 2.0, 7.0), stats.triang(0, 2, 5)),
    (Triangular(2.0, 7.0, 7.0), stats.triang(1, 2, 5)),
    (Pert(2.0, 3.0, 7.0), stats.beta(1 + 4 * 0.2, 1 + 4 * 0.8, 2, 5)),
    (Pert(0.0, 5.0, 5.0), stats.beta(5, 1, 0, 5)),
    (TruncatedNormal(8.0, 1.0), stats.norm(8, 1)),
    (TruncatedNormal(1.0, 2.0), truncated(1, 2, 0, math.inf)),
    (TruncatedNormal(-1.0, 1.0), truncated(-1, 1, 0, math.inf)),
    (TruncatedNormal(5.0, 2.0, 4.5, 9.0), truncated(5, 2, 4.5, 9)),
    (
        Lognormal(8.7, 10.0),
        stats.lognorm(np.log(10 / 8.7) / stats.norm.ppf(0.95), 0, 8.7),
    ),
    (
        Lognormal.from_mean(8.0, 0.3),
        stats.lognorm(np.sqrt(np.log(1.09)), 0, 8 / np.sqrt(1.09)),
    ),
    (Exponential(3.0), stats.expon(0, 3)),
    (Gamma(3.5, 2.0), stats.gamma(3.5, 0, 2)),
    (Gamma(0.7, 2.0), stats.gamma(0.7, 0, 2)),
    (Weibull(2.5, 8.0), stats.weibull_min(2.5, 0, 8)),
    (Weibull(0.8, 8.0), stats.weibull_min(0.8, 0, 8)),
    (Shifted(Gamma(3.5, 2.0), 4.0), stats.gamma(3.5, 4, 2)),
    (Shifted(Uniform(2.0, 5.0), -2.0), stats.uniform(0, 3)),
    (Scaled(Weibull(2.5, 8.0), 1.5), stats.weibull_min(2.5, 0, 12)),
]


@pytest.mark.parametrize(("model", "reference"), KNOWN, ids=lambda m: repr(m)[:40])
def test_quantiles_and_moments_are_scipys(
    model: DurationModel, reference: object
) -> None:
    assert model.ppf(U) == pytest.approx(reference.ppf(U), rel=1e-9, abs=1e-9)
    assert model.mean == pytest.approx(reference.mean(), rel=1e-9)
    assert model.sd == pytest.approx(reference.std(), rel=1e-8)
    low = reference.support()[0]
    assert model.minimum == (pytest.approx(low) if low > -math.inf else 0.0)


def test_a_scaled_shifted_model_is_all_three() -> None:
    model = Scaled(Shifted(Lognormal(1.0, 2.0), 1.0), 2.0)
    base = Lognormal(1.0, 2.0)
    assert model.ppf(U) == pytest.approx(2 * (base.ppf(U) + 1))
    assert model.mean == pytest.approx(2 * (base.mean + 1))
    assert model.sd == pytest.approx(2 * base.sd)
    assert model.minimum == 2.0


def test_mean_and_cv_come_back() -> None:
    for make in (Lognormal.from_mean, Gamma.from_mean):
        model = make(8.0, 0.25)
        assert model.mean == pytest.approx(8.0)
        assert model.sd == pytest.approx(2.0)


def test_moments_of_measured_times() -> None:
    model = Empirical([1.0, 2.0, 2.0, 7.0])
    assert model.sd == pytest.approx(np.std([1, 2, 2, 7]))
    assert model.minimum == 1.0
    assert Fixed(3.0).sd == 0.0
    assert Fixed(3.0).minimum == 3.0


# --- retries -----------------------------------------------------------------------------


def simulated(model: Retries, n: int) -> Array:
    """Attempt after attempt, the slow way."""
    rng = np.random.default_rng(1)
    out = model.attempt.ppf(rng.random(n))
    failed = np.ones(n, dtype=bool)
    for _ in range(model.retries):
        failed &= rng.random(n) < model.probability
        again = model.attempt if model.retry is None else model.retry
        out = out + np.where(failed, again.ppf(rng.random(n)), 0.0)
    return out


RETRIES = [
    Retries(Lognormal(8.0, 10.0), 0.1, 3),
    Retries(Lognormal(8.0, 10.0), 0.3, 2, Uniform(1.0, 4.0)),
    Retries(Gamma(4.0, 2.0), 0.6, 10, Weibull(1.5, 3.0)),
]


@pytest.mark.parametrize("model", RETRIES, ids=repr)
def test_retries_are_distributed_as_attempts_one_after_another(model: Retries) -> None:
    sample = simulated(model, 200_000)
    assert sample.mean() == pytest.approx(model.mean, abs=4 * model.sd / 447)
    assert sample.std() == pytest.approx(model.sd, rel=0.02)
    table = model.ppf((np.arange(200_000) + 0.5) / 200_000)
    assert stats.ks_2samp(sample, table).statistic < 0.005
    assert table.mean() == pytest.approx(model.mean, rel=1e-3)
    assert table.std() == pytest.approx(model.sd, rel=5e-3)


def test_retries_of_fixed_times_take_exactly_those() -> None:
    model = Retries(Fixed(8.0), 0.25, 2, Fixed(5.0))
    values, counts = np.unique(model.ppf(U), return_counts=True)
    assert values.tolist() == [8.0, 13.0, 18.0]
    assert (counts / len(U)).tolist() == pytest.approx([0.75, 0.1875, 0.0625], abs=6e-4)
    assert model.mean == pytest.approx(8 + 5 * (0.1875 + 2 * 0.0625))
    assert model.minimum == 8.0


def test_no_retries_are_the_attempt_alone() -> None:
    for model in (
        Retries(Uniform(2.0, 5.0), 0.5, 0),
        Retries(Uniform(2.0, 5.0), 0.0, 4),
    ):
        assert model.mean == 3.5
        assert model.ppf(U) == pytest.approx(Uniform(2.0, 5.0).ppf(U), abs=3 / 2**14)


def test_rare_retries_are_not_lost() -> None:
    model = Retries(Fixed(1.0), 1e-3, 3, Fixed(10.0))
    tail = 1 - np.array([2e-3, 0.9e-3, 0.9e-6, 0.9e-9])
    assert model.ppf(tail).tolist() == [1.0, 11.0, 21.0, 31.0]


# --- all of them -------------------------------------------------------------------------


def peaked(kind: Callable[..., DurationModel]) -> st.SearchStrategy[DurationModel]:
    return st.tuples(SECONDS, st.floats(0, 1), SECONDS).map(
        lambda t: kind(t[0], t[0] + t[1] * t[2], t[0] + t[2])
    )


SIMPLE = st.one_of(
    SECONDS.map(Fixed),
    st.tuples(SECONDS, SECONDS).map(lambda t: Uniform(t[0], t[0] + t[1])),
    peaked(Triangular),
    peaked(Pert),
    st.tuples(SECONDS, st.floats(0.01, 5)).map(
        lambda t: TruncatedNormal(t[0], t[0] * t[1])
    ),
    st.tuples(SECONDS, st.floats(1, 3)).map(lambda t: Lognormal(t[0], t[0] * t[1])),
    st.builds(Exponential, SECONDS),
    st.builds(Gamma, st.floats(0.3, 100), SECONDS),
    st.builds(Weibull, st.floats(0.5, 20), SECONDS),
    st.lists(SECONDS, min_size=1, max_size=9).map(Empirical),
)
ANY = st.one_of(
    SIMPLE,
    st.builds(Shifted, SIMPLE, SECONDS),
    st.builds(Scaled, SIMPLE, st.floats(0.1, 10)),
)


@settings(deadline=None)
@given(ANY, st.lists(st.floats(1e-12, 1 - 1e-12), min_size=2, max_size=20))
def test_quantiles_rise_from_the_minimum_and_no_duration_is_negative(
    model: DurationModel, u: list[float]
) -> None:
    quantiles = model.ppf(np.sort(u))
    assert quantiles.shape == (len(u),)
    assert np.all(np.isfinite(quantiles))
    assert np.all(np.diff(quantiles) >= -1e-12 * quantiles[-1])
    assert quantiles[0] >= model.minimum * (1 - 1e-12) >= 0
    assert model.minimum <= model.mean * (1 + 1e-12)
    assert 0 <= model.sd < math.inf


@settings(deadline=None)
@given(ANY)
def test_moments_are_those_of_the_quantiles(model: DurationModel) -> None:
    """The integral of the quantile function over u, by the midpoint rule."""
    u = (np.arange(20_000) + 0.5) / 20_000
    quantiles = model.ppf(u)
    assert quantiles.mean() == pytest.approx(model.mean, rel=0.01)
    assert quantiles.std() == pytest.approx(model.sd, rel=0.06, abs=1e-9)


@settings(deadline=None)
@given(ANY, st.integers(1, 40))
def test_a_quantile_does_not_depend_on_its_neighbours(
    model: DurationModel, n: int
) -> None:
    u = np.random.default_rng(n).random(n)
    together = model.ppf(u)
    assert together.tolist() == [float(model.ppf(u[k : k + 1])[0]) for k in range(n)]
    assert np.array_equal(model.ppf(np.tile(u, (3, 1)))[1], together)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Triangular(-1.0, 1.0, 2.0),
        lambda: Triangular(1.0, 3.0, 2.0),
        lambda: Triangular(2.0, 2.0, 2.0),
        lambda: Pert(1.0, 0.5, 2.0),
        lambda: Pert(1.0, 1.5, math.inf),
        lambda: TruncatedNormal(1.0, 0.0),
        lambda: TruncatedNormal(1.0, 1.0, -1.0),
        lambda: TruncatedNormal(1.0, 1.0, 3.0, 2.0),
        lambda: TruncatedNormal(-10.0, 1.0),
        lambda: TruncatedNormal(math.nan, 1.0),
        lambda: Lognormal.from_mean(0.0, 0.3),
        lambda: Lognormal.from_mean(8.0, -0.3),
        lambda: Exponential(-1.0),
        lambda: Gamma(0.0, 1.0),
        lambda: Gamma(1.0, math.inf),
        lambda: Gamma.from_mean(8.0, 0.0),
        lambda: Weibull(1.0, -1.0),
        lambda: Shifted(Uniform(2.0, 5.0), -2.1),
        lambda: Shifted(Lognormal(2.0, 5.0), -0.1),
        lambda: Shifted(Empirical([1.0, 2.0]), -1.5),
        lambda: Shifted(Fixed(1.0), math.nan),
        lambda: Scaled(Fixed(1.0), 0.0),
        lambda: Retries(Fixed(1.0), 1.0, 2),
        lambda: Retries(Fixed(1.0), -0.1, 2),
        lambda: Retries(Fixed(1.0), 0.1, 21),
        lambda: Retries(Fixed(1.0), 0.1, -1),
    ],
)
def test_impossible_models_are_refused(make: Callable[[], object]) -> None:
    with pytest.raises(ScenarioError):
        make()
