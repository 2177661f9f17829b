"""From a scenario's file to a plan of it and a run: a module that says ``file`` has the rest.

Plans of shipped scenarios are those that all tests share.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.shipped_runs import SCENARIOS, ShippedRuns
from twin.run.folder import prepare_run_folder
from twin.scenario.manifest import load_scenario
from twin.scenario.sections.scenario import Scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult, given_plan
from twin.trial.planning import plan_scenario
from twin.trial.run_result import RunResult
from twin.trial.trial import try_plan


@pytest.fixture(scope="module")
def scenario(file: Path) -> Scenario:
    return load_scenario(file)


@pytest.fixture(scope="module")
def planned(scenario: Scenario, file: Path, shipped: ShippedRuns) -> PlanResult:
    if file.is_relative_to(SCENARIOS):
        return shipped(str(file.relative_to(SCENARIOS).with_suffix(""))).planned
    return plan_scenario(scenario, file.parent)


@pytest.fixture(scope="module")
def trial(
    scenario: Scenario,
    planned: PlanResult,
    file: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> RunResult:
    folder = tmp_path_factory.mktemp(scenario.name)
    folder = prepare_run_folder(folder / "run", scenario.name)
    return try_plan(
        given_plan(LoadedScenario(scenario, file.parent), planned.tpg),
        folder,
        recording=False,
    )
