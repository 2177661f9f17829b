"""Every duration model has the quantiles and means that scipy says it has."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import stats

from planning.errors import ScenarioError
from planning.transforms import Array
from tests.twin.durations.known_distributions import KNOWN, Frozen
from twin.durations.bounded import Fixed, Pert, Triangular, Uniform
from twin.durations.composed import Retries, Shifted
from twin.durations.lifetimes import Exponential, Gamma, Weibull
from twin.durations.lognormal import Lognormal
from twin.durations.measured import Empirical, MeasuredTimes
from twin.durations.model import DurationModel
from twin.durations.normal import TruncatedNormal
from twin.fit.candidates import section_model

U = (np.arange(2000) + 0.5) / 2000
SECONDS = st.floats(0.01, 1000)


def truncated(mean: float, sd: float, low: float, high: float) -> Frozen:
    return stats.truncnorm((low - mean) / sd, (high - mean) / sd, mean, sd)


MODELS: list[tuple[DurationModel, Frozen]] = [
    *(
        (section_model(family.section(np.array(theta))), reference)
        for family, theta, reference in KNOWN
        if "lognormal" not in family.title  # whose section rounds two quantiles
    ),
    (Pert(low_s=0.0, mode_s=5.0, high_s=5.0), stats.beta(5, 1, 0, 5)),
    (TruncatedNormal(mean_s=-1.0, sd_s=1.0), truncated(-1, 1, 0, math.inf)),
    (
        TruncatedNormal(mean_s=5.0, sd_s=2.0, low_s=4.5, high_s=9.0),
        truncated(5, 2, 4.5, 9),
    ),
    (
        Lognormal(median_s=8.7, p95_s=10.0),
        stats.lognorm(np.log(10 / 8.7) / stats.norm.ppf(0.95), 0, 8.7),
    ),
    (
        Lognormal(mean_s=8.0, cv=0.3),
        stats.lognorm(np.sqrt(np.log(1.09)), 0, 8 / np.sqrt(1.09)),
    ),
    (Gamma(shape=0.7, scale_s=2.0), stats.gamma(0.7, 0, 2)),
    (Weibull(shape=0.8, scale_s=8.0), stats.weibull_min(0.8, 0, 8)),
    (Shifted(model=Uniform(low_s=2.0, high_s=5.0), offset_s=-2.0), stats.uniform(0, 3)),
    (Weibull(shape=2.5, scale_s=8.0, scale=1.5), stats.weibull_min(2.5, 0, 12)),
]


@pytest.mark.parametrize(("model", "reference"), MODELS, ids=lambda m: repr(m)[:40])
def test_quantiles_and_means_are_scipys(
    model: DurationModel, reference: Frozen
) -> None:
    u = np.append(U, [0.5, 0.95])  # which some are given by
    assert model.ppf(u) == pytest.approx(reference.ppf(u), rel=1e-9, abs=1e-9)
    assert model.mean == pytest.approx(reference.mean(), rel=1e-9)
    low = reference.support()[0]
    assert model.minimum == (pytest.approx(low) if low > -math.inf else 0.0)


def test_a_scaled_shifted_model_is_all_three() -> None:
    model = Shifted(model=Lognormal(median_s=1.0, p95_s=2.0), offset_s=1.0, scale=2.0)
    base = Lognormal(median_s=1.0, p95_s=2.0)
    assert model.ppf(U) == pytest.approx(2 * (base.ppf(U) + 1))
    assert model.mean == pytest.approx(2 * (base.mean + 1))
    assert model.minimum == 2.0


def test_mean_and_cv_come_back() -> None:
    for model in (Lognormal(mean_s=8.0, cv=0.25), Gamma(mean_s=8.0, cv=0.25)):
        assert model.mean == pytest.approx(8.0)
        u = (np.arange(200_000) + 0.5) / 200_000
        assert model.ppf(u).std() == pytest.approx(2.0, rel=1e-3)


def test_mean_and_minimum_of_measured_and_of_fixed_times() -> None:
    model = MeasuredTimes(values=(3.0, 1.0, 2.0, 2.0, 8.0))
    assert (model.mean, model.minimum) == (3.2, 1.0)
    assert model.ppf(np.linspace(0.1, 0.9, 5)).tolist() == [1.0, 2.0, 2.0, 3.0, 8.0]
    fixed = Fixed(value_s=2.5)
    assert fixed.ppf(U[:3]).tolist() == [2.5, 2.5, 2.5]
    assert (fixed.mean, fixed.minimum) == (2.5, 2.5)


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
    Retries(attempt=Lognormal(median_s=8.0, p95_s=10.0), probability=0.1, retries=3),
    Retries(
        attempt=Lognormal(median_s=8.0, p95_s=10.0),
        probability=0.3,
        retries=2,
        retry=Uniform(low_s=1.0, high_s=4.0),
    ),
    Retries(
        attempt=Gamma(shape=4.0, scale_s=2.0),
        probability=0.6,
        retries=10,
        retry=Weibull(shape=1.5, scale_s=3.0),
    ),
]


@pytest.mark.parametrize("model", RETRIES, ids=repr)
def test_retries_are_distributed_as_attempts_one_after_another(model: Retries) -> None:
    sample = simulated(model, 200_000)
    assert sample.mean() == pytest.approx(model.mean, abs=4 * sample.std() / 447)
    table = model.ppf((np.arange(200_000) + 0.5) / 200_000)
    assert sample.std() == pytest.approx(table.std(), rel=0.02)
    assert stats.ks_2samp(sample, table).statistic < 0.005
    assert table.mean() == pytest.approx(model.mean, rel=1e-3)


def test_retries_of_fixed_times_take_exactly_those() -> None:
    model = Retries(
        attempt=Fixed(value_s=8.0),
        probability=0.25,
        retries=2,
        retry=Fixed(value_s=5.0),
    )
    values, counts = np.unique(model.ppf(U), return_counts=True)
    assert values.tolist() == [8.0, 13.0, 18.0]
    assert (counts / len(U)).tolist() == pytest.approx([0.75, 0.1875, 0.0625], abs=6e-4)
    assert model.mean == pytest.approx(8 + 5 * (0.1875 + 2 * 0.0625))
    assert model.minimum == 8.0


def test_no_retries_are_the_attempt_alone() -> None:
    for model in (
        Retries(attempt=Uniform(low_s=2.0, high_s=5.0), probability=0.5, retries=0),
        Retries(attempt=Uniform(low_s=2.0, high_s=5.0), probability=0.0, retries=4),
    ):
        assert model.mean == 3.5
        assert model.ppf(U) == pytest.approx(
            Uniform(low_s=2.0, high_s=5.0).ppf(U), abs=3 / 2**14
        )


def test_rare_retries_are_not_lost() -> None:
    model = Retries(
        attempt=Fixed(value_s=1.0),
        probability=1e-3,
        retries=3,
        retry=Fixed(value_s=10.0),
    )
    tail = 1 - np.array([2e-3, 0.9e-3, 0.9e-6, 0.9e-9])
    assert model.ppf(tail).tolist() == [1.0, 11.0, 21.0, 31.0]


# --- all of them -------------------------------------------------------------------------


def peaked(kind: Callable[..., DurationModel]) -> st.SearchStrategy[DurationModel]:
    return st.tuples(SECONDS, st.floats(0, 1), SECONDS).map(
        lambda t: kind(low_s=t[0], mode_s=t[0] + t[1] * t[2], high_s=t[0] + t[2])
    )


SIMPLE = st.one_of(
    st.builds(Fixed, value_s=SECONDS),
    st.tuples(SECONDS, SECONDS).map(lambda t: Uniform(low_s=t[0], high_s=t[0] + t[1])),
    peaked(Triangular),
    peaked(Pert),
    st.tuples(SECONDS, st.floats(0.01, 5)).map(
        lambda t: TruncatedNormal(mean_s=t[0], sd_s=t[0] * t[1])
    ),
    st.tuples(SECONDS, st.floats(1, 3)).map(
        lambda t: Lognormal(median_s=t[0], p95_s=t[0] * t[1])
    ),
    st.builds(Exponential, mean_s=SECONDS),
    st.builds(Gamma, shape=st.floats(0.3, 100), scale_s=SECONDS),
    st.builds(Weibull, shape=st.floats(0.5, 20), scale_s=SECONDS),
)
MEASURED = st.lists(SECONDS, min_size=1, max_size=9).map(
    lambda values: MeasuredTimes(values=tuple(values))
)
ANY = st.one_of(
    SIMPLE,
    MEASURED,
    st.builds(Shifted, model=SIMPLE, offset_s=SECONDS),
    st.tuples(SIMPLE, st.floats(0.1, 10)).map(lambda t: t[0].scaled(t[1])),
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


@settings(deadline=None)
@given(ANY)
def test_means_are_those_of_the_quantiles(model: DurationModel) -> None:
    """The integral of the quantile function over u, by the midpoint rule."""
    u = (np.arange(20_000) + 0.5) / 20_000
    quantiles = model.ppf(u)
    assert quantiles.mean() == pytest.approx(model.mean, rel=0.01)


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
        lambda: Fixed(value_s=-1.0),
        lambda: Fixed(value_s=math.nan),
        lambda: Uniform(low_s=3.0, high_s=2.0),
        lambda: MeasuredTimes(values=()),
        lambda: MeasuredTimes(values=(1.0, -1.0)),
        lambda: Lognormal(median_s=0.0, p95_s=1.0),
        lambda: Lognormal(median_s=2.0, p95_s=1.0),
        lambda: Triangular(low_s=-1.0, mode_s=1.0, high_s=2.0),
        lambda: Triangular(low_s=1.0, mode_s=3.0, high_s=2.0),
        lambda: Triangular(low_s=2.0, mode_s=2.0, high_s=2.0),
        lambda: Pert(low_s=1.0, mode_s=0.5, high_s=2.0),
        lambda: Pert(low_s=1.0, mode_s=1.5, high_s=math.inf),
        lambda: TruncatedNormal(mean_s=1.0, sd_s=0.0),
        lambda: TruncatedNormal(mean_s=1.0, sd_s=1.0, low_s=-1.0),
        lambda: TruncatedNormal(mean_s=math.nan, sd_s=1.0),
        lambda: Lognormal(mean_s=0.0, cv=0.3),
        lambda: Lognormal(mean_s=8.0, cv=-0.3),
        lambda: Exponential(mean_s=-1.0),
        lambda: Gamma(shape=0.0, scale_s=1.0),
        lambda: Gamma(shape=1.0, scale_s=math.inf),
        lambda: Gamma(mean_s=8.0, cv=0.0),
        lambda: Weibull(shape=1.0, scale_s=-1.0),
        lambda: Shifted(model=Fixed(value_s=1.0), offset_s=math.nan),
        lambda: Fixed(value_s=1.0, scale=0.0),
        lambda: Retries(attempt=Fixed(value_s=1.0), probability=1.0, retries=2),
        lambda: Retries(attempt=Fixed(value_s=1.0), probability=-0.1, retries=2),
        lambda: Retries(attempt=Fixed(value_s=1.0), probability=0.1, retries=21),
        lambda: Retries(attempt=Fixed(value_s=1.0), probability=0.1, retries=-1),
    ],
)
def test_impossible_models_are_refused(make: Callable[[], object]) -> None:
    with pytest.raises(ValidationError):
        make()


@pytest.mark.parametrize(
    "model",
    [
        TruncatedNormal(mean_s=1.0, sd_s=1.0, low_s=3.0, high_s=2.0),
        TruncatedNormal(mean_s=-10.0, sd_s=1.0),
        TruncatedNormal(mean_s=1.0, sd_s=1e-10),
        Lognormal(median_s=1e-5, p95_s=1e5),
    ],
)
def test_values_that_make_no_distribution_are_refused(model: DurationModel) -> None:
    with pytest.raises(ScenarioError):
        model.located(Path())


def test_what_would_make_durations_negative_is_refused_with_its_files(
    tmp_path: Path,
) -> None:
    (tmp_path / "t.csv").write_text("duration_s\n1\n2\n")
    for model, offset in (
        (Uniform(low_s=2.0, high_s=5.0), -2.1),
        (Lognormal(median_s=2.0, p95_s=5.0), -0.1),
        (Empirical(csv="t.csv"), -1.5),
    ):
        with pytest.raises(ScenarioError, match="negative"):
            Shifted(model=model, offset_s=offset).located(tmp_path)
    shifted = Shifted(model=Empirical(csv="t.csv"), offset_s=-1.0).located(tmp_path)
    assert shifted.ppf(U[::500]).tolist() == [0.0, 0.0, 1.0, 1.0]


def test_a_mean_next_to_nothing_is_nothing() -> None:
    model = Lognormal(mean_s=5e-324, cv=2.0)
    assert model.mean == 0.0
    assert list(model.ppf(np.array([0.1, 0.9]))) == [0.0, 0.0]


@pytest.mark.parametrize(
    "model",
    [
        Lognormal(median_s=0.001, p95_s=1e6),
        Weibull(shape=0.1, scale_s=1e6),
        Gamma(shape=1e6, scale_s=1e6),
    ],
)
def test_a_mean_beyond_all_plans_is_refused(model: DurationModel) -> None:
    with pytest.raises(ScenarioError, match="its mean is"):
        _ = model.mean
