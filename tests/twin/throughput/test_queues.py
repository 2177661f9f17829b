"""Lines against formulas of queueing theory, and against Ciw."""

from math import factorial

import ciw
import numpy as np
import pytest

from tests.twin.simulated import simulate
from tests.twin.throughput.queues import (
    Service,
    line_tpg,
    queue,
    replicate,
    two_machines,
)
from twin.durations.bounded import Fixed, Uniform
from twin.durations.lifetimes import Exponential
from twin.studies.replications.statistics import mean_interval
from twin.throughput.states import State, run_worker_times
from twin.throughput.throughput import line_figures, seconds
from twin.uncertainty.disturbances import Breakdowns, Disturbances

CONFIDENCE = 0.999
"""Of intervals that have to hold what a formula says; draws are the same in every run of the tests."""

AT_ONCE = Fixed(value_s=0.0)


def assert_covers(values: np.ndarray, expected: float, precision: float) -> None:
    """Check that the interval of a mean holds a value, and is not so wide that any would be in it."""
    found = mean_interval(values, confidence=CONFIDENCE)
    assert found.low <= expected <= found.high, (found, expected)
    assert found.half_width < precision * expected


def test_a_queue_agrees_with_the_formulas_of_m_m_1() -> None:
    """Arrivals every 2 s, service of 1 s: half of the time, 1 customer and 2 s in the mean."""
    durations = {
        "arrive": Exponential(mean_s=2.0),
        "serve": Exponential(mean_s=1.0),
        "enter": AT_ONCE,
    }
    found = replicate(line_tpg(queue(600)), durations, 200)
    line = line_figures(found.times, start_up=100)
    assert_covers(line.cycle_time_s, 2.0, 0.05)
    assert_covers(line.work_in_progress, 1.0, 0.06)
    assert_covers(line.throughput_per_h, 1800.0, 0.02)
    assert_covers(found.shares["server"][State.WORKING], 0.5, 0.02)
    # Little's law for the estimates: both sides are estimated from the same customers.
    gap = line.work_in_progress - line.throughput_per_h / 3600 * line.cycle_time_s
    assert abs(gap.mean()) < 3.3 * gap.std() / np.sqrt(len(gap)) + 0.005


@pytest.mark.parametrize("buffer", [0, 3])
def test_two_machines_with_a_buffer_agree_with_their_formula(buffer: int) -> None:
    """Services of 1 s, exponential: a share of 1 / (buffer + 3) is lost, to blocking and to starving."""
    durations = dict.fromkeys(("drill", "work"), Exponential(mean_s=1.0))
    tpg = line_tpg(two_machines(500, buffer, gate=False))
    found = replicate(tpg, {**durations, "pick": AT_ONCE}, 100)
    line, lost = line_figures(found.times, start_up=50), 1 / (buffer + 3)
    assert_covers(line.throughput_per_h, 3600 * (1 - lost), 0.03)
    assert_covers(found.shares["first"][State.BLOCKED], lost, 0.1)
    assert_covers(found.shares["second"][State.STARVED], lost, 0.1)
    assert found.shares["first"][State.STARVED].max() == 0.0
    # The work of a station by product is what its utilisation makes of the time by product.
    for name in ("first", "second"):
        busy_s = found.shares[name][State.WORKING] * found.makespan_s / 500
        assert_covers(busy_s, 1.0, 0.02)


def test_a_bottleneck_is_used_as_the_takt_says() -> None:
    """A slow station behind a quick one with many places: the takt is its time, and it always works."""
    durations = {"drill": Uniform(low_s=0.2, high_s=0.8), "pick": AT_ONCE}
    durations["work"] = Uniform(low_s=0.5, high_s=1.5)
    found = replicate(line_tpg(two_machines(400, 20, gate=False)), durations, 20)
    line = line_figures(found.times)
    assert_covers(line.takt_s, 1.0, 0.02)
    used = found.shares["second"][State.WORKING]
    # All products but the first are counted by the takt, and no time is lost between them.
    assert used * found.makespan_s == pytest.approx(400 * line.takt_s, rel=0.004)
    assert used.min() > 0.99
    assert_covers(found.shares["first"][State.WORKING], 0.5, 0.02)


