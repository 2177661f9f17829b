"""What opens windows is held back alike in both engines, with whatever draws, messages and limits."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scheduling.graph.test_windows import plain_times, windowed_tpg
from tests.twin.drawn_runs import VARIED
from tests.twin.driven_toys import with_limits
from tests.twin.simulated import assert_same_ends, watched
from twin.engine.bulk.bulk_engine import held_back
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.uncertainty.disturbances import Disturbances, EmergencyStop, Stalls

LATENCIES = st.sampled_from([0.0, 0.001, 0.7])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3), LATENCIES, st.floats(0.1, 0.99))
def test_engines_hold_back_to_the_same_nanosecond(
    seed: int, windows: int, latency: float, hold: float
) -> None:
    tpg = windowed_tpg(seed, windows=windows)
    model = ExecutionModel(
        VARIED,
        messages=Messages.of_seconds(1 + seed % 3, latency, latency),
        disturbances=Disturbances(
            stalls=Stalls(count_per_robot=1, duration_s=(0.5, 3))
        ),
        hold=hold,
    )
    held = held_back(tpg, model)
    assert_same_ends(held, model, seed, [0, 1, 2])
    if latency == 0.0:
        run = Simulator(held, model).run(seed=seed)
        busy = np.concatenate(run.duration_ns) + np.concatenate(run.stood_ns)
        start, end = plain_times(held, busy[:, None])
        assert np.array_equal(start, np.concatenate(run.start_ns))
        assert np.array_equal(end, np.concatenate(run.end_ns))
        seen, _ = watched(held, VARIED, seed=seed, disturbances=model.disturbances)
        assert np.array_equal(end, np.concatenate(seen.end_ns))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3))
def test_engines_agree_where_robots_keep_to_limits(seed: int, windows: int) -> None:
    tpg = windowed_tpg(seed, windows=windows)
    driven = with_limits(tpg, np.random.default_rng(seed), lambda chain, _: chain)
    model = ExecutionModel(VARIED, hold=0.9)
    assert_same_ends(held_back(driven, model), model, seed, [0, 1])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.floats(0, 20), st.floats(0.1, 20))
def test_every_run_ends_whatever_stops_it(
    seed: int, at_s: float, lasts_s: float
) -> None:
    tpg = windowed_tpg(seed, windows=3)
    stop = EmergencyStop(robot="robot_0", at_s=at_s, duration_s=lasts_s)
    model = ExecutionModel(
        VARIED, disturbances=Disturbances(emergency_stops=(stop,)), hold=0.95
    )
    run = Simulator(held_back(tpg, model), model).run(seed=seed)
    assert run.outcome == "completed"


def test_nothing_is_held_back_where_nothing_asks_for_it() -> None:
    tpg = windowed_tpg(3)
    for model in (
        ExecutionModel(VARIED),
        ExecutionModel(VARIED, "sequential", hold=0.95),
    ):
        assert held_back(tpg, model) is tpg
    assert (
        held_back(replace(tpg, windows=()), ExecutionModel(VARIED, hold=0.9)).windows
        == ()
    )
