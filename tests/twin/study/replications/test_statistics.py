"""Intervals against scipy, against simulated resampling, and by how often they cover the truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from planning.errors import TwinError
from twin.study.plans import with_baselines
from twin.study.replications.statistics import (
    Experiment,
    Precision,
    mean_interval,
    quantile_interval,
    share_interval,
)
from twin.study.summary import policy_differences


def test_the_mean_has_students_interval() -> None:
    sample = np.random.default_rng(0).gamma(2.0, 3.0, 25)
    found = mean_interval(sample, confidence=0.9)
    oracle = stats.ttest_1samp(sample, 0.0).confidence_interval(0.9)
    assert found.estimate == pytest.approx(sample.mean())
    assert (found.low, found.high) == pytest.approx((oracle.low, oracle.high))
    assert found.count == 25


def test_one_replication_says_nothing_about_the_spread() -> None:
    found = mean_interval([3.0])
    assert (found.estimate, found.low, found.high) == (3.0, -np.inf, np.inf)
    assert found.relative_half_width == np.inf


def test_antithetic_pairs_count_once() -> None:
    u = np.random.default_rng(1).random(200)
    sample = np.ravel(np.column_stack([u, 1 - u]))
    assert mean_interval(sample, antithetic=True).half_width == pytest.approx(
        0, abs=1e-12
    )
    assert mean_interval(sample).half_width > 0.02


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99])
def test_quantiles_have_the_interval_of_many_resamples(probability: float) -> None:
    rng = np.random.default_rng(2)
    sample = rng.lognormal(1.0, 0.4, 120)
    found = quantile_interval(sample, probability)
    draws = rng.choice(sample, (20_000, len(sample)))
    quantiles = np.quantile(draws, probability, axis=1, method="inverted_cdf")
    ordered = np.sort(sample)
    for bound, share in ((found.low, 0.025), (found.high, 0.975)):
        simulated = np.quantile(quantiles, share, method="inverted_cdf")
        places = np.searchsorted(ordered, [bound, simulated])
        assert abs(int(places[0]) - int(places[1])) <= 1
    assert found.estimate == np.quantile(sample, probability, method="inverted_cdf")


def test_quantile_intervals_cover_the_truth() -> None:
    rng = np.random.default_rng(3)
    truth = float(stats.expon.ppf(0.9))
    inside = [
        found.low <= truth <= found.high
        for found in (
            quantile_interval(rng.exponential(size=200), 0.9) for _ in range(400)
        )
    ]
    assert 0.90 <= np.mean(inside) <= 0.99


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 400), st.data())
def test_shares_have_wilsons_interval(count: int, data: st.DataObject) -> None:
    hits = data.draw(st.integers(0, count))
    found = share_interval(hits, count)
    z = float(stats.norm.ppf(0.975))
    share = hits / count
    centre = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = (z / (1 + z**2 / count)) * np.sqrt(
        share * (1 - share) / count + z**2 / (4 * count**2)
    )
    assert found.low == pytest.approx(max(centre - half, 0.0), abs=1e-12)
    assert found.high == pytest.approx(min(centre + half, 1.0), abs=1e-12)


def test_never_seen_is_not_never() -> None:
    found = share_interval(0, 50)
    assert found.estimate == 0.0
    assert 0.05 < found.high < 0.1


def test_common_draws_make_differences_sharp() -> None:
    rng = np.random.default_rng(14)
    common = rng.gamma(4.0, 10.0, 100)
    first = common + rng.normal(0, 0.5, 100)
    second = common - 2 + rng.normal(0, 0.5, 100)
    paired = mean_interval(first - second)
    assert paired.low < 2 < paired.high
    assert paired.half_width < 0.1 * mean_interval(first).half_width


def test_sampling_stops_when_the_mean_is_known_well_enough() -> None:
    rule = Precision(relative_half_width=0.02, least=20, most=500)
    sample = np.random.default_rng(5).normal(100, 10, 1000)
    enough = next(n for n in range(2, 1000) if rule.reached(sample[:n]))
    assert 60 <= enough <= 140
    assert mean_interval(sample[:enough]).relative_half_width <= 0.02
    assert not rule.reached(np.full(19, 5.0))
    assert rule.reached(np.full(20, 5.0))
    wild = np.random.default_rng(6).lognormal(0, 3, 500)
    assert not rule.reached(wild[:499])
    assert rule.reached(wild)
    assert 60 <= rule.forecast(sample[:40]) <= 160


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(TwinError, match="no replications"):
        mean_interval([])
    with pytest.raises(TwinError, match="3 of 2"):
        share_interval(3, 2)
    with pytest.raises(TwinError, match="least <= most"):
        Precision(least=30, most=20)


def test_shortcuts_are_compared_with_the_best_that_has_none() -> None:
    policies = ("sequential", "synchronous", "asynchronous", "asynchronous + shortcuts")
    experiment = Experiment(policies, replications=4)
    noise = np.array([0.0, 1.0, 2.0, 3.0])
    samples = [noise + mean for mean in (100.0, 70.0, 60.0, 45.0)]
    found = list(policy_differences(experiment, samples))
    told = [(d.policy, d.reference, d.makespan_s.estimate) for d in found]
    assert told == [
        ("synchronous", "sequential", -30.0),
        ("asynchronous", "sequential", -40.0),
        ("asynchronous + shortcuts", "sequential", -55.0),
        ("asynchronous + shortcuts", "asynchronous", -15.0),
    ]
    assert found[-1].relative == pytest.approx(-15.0 / 61.5)
    assert with_baselines("asynchronous + shortcuts") == (
        *("sequential", "asynchronous", "asynchronous + shortcuts"),
    )
    assert with_baselines("asynchronous") == ("sequential", "asynchronous")
