"""From the ``SCENARIO`` of a module to its file, a plan of it and a clean run."""

from pathlib import Path

import pytest

from tests.twin.scenarios.executed import executed
from tests.twin.written import written
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.run_result import RunResult


@pytest.fixture(scope="module")
def file(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    return written(tmp_path_factory.mktemp("cell"), request.module.SCENARIO)


@pytest.fixture(scope="module")
def scenario(file: Path) -> Scenario:
    return load_scenario(file)


@pytest.fixture(scope="module")
def planned(scenario: Scenario, file: Path) -> PlanResult:
    return plan_scenario(scenario, file.parent)


@pytest.fixture(scope="module")
def trial(
    scenario: Scenario,
    planned: PlanResult,
    file: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> RunResult:
    out = tmp_path_factory.mktemp("run")
    return executed(scenario, planned.tpg, out, base=file.parent)
