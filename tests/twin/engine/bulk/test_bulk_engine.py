"""The two engines are one truth: equal to the nanosecond in every replication."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import PlanInvariantError
from scheduling.graph.task_edges import sequential_order
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.simulated import assert_same_ends, run_bulk
from tests.twin.twin_toys import random_tpg, with_cut_skill
from twin.durations.bounded import Uniform
from twin.durations.normal import Lognormal
from twin.engine.bulk.bulk_engine import BulkEngine
from twin.engine.engine import Simulator
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


def test_turns_are_taken_in_the_order_of_the_event_engine() -> None:
    tpg = random_tpg(11, dofs=(2, 3, 2), tasks=10, edges=12)
    model = ExecutionModel(SkillDurations({}), "sequential")
    run = Simulator(tpg, model).run(seed=0)
    starts, ends = np.concatenate(run.start_ns), np.concatenate(run.end_ns)
    order = list(sequential_order(tpg))
    assert sorted(order) == list(range(len(starts)))
    assert np.all(np.diff(starts[order]) >= 0)
    assert np.all(starts[order][1:] == ends[order][:-1])


def test_open_loop_waits_for_the_clock_alone() -> None:
    tpg = random_tpg(6, dofs=(2, 2), edges=10)
    late = SkillDurations({"pick": Uniform(low_s=50.0, high_s=60.0)})
    own_clock = BulkEngine(tpg, ExecutionModel(late, "open-loop"))
    found = run_bulk(own_clock, seed=0, replications=[0])
    planned = BulkEngine(tpg, ExecutionModel(SkillDurations({})))
    nominal = run_bulk(planned, seed=0, replications=[0])
    assert np.all(found.start_ns >= nominal.start_ns)
    own_way = BulkEngine(tpg, ExecutionModel(SkillDurations({}), "open-loop"))
    assert run_bulk(own_way, seed=0, replications=[0]).end_ns.tolist() == (
        nominal.end_ns.tolist()
    )


def test_replications_do_not_know_of_each_other() -> None:
    tpg = random_tpg(8, dofs=(2, 2, 2), edges=12)
    engine = BulkEngine(tpg, ExecutionModel(DURATIONS))
    together = run_bulk(engine, seed=2, replications=range(200)).makespan_ns
    apart = [
        run_bulk(engine, seed=2, replications=[r]).makespan_ns[0]
        for r in (0, 63, 64, 199)
    ]
    assert together[[0, 63, 64, 199]].tolist() == apart
