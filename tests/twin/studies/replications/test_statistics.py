"""Intervals against scipy, against enumeration, and by how often they cover the truth."""

from collections.abc import Callable
from fractions import Fraction
from math import ceil, comb

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats

from planning.errors import TwinError
from planning.transforms import Array
from twin.studies.plans import with_baselines
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.statistics import (
    Interval,
    Precision,
    mean_bounds,
    mean_interval,
    order_ranks,
    quantile_interval,
    share_interval,
)
from twin.studies.summary import policy_differences


def test_a_symmetric_sample_has_students_interval() -> None:
    half = np.random.default_rng(0).normal(size=12)
    sample = 5.0 + np.concatenate([half, [0.0], -half])
    found = mean_interval(sample, confidence=0.9)
    oracle = stats.ttest_1samp(sample, 0.0).confidence_interval(0.9)
    assert found.estimate == pytest.approx(sample.mean())
    assert (found.low, found.high) == pytest.approx((oracle.low, oracle.high))
    assert found.count == 25


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.floats(0.0, 1e4), min_size=3, max_size=40),
    st.sampled_from((0.8, 0.95, 0.999)),
)
def test_the_mean_has_the_union_of_two_intervals(
    values: list[float], confidence: float
) -> None:
    sample = np.array(values)
    assume(sample.std() > 1e-3)
    n, error = len(sample), float(stats.sem(sample))
    t = stats.t.ppf(0.5 + 0.5 * confidence, n - 1)
    g = float(stats.skew(sample, bias=False))

    def transformed(w: float) -> float:
        # Hall (1992): monotone, so bisection inverts it
        bent = g * w**2 / 3 / n**0.5 + g**2 * w**3 / 27 / n
        return float(w + bent + g / 6 / n**0.5)

    limits = []
    for side in (t, -t):
        low, high = -1e9, 1e9
        for _ in range(200):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if transformed(middle) < side else (low, middle)
        limits.append(sample.mean() - low * error)
    found = mean_interval(sample, confidence=confidence)
    expected_low = min(limits[0], sample.mean() - t * error)
    expected_high = max(limits[1], sample.mean() + t * error)
    assert found.low == pytest.approx(expected_low, rel=1e-6, abs=1e-6 * t * error)
    assert found.high == pytest.approx(expected_high, rel=1e-6, abs=1e-6 * t * error)


def test_bounds_are_told_with_what_they_need() -> None:
    open_above = Interval(9.0, 8.0, np.inf, 20, 368)
    assert (
        open_above.bounds()
        == "at least 8.0; 368 replications needed for an upper limit"
    )
    assert open_above.half_width == np.inf
    assert open_above.content() == {
        **{"estimate": 9.0, "low": 8.0, "high": None, "count": 20},
        "replications_needed": 368,
    }
    open_below = Interval(9.0, -np.inf, 9.5, 3, 6)
    assert open_below.bounds("{:.2f}".format, 10.0) == (
        "at most 95.00; 6 replications needed for a lower limit"
    )
    assert Interval(9.0, 8.0, 9.5, 20).bounds() == "8.0 to 9.5"
    assert "replications_needed" not in Interval(9.0, 8.0, 9.5, 20).content()
    assert mean_interval([3.0]).bounds() == "2 replications needed for limits"
    assert Interval(1.0, -np.inf, np.inf, 0).bounds() == ""


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


def _below(n: int, p: Fraction) -> list[Fraction]:
    """Return the probability that k of n values are at or below a quantile, k = 0 to n."""
    return [comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(n + 1)]


@pytest.mark.parametrize("percent", [50, 90, 95, 99])
@pytest.mark.parametrize("confidence", ["0.91", "0.95", "0.997"])
def test_quantiles_lie_between_the_closest_order_statistics(
    percent: int, confidence: str
) -> None:
    tail, p = (1 - Fraction(confidence)) / 2, Fraction(percent, 100)
    for n in (1, 2, 5, 6, 20, 35, 36, 50, 90):
        chances = _below(n, p)
        # The r-th smallest value is above the quantile where at most r - 1 are at or below it.
        low = max((r for r in range(1, n + 1) if sum(chances[:r]) <= tail), default=0)
        high = min((r for r in range(1, n + 1) if sum(chances[r:]) <= tail), default=0)
        found = quantile_interval(
            np.arange(n, 0.0, -1.0), percent / 100, confidence=float(confidence)
        )
        assert found.low == (low or -np.inf)
        assert found.high == (high or np.inf)
        assert found.estimate == max(1, ceil(p * n))
        inside = sum(chances[low : high or n + 1])
        assert inside >= Fraction(confidence)
        assert (found.replications_needed is None) == bool(low and high)


@pytest.mark.parametrize(
    ("percent", "needed"), [(50, 6), (90, 36), (95, 72), (99, 368)]
)
def test_open_sides_tell_how_many_replications_close_them(
    percent: int, needed: int
) -> None:
    larger = Fraction(max(percent, 100 - percent), 100)
    assert larger**needed <= Fraction(25, 1000) < larger ** (needed - 1)
    short = quantile_interval(np.arange(needed - 1.0), percent / 100)
    assert short.replications_needed == needed
    assert short.high == np.inf
    enough = quantile_interval(np.arange(float(needed)), percent / 100)
    assert enough.replications_needed is None
    assert np.isfinite(enough.half_width)


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


