"""Graphs that are extended while robots pass borders at speed, within their limits."""

from __future__ import annotations

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.invariant import check_invariant
from twin.operate.operation import operate
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_to_operate
from twin.trial.simulation import scenario_execution


@pytest.fixture(scope="module")
def plan() -> PlanResult:
    return plan_to_operate(load("taskboard"))


# Without ``back`` much is tried and given up.
@pytest.mark.nightly
# The way of ``right`` goes on around a corner by then, in place of straight ahead.
@example(at_s=1.416)
@settings(max_examples=4, deadline=None)
@given(at_s=st.floats(0.7, 2.4))
def test_what_follows_a_rest_begins_when_the_motion_before_has_ended(
    plan: PlanResult, at_s: float
) -> None:
    """A robot that waits in the middle of a way is given another one there."""
    case = plan.scenario.varied({"outages": [{"robot": "back", "at_s": at_s}]})
    model = scenario_execution(case.sections, case.folder)
    done = operate(case.sections, plan.motions, plan.tpg, model, seed=0)
    check_invariant(DerivedTpg(done.tpg))
    for chain, start, end in zip(
        done.tpg.chains, done.record.start_ns, done.record.end_ns, strict=True
    ):
        assert chain.drive is not None
        rests = chain.drive.rests[:-1]
        assert (start[1:][rests] >= end[:-1][rests]).all()
        assert (start >= 0).all()
