"""The two engines are one truth: equal to the nanosecond in every replication."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import PlanInvariantError
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.simulated import assert_same_ends, run_bulk
from tests.twin.twin_toys import random_tpg, with_cut_skill
from twin.durations.bounded import Uniform
from twin.durations.normal import Lognormal
from twin.engine.bulk.bulk_engine import BulkEngine
from twin.engine.execution_model import ExecutionModel
from twin.run.events import Policy
from twin.uncertainty.disturbances import Disturbances, FixedFactor, Speed
from twin.uncertainty.skill_durations import SkillDurations

DURATIONS = SkillDurations(
    {
        "pick": Uniform(low_s=0.2, high_s=5.0),
        "place-down": Lognormal(median_s=2.0, p95_s=9.0),
    }
)


def _in_slots(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    """Give every robot's k-th pair of tasks the same slot."""
    slots = np.zeros(len(tpg.tasks), dtype=np.int64)
    for chain in tpg.chains:
        for place, task in enumerate(dict.fromkeys(chain.task.tolist())):
            slots[task] = place // 2
    none = np.empty((0, 4), dtype=np.int64)
    return replace(tpg, slots=slots, edges=none, cause=np.empty(0, dtype=np.uint8))


@settings(max_examples=50, deadline=None)
@given(
    st.integers(0, 10**6),
    st.integers(1, 4),
    st.sampled_from(["asynchronous", "sequential", "open-loop"]),
    st.sampled_from([0.5, 1.0, 2.0]),
    st.booleans(),
)
def test_engines_agree_to_the_nanosecond(
    seed: int, robots: int, policy: Policy, speed: float, cut: bool
) -> None:
    """Whoever is early by the planned clock waits for it in every node."""
    edges = 10 if robots > 1 and not cut else 0
    tpg = random_tpg(seed, dofs=(2,) * robots, edges=edges)
    tpg = with_cut_skill(tpg) if cut else tpg
    factor = FixedFactor(kind="fixed", value=speed)
    quick = Disturbances(speed=Speed(factor=factor) if speed != 1.0 else Speed())
    model = ExecutionModel(DURATIONS, policy, disturbances=quick)
    assert_same_ends(tpg, model, seed, range(5, 9))


def test_engines_agree_in_slots() -> None:
    tpg = _in_slots(random_tpg(3, dofs=(2, 2, 2), tasks=12, edges=4))
    model = ExecutionModel(DURATIONS, "synchronous")
    found = assert_same_ends(tpg, model, 1, range(8)).makespan_ns
    asynchronous = BulkEngine(tpg, ExecutionModel(DURATIONS))
    assert np.any(
        run_bulk(asynchronous, seed=1, replications=range(8)).makespan_ns < found
    )


def test_slots_are_asked_for() -> None:
    with pytest.raises(PlanInvariantError, match="not made in slots"):
        BulkEngine(random_tpg(0), ExecutionModel(DURATIONS, "synchronous"))


def test_replications_do_not_know_of_each_other() -> None:
    tpg = random_tpg(8, dofs=(2, 2, 2), edges=12)
    engine = BulkEngine(tpg, ExecutionModel(DURATIONS))
    together = run_bulk(engine, seed=2, replications=range(200)).makespan_ns
    apart = [
        run_bulk(engine, seed=2, replications=[r]).makespan_ns[0]
        for r in (0, 63, 64, 199)
    ]
    assert together[[0, 63, 64, 199]].tolist() == apart
