"""Recovery is a function: of a state and what has happened, without a simulation."""

from collections.abc import Mapping

import pytest
import simpy

from scheduling.graph.plan_files import plan_sha256
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import with_full_speed_times
from tests.twin.simulated import NOMINAL
from twin.operations.commitment import Failure, ReplanTrigger
from twin.operations.person import Person
from twin.operations.recovery import Recovery
from twin.trial.plan_result import PlanResult
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.draws import TaskName
from twin.uncertainty.node_times import NodeTimes, NodeTimeSampler


def recovery(plan: PlanResult) -> Recovery:
    def draw(graph: TemporalPlanGraph, names: Mapping[int, TaskName]) -> NodeTimes:
        times = with_full_speed_times(graph), NOMINAL, Disturbances(), names
        return NodeTimeSampler(*times).sample(seed=0)

    scenario = plan.scenario.sections
    return Recovery(scenario, plan.motions, plan.tpg, draw, Person(None, 0))


def lost_at_the_first_pick(tpg: TemporalPlanGraph) -> ReplanTrigger:
    pick = next(task for task in tpg.tasks if task.kind == "pick")
    chain = tpg.chain_index[pick.robot]
    node = tpg.chains[chain].task.tolist().index(pick.index)
    released = [0] * len(tpg.chains)
    released[chain] = node + 1
    failed = (Failure(chain, node, lost=True),)
    return ReplanTrigger(failed, frozenset(), frozenset(), tuple(released))


def test_a_failure_gives_a_revision_and_changes_no_state(
    plan: PlanResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(simpy, "Environment")
    planner, trigger = recovery(plan), lost_at_the_first_pick(plan.tpg)
    before = planner.with_measure(planner.initial, events=2)
    after, revision = planner.recover(before, trigger)
    (failure,) = trigger.failures
    assert revision.counts[failure.chain] == failure.node + 1
    assert plan_sha256(revision.tpg) != plan_sha256(plan.tpg)
    assert "failed" in revision.cause
    assert before.measure is not None
    assert after.measure is not None
    assert after.measure.is_below(before.measure)
    lost = plan.tpg.task_at(failure.chain, failure.node).object
    assert after.ledger.gone == {lost}
    assert before.ledger.gone == set()
    # So the same state may be recovered from once more.
    _, again = planner.recover(before, trigger)
    assert plan_sha256(again.tpg) == plan_sha256(revision.tpg)
