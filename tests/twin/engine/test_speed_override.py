"""The speed override of controllers: every motion takes its time over the factor, in both engines."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.driven_toys import BENT_TPGS, DRIVEN_TPGS, driven_tpg
from tests.twin.engine.test_driven import (
    QUIET,
    assert_within_limits,
)
from tests.twin.simulated import assert_same_ends, simulate
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Uniform
from twin.engine.execution_model import ExecutionModel, Messages
from twin.runs.execution_record import ExecutionRecord, Policy
from twin.runs.trajectory import robot_trajectories
from twin.uncertainty.disturbances import (
    Disturbances,
    EmergencyStop,
    FixedFactor,
    Speed,
    UniformFactor,
)
from twin.uncertainty.skill_durations import SkillDurations
from twin.warnings.unreached_speeds import unreached_speeds

FACTORS = st.floats(0.05, 1.0, exclude_min=True)
VARYING = SkillDurations({"pick": Uniform(low_s=0.5, high_s=3.0)})


def fixed(value: float) -> Speed:
    return Speed(factor=FixedFactor(kind="fixed", value=value))


def stretches(
    tpg: TemporalPlanGraph, run: ExecutionRecord
) -> list[tuple[int, int, int]]:
    """Return the chain of each stretch, and when it begins and ends [ns]."""
    found = []
    for k, chain in enumerate(tpg.chains):
        assert chain.drive is not None
        ends = np.flatnonzero(chain.drive.rests)
        begins = np.append(0, ends[:-1] + 1)
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
            if chain.drive.ramp[begin] > 0.0:
                span = int(run.start_ns[k][begin]), int(run.end_ns[k][end])
                found.append((k, *span))
    return found


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.one_of(DRIVEN_TPGS, BENT_TPGS), FACTORS)
def test_motions_are_those_of_the_plan_with_scaled_time(
    tpg: TemporalPlanGraph, factor: float
) -> None:
    """Sampled at t / f, a motion has the configurations of the plan at t, f times its speeds, f^2 times its accelerations."""
    # Nobody waits within a stretch then.
    tpg = replace(
        tpg, edges=tpg.edges[:0], cause=tpg.cause[:0], dependencies=tpg.dependencies[:0]
    )
    plain = simulate(tpg)
    slow = simulate(tpg, disturbances=Disturbances(speed=fixed(factor)))
    pairs = list(zip(stretches(tpg, plain), stretches(tpg, slow), strict=True))
    before, after = robot_trajectories(tpg, plain), robot_trajectories(tpg, slow)
    for (k, begin, end), (_, starts, ends) in pairs:
        nodes = len(tpg.chains[k])
        assert abs((ends - starts) - (end - begin) / factor) <= 2 * nodes + 2 / factor
        t = np.linspace(0.02, 0.98, 25) * (end - begin)
        own = np.rint(t).astype(np.int64)
        q, v, a = before[k].states_at(begin + own)
        scaled = starts + np.rint(own / factor).astype(np.int64)
        found = after[k].states_at(scaled)
        assert found[0] == pytest.approx(q, abs=1e-7)
        assert found[1] == pytest.approx(factor * v, abs=1e-5)
        # Accelerations are continuous, but bend at the borders of pieces.
        assert np.median(np.abs(found[2] - factor**2 * a)) < 1e-5
    assert_within_limits(tpg, slow)


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.one_of(DRIVEN_TPGS, BENT_TPGS),
    st.sampled_from(["asynchronous", "sequential", "open-loop"]),
    st.floats(0.05, 1.5),
    st.booleans(),
    QUIET,
    st.integers(0, 10**6),
)
def test_engines_agree(
    tpg: TemporalPlanGraph,
    policy: Policy,
    factor: float,
    drawn: bool,
    quiet: Disturbances,
    seed: int,
) -> None:
    speed = fixed(factor)
    if drawn:
        one = UniformFactor(kind="uniform", low=0.5 * factor, high=factor)
        speed = Speed(robots={tpg.chains[0].robot: one})
    model = ExecutionModel(VARYING, policy, disturbances=quiet.changed(speed=speed))
    assert_same_ends(tpg, model, seed, range(3))


@settings(max_examples=16, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.one_of(DRIVEN_TPGS, BENT_TPGS), FACTORS, QUIET, st.integers(0, 10**6))
def test_robots_stay_within_what_is_released_and_within_limits(
    tpg: TemporalPlanGraph, factor: float, quiet: Disturbances, seed: int
) -> None:
    """Also with late messages, and with stops by the clock, for which they brake at the scaled rates."""
    stop = EmergencyStop(at_s=1.0, duration_s=0.7)
    messages = Messages.of_seconds(2, 0.05, 0.05)
    disturbances = quiet.changed(speed=fixed(factor), emergency_stops=(stop,))
    run = simulate(
        tpg, VARYING, seed=seed, messages=messages, disturbances=disturbances
    )
    assert run.outcome == "completed"
    assert_within_limits(tpg, run)


@pytest.mark.parametrize("factor", [1.0, 1.5, 4.0, 1000.0])
def test_limits_are_kept_above_1(factor: float) -> None:
    tpg = driven_tpg(3)
    plain = simulate(tpg)
    quick = simulate(tpg, disturbances=Disturbances(speed=fixed(factor)))
    for before, after in zip(plain.end_ns, quick.end_ns, strict=True):
        assert np.array_equal(before, after)
    assert_within_limits(tpg, quick)


def test_a_factor_that_limits_do_not_allow_is_reported_with_what_is_reached() -> None:
    tpg = driven_tpg(3)
    disturbances = Disturbances(speed=fixed(4.0))
    found = unreached_speeds(tpg, disturbances, 0)
    moving = [c for c in tpg.chains if c.drive is not None and c.drive.ramp.any()]
    assert moving
    for chain, words in zip(moving, found, strict=True):
        assert words.startswith(f"speed.factor of {chain.robot}: 4 times")
        assert "1 times is reached" in words
        assert any(n in words for n in tpg.cell.robot(chain.robot).model.joint_names)
    for factor in (0.3, 1.0):
        assert unreached_speeds(tpg, Disturbances(speed=fixed(factor)), 0) == ()


def test_without_limits_of_acceleration_speed_limits_bound_the_factor() -> None:
    """The factor that is told is that of the simulated durations."""
    tpg = random_tpg(5, tasks=6)
    disturbances = Disturbances(speed=fixed(1000.0))
    run = simulate(tpg, disturbances=disturbances)
    plain = simulate(tpg)
    for k, words in enumerate(unreached_speeds(tpg, disturbances, 0)):
        chain = tpg.chains[k]
        moves = ~chain.skill
        reached = plain.duration_ns[k][moves].sum() / run.duration_ns[k][moves].sum()
        assert f", {reached:.3g} times is reached" in words
    assert unreached_speeds(tpg, Disturbances(), 0) == ()
