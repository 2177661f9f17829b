"""Function that makes the page of a scenario, a plan, a run, or the best of a study or exploration."""

from __future__ import annotations

from pathlib import Path

from planning.files import read_object
from twin.api.runs import simulate
from twin.registry import HOOKS
from twin.runs.folder import EVENTS
from twin.scenario.manifest import MANIFEST
from twin.scenario.shipped import scenario_path
from twin.trial.loaded_scenario import PathOrName, load
from twin.trial.plan_result import read_plan, scenario_of_run
from twin.trial.run_result import read_run
from twin.view.cell_page import CellPage


def cell_page(path: PathOrName, *, port: int, read_only: bool = False) -> CellPage:
    """Return the page of a scenario or of results, which is served.

    Results are shown, and not changed. A plan is executed once, as by ``twin.simulate``. Of a study it is the plan that
    its report shows first, of an exploration the cell of the best design.

    Args:
        path: a scenario file, the name of a shipped one, or the folder of a run, plan, study or exploration.
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
    about = read_object(place / MANIFEST, "manifest of results")
    if "exploration" in about:
        design = HOOKS.require("design of an exploration", "the page of an exploration")
        scenario, words = design(f"{place}#1")
        return CellPage(scenario, None, None, port, words)
    if "study" in about:
        plan, words = HOOKS.require("plan of a study", "the page of a study")(place)
        words = f"Plan of the study's best: {words}"
    else:
        plan, words = read_plan(place), ""
    return CellPage(plan.scenario, simulate(plan), None, port, words)
