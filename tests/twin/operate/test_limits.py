"""Graphs that are extended while robots pass borders at speed, within their limits."""

from __future__ import annotations

import pytest

from twin.operate.operation import operate
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_to_operate
from twin.trial.simulation import scenario_execution


@pytest.fixture(scope="module")
def plan() -> PlanResult:
    return plan_to_operate(load("taskboard"))


@pytest.mark.nightly
def test_what_follows_a_rest_begins_when_the_motion_before_has_ended(
    plan: PlanResult,
) -> None:
    """A robot waits in the middle of a way, and is given one there that has a corner at once."""
    case = plan.scenario.varied({"outages": [{"robot": "back", "at_s": 1.416}]})
    model = scenario_execution(case.sections, case.folder)
    done = operate(case.sections, plan.motions, plan.tpg, model, seed=0)
    for chain, start, end in zip(
        done.tpg.chains, done.record.start_ns, done.record.end_ns, strict=True
    ):
        assert chain.drive is not None
        rests = chain.drive.rests[:-1]
        assert (start[1:][rests] >= end[:-1][rests]).all()
        assert (start >= 0).all()
