"""Function that makes the page of a scenario, a plan or a run."""

from __future__ import annotations

from pathlib import Path

from twin.api.runs import simulate
from twin.runs.folder import EVENTS
from twin.scenario.shipped import scenario_path
from twin.trial.loaded_scenario import PathOrName, load
from twin.trial.plan_result import read_plan, scenario_of_run
from twin.trial.run_result import read_run
from twin.view.cell_page import CellPage


def cell_page(path: PathOrName, *, port: int, read_only: bool = False) -> CellPage:
    """Return the page of a scenario, a plan or a run, which is served.

    Runs and plans are shown, and not changed; a plan is played as it would go without disturbances.

    Args:
        path: a scenario file, the name of a shipped one, or the folder of a run or plan.
        port: port of the page.
        read_only: show a scenario file without changing it.

    Raises:
        TwinError: there is nothing to show there.
    """
    place = Path(path)
    if not place.is_dir():
        file = scenario_path(place)
        # Scenarios that come with the program stay as they are: twin init copies one.
        editable = not read_only and place.is_file()
        return CellPage(load(file), None, file if editable else None, port)
    if (place / EVENTS).exists():
        return CellPage(scenario_of_run(place), read_run(place), None, port)
    plan = read_plan(place)
    return CellPage(plan.scenario, simulate(plan), None, port)
