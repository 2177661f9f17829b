"""A plan that is executed, and whose audit finds nothing."""

from __future__ import annotations

from pathlib import Path

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.scenario.sections.scenario import Scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import given_plan
from twin.trial.run_result import RunResult
from twin.trial.trial import try_plan


def executed(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    folder: Path,
    *,
    base: Path = Path(),
    recording: bool = False,
) -> RunResult:
    """Return a run of a plan, written into a folder, once everything about it is in order.

    Args:
        scenario: of the plan.
        tpg: the plan.
        folder: of the run; made where it is not there.
        base: where relative paths of the scenario start.
        recording: write it.
    """
    folder.mkdir(exist_ok=True)
    plan = given_plan(LoadedScenario(scenario, base), tpg)
    trial = try_plan(plan, folder, recording=recording)
    assert trial.summary["audit"]["violations"] == []
    assert trial.passed
    return trial