def test_little_s_law_is_an_identity_where_all_are_inside() -> None:
    """From the first begin to the last completion, in whole nanoseconds, by counting at every change."""
    durations = {"arrive": Exponential(mean_s=2.0), "serve": Uniform(low_s=1, high_s=2)}
    found = replicate(line_tpg(queue(60)), {**durations, "enter": AT_ONCE}, 3)
    begin, end = found.times.product_begin_ns, found.times.product_end_ns
    line = line_figures(found.times)
    for r in range(3):
        changes = sorted([(t, 1) for t in begin[:, r]] + [(t, -1) for t in end[:, r]])
        inside, area, window = 0, 0, 0
        for (t, step), (later, _) in zip(
            changes, [*changes[1:], changes[-1]], strict=True
        ):
            inside += step
            area += inside * (later - t)
            window += (
                inside * (later - max(t, end[:, r].min())) * (later > end[:, r].min())
            )
        assert area == (end - begin)[:, r].sum()
        span = seconds(end[:, r].max() - end[:, r].min())
        assert line.work_in_progress[r] == pytest.approx(window / 1e9 / span, rel=1e-12)


def test_machines_that_share_one_repairer_are_down_as_m_m_1_3_says() -> None:
    machines = {
        name: [Service("run", 0, (), None, 1e5)] for name in ("one", "two", "three")
    }
    breaks = Breakdowns(mtbf_s=300, mttr_s=200, clock="run")
    tpg = line_tpg(machines)
    runs = [
        simulate(
            tpg,
            disturbances=Disturbances(breakdowns=breaks, repair_people=1),
            replication=r,
        )
        for r in range(10)
    ]
    found = [run_worker_times(tpg, run) for run in runs]
    shares = [own.shares_and_factors(np.ones(1))[State.DOWN].sum() for own in found]
    for own, run in zip(found, runs, strict=True):
        assert (own.state_ns.sum(axis=1) == run.makespan_ns).all()
    weights = [(2 / 3) ** k * factorial(3) / factorial(3 - k) for k in range(4)]
    expected = sum(k * w for k, w in enumerate(weights)) / sum(weights)
    assert_covers(np.array(shares), expected, 0.1)


def test_a_line_with_one_place_between_its_stations_agrees_with_ciw() -> None:
    """No formula: arrivals at random, uniform services, one place, blocking after service."""
    drill, work, gap = (0.5, 1.1), (0.4, 1.2), 1.25
    durations = {
        "arrive": Exponential(mean_s=gap),
        "drill": Uniform(low_s=drill[0], high_s=drill[1]),
        "work": Uniform(low_s=work[0], high_s=work[1]),
        **dict.fromkeys(("enter", "pick"), AT_ONCE),
    }
    found = replicate(line_tpg(two_machines(300, 1, gate=True)), durations, 100)
    line = line_figures(found.times, start_up=50)
    own = mean_interval(line.cycle_time_s, confidence=CONFIDENCE)
    network = ciw.create_network(
        arrival_distributions=[ciw.dists.Exponential(1 / gap), None],
        service_distributions=[ciw.dists.Uniform(*drill), ciw.dists.Uniform(*work)],
        routing=[[0.0, 1.0], [0.0, 0.0]],
        number_of_servers=[1, 1],
        queue_capacities=[float("inf"), 1],
    )
    means = []
    for seed in range(40):
        ciw.seed(seed)
        oracle = ciw.Simulation(network)
        oracle.simulate_until_max_customers(300, method="Finish")
        records = oracle.get_all_records()
        begin = {r.id_number: r.arrival_date for r in records if r.node == 1}
        end = {r.id_number: r.exit_date for r in records if r.node == 2}
        done = sorted(end)[50:]
        means.append(np.mean([end[k] - begin[k] for k in done]))
    other = mean_interval(means, confidence=CONFIDENCE)
    assert own.half_width < 0.1 * own.estimate
    assert abs(own.estimate - other.estimate) < np.hypot(
        own.half_width, other.half_width
    )
