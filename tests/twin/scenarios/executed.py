"""Plans that are executed, and whose audit finds nothing."""

from pathlib import Path

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.verify import verify_plan
from tests.twin.written import Change, checked, written
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.scenario import Scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult, given_plan
from twin.trial.planning import plan_scenario
from twin.trial.run_plan import run_plan_to_folder
from twin.trial.run_result import RunResult


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
    trial = run_plan_to_folder(plan, folder, recording=recording)
    assert trial.summary["audit"]["violations"] == []
    assert trial.passed
    return trial


def built(
    folder: Path, text: str, *changes: Change, recording: bool = False
) -> PlanResult:
    """Return the plan of a cell, once check, proof and the audit of its run are content."""
    file = written(folder, text, *changes)
    assert [item.message for item in checked(file).errors] == []
    scenario = load_scenario(file)
    planned = plan_scenario(scenario, folder)
    assert verify_plan(planned.tpg).problems == ()
    run = folder / "run"
    executed(scenario, planned.tpg, run, base=folder, recording=recording)
    return planned
