"""What a plan would have taken that knew from the beginning what would be lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.twin.operations.operated import gone
from twin.operations.operation import Operation, operate
from twin.operations.replicated.hindsight import Hindsight
from twin.trial.plan_result import PlanResult
from twin.trial.simulation import execute, scenario_execution

ITEM = {"probability": 0.2, "retries": 1, "loses": 0.3}
FAILING = {"failures.pick": ITEM, "failures.place-down": ITEM}


def lost(done: Operation) -> set[str]:
    return gone(done)


@pytest.mark.nightly
def test_it_does_without_what_is_lost_and_never_fails_for_good(
    plan: PlanResult,
) -> None:
    case = plan.scenario.varied(FAILING)
    model = scenario_execution(case.sections)
    hindsight = Hindsight(case.sections, plan.motions, plan.tpg, model)
    patient = {"probability": 0.2, "retries": 1000, "loses": 0.0}
    sure = plan.scenario.varied(dict.fromkeys(FAILING, patient))
    seen = set()
    for seed in range(40):
        done = operate(case.sections, plan.motions, plan.tpg, model, seed=seed)
        if not done.versions or done.given_up:
            continue
        knew = hindsight.makespan_ns(done)
        gone = lost(done)
        if not gone:
            # The same plan, in which every skill is tried until it is done.
            again = execute(sure.varied({"seed": seed}).sections, plan.tpg, Path())
            assert knew == again.makespan_ns
            seen.add("nothing")
            continue
        simulator = hindsight._known[frozenset(gone)]
        assert simulator is not None
        used = {task.object for task in simulator.tpg.tasks}
        assert not gone & used
        placed = [t.step for t in simulator.tpg.tasks if t.kind == "place-down"]
        assert sorted(placed) == [1, 2, 3, 4]
        # Whoever executes it anew gets the same.
        record = simulator.run(seed=seed)
        assert (record.outcome, record.makespan_ns) == ("completed", knew)
        seen.add("something")
        if seen == {"nothing", "something"}:
            return
    assert seen == {"nothing", "something"}


def test_nobody_knows_where_steps_are_given_up_or_robots_are_out(
    plan: PlanResult,
) -> None:
    outages = [{"robot": "right", "at_s": 20.0}]
    for values in ({"outages": outages}, {**FAILING, "recovery.again": 0}):
        case = plan.scenario.varied(values)
        model = scenario_execution(case.sections)
        hindsight = Hindsight(case.sections, plan.motions, plan.tpg, model)
        for seed in range(20):
            done = operate(case.sections, plan.motions, plan.tpg, model, seed=seed)
            if done.given_up or done.out:
                assert hindsight.makespan_ns(done) is None
                break
        else:
            pytest.fail("nothing ever fails")
