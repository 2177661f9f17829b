"""From a scenario's file to a plan of it and a run: a module that says ``file`` has the rest."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin.planning.pipeline import Planned, plan_scenario
from twin.run.folder import prepare_run_folder
from twin.scenario.file import load_scenario
from twin.scenario.sections.scenario import Scenario
from twin.trial.trial import Trial, try_plan


@pytest.fixture(scope="module")
def scenario(file: Path) -> Scenario:
    return load_scenario(file)


@pytest.fixture(scope="module")
def planned(scenario: Scenario, file: Path) -> Planned:
    return plan_scenario(scenario, file.parent)


@pytest.fixture(scope="module")
def trial(
    scenario: Scenario,
    planned: Planned,
    file: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> Trial:
    folder = tmp_path_factory.mktemp(scenario.name)
    folder = prepare_run_folder(folder / "run", scenario.name)
    return try_plan(scenario, planned.tpg, folder, base=file.parent, recording=False)