Draw = Callable[[np.random.Generator, tuple[int, ...]], Array]


def _normal(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    return rng.normal(100.0, 5.0, shape)


def _makespan(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Two robots with six lognormal stages and stalls of 1 to 20 s each; the later one ends the run."""
    ends = []
    for _ in range(2):
        end = rng.lognormal(np.log(5.0), 0.3, (6, *shape)).sum(axis=0)
        stalls = rng.poisson(0.7, shape)
        for k in range(4):
            end += np.where(stalls > k, rng.uniform(1.0, 20.0, shape), 0.0)
        ends.append(end)
    first, second = ends
    return np.asarray(np.maximum(first, second))


def _stalled(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Whole seconds with a stall of 10 s in 15 % of the replications: ties, and two modes."""
    return (
        30.0 + rng.normal(0.0, 1.0, shape).round() + 10.0 * (rng.random(shape) < 0.15)
    )


DRAWS: dict[str, Draw] = {
    "normal": _normal,
    "makespan": _makespan,
    "exponential": lambda rng, shape: rng.exponential(1.0, shape),
    "stalled": _stalled,
}
SHARES = (0.5, 0.9, 0.95, 0.99)


def _coverages(
    name: str, counts: tuple[int, ...], trials: int
) -> dict[str, list[float]]:
    """Return how often intervals of the mean and of quantiles cover the truth, by sample size."""
    rng, draw = np.random.default_rng(11), DRAWS[name]
    truth = np.concatenate([draw(rng, (500_000,)) for _ in range(4)])
    quantiles = np.quantile(truth, SHARES, method="inverted_cdf")
    found: dict[str, list[float]] = {}
    for n in counts:
        mean, between = [], [list[bool]() for _ in SHARES]
        for _ in range(0, trials, 1000):
            samples = np.sort(draw(rng, (1000, n)), axis=1)
            low, high = mean_bounds(samples, 0.95)
            mean += ((low <= truth.mean()) & (truth.mean() <= high)).tolist()
            for own, p, value in zip(between, SHARES, quantiles, strict=True):
                first, last = order_ranks(n, p, 0.025)
                below = samples[:, first - 1] <= value if first else True
                above = samples[:, last - 1] >= value if last <= n else True
                own += np.broadcast_to(below & np.asarray(above), 1000).tolist()
        found.setdefault("mean", []).append(float(np.mean(mean)))
        for own, p in zip(between, SHARES, strict=True):
            found.setdefault(f"P{100 * p:.0f}", []).append(float(np.mean(own)))
    return found


@pytest.mark.parametrize("name", DRAWS)
def test_intervals_cover_what_they_say(name: str) -> None:
    for what, shares in _coverages(name, (20, 100), 2000).items():
        error = 4.0 * (0.05 * 0.95 / 2000) ** 0.5
        assert min(shares) >= 0.95 - error, (what, shares)


@pytest.mark.nightly
@pytest.mark.parametrize("name", DRAWS)
def test_intervals_cover_what_they_say_for_all_sizes(name: str) -> None:
    trials = 20_000
    error = 3.0 * (0.05 * 0.95 / trials) ** 0.5
    found = _coverages(name, (20, 50, 100, 200, 400, 1000), trials)
    for what, shares in found.items():
        # The mean's interval holds within 1 %, those of quantiles in any sample size.
        assert min(shares) >= (0.94 if what == "mean" else 0.95) - error, (what, shares)


@pytest.mark.nightly
@pytest.mark.parametrize("name", DRAWS)
def test_stopping_at_a_precision_costs_little_coverage(name: str) -> None:
    rng, draw = np.random.default_rng(12), DRAWS[name]
    truth = float(np.mean([draw(rng, (500_000,)).mean() for _ in range(4)]))
    spread = float(draw(rng, (10_000,)).std()) / truth
    # The precision is one that some tens to hundreds of replications reach.
    rule = Precision(relative_half_width=0.25 * spread, least=20, most=10_000)
    targets = list(Experiment(("sequential",), precision=rule).targets())
    hits, trials = 0, 4000
    for _ in range(trials):
        sample = draw(rng, (targets[-1] // 10,))
        count = next(n for n in targets if rule.reached(sample[:n]))
        found = mean_interval(sample[:count])
        hits += found.low <= truth <= found.high
    assert hits / trials >= 0.92


def test_mirrored_pairs_keep_the_coverage_of_quantiles() -> None:
    """Makespans that rise with every draw: their pairs are mirror images."""
    rng, n = np.random.default_rng(13), 100
    u = rng.random((4000, n // 2, 3))
    samples = np.stack([-np.log1p(-v).sum(axis=2) for v in (u, 1.0 - u)], axis=2)
    ordered = np.sort(samples.reshape(len(u), n), axis=1)
    for p in (0.5, 0.9, 0.95):
        truth = stats.gamma.ppf(p, 3)
        first, last = order_ranks(n, p, 0.025)
        inside = (ordered[:, first - 1] <= truth) & (truth <= ordered[:, last - 1])
        assert inside.mean() >= 0.95
