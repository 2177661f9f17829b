"""A plan that an earlier run left: what it is, and what it is compared with."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planning.cell.differences import cell_differences
from planning.errors import OutputError, ScenarioError, listed
from planning.files import read_file
from scheduling.graph.plan_files import load_plan, plan_sha256
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.planning.build_workcell import build_workcell
from twin.run.folder import TURNS
from twin.run.policies import IN_SLOTS, IN_TURNS
from twin.run.written import PLAN_FILES, require_as_written
from twin.scenario.manifest import MANIFEST
from twin.scenario.sections.scenario import Scenario


@dataclass(frozen=True)
class SavedPlan:
    """A plan from the folder of a run.

    Attributes:
        tpg: the plan.
        variant: which it is: a plan of twin.run.policies.
        turns: the plan in turns of the same motions, None where ``tpg`` is that.
        planning_s: nothing: it is not planned again.
        load_bound_s: not known: it is not planned again.
        step_order: not known either.
    """

    tpg: TemporalPlanGraph
    variant: str
    turns: TemporalPlanGraph | None
    planning_s: Mapping[str, float] = field(default_factory=dict)
    load_bound_s: float | None = None
    step_order: tuple[int, ...] = ()


def plan_variant(tpg: TemporalPlanGraph) -> str:
    """Return which plan a graph is, as far as itself says."""
    return IN_SLOTS if len(tpg.slots) else IN_TURNS


def read_saved_plan(folder: Path, scenario: Scenario, base: Path) -> SavedPlan:
    """Read a plan from the folder of a run, with the plan in turns that it was made of.

    Args:
        folder: of the run; a plan alone counts as in turns, or in slots where it has some.
        scenario: what it is to be executed for.
        base: where relative paths of the scenario start.

    Raises:
        OutputError: a file is damaged, or the plans are not those of the manifest.
        ScenarioError: the plan is for another cell.
    """
    tpg = load_plan(folder)
    found = cell_differences(tpg.cell, build_workcell(scenario, base))
    if found:
        raise ScenarioError(
            f"the plan in {folder} is not for the cell of scenario {scenario.name!r}: "
            + listed(found, most=4)
        )
    about = _about(folder)
    if about is None or about.get("plan_sha256") != plan_sha256(tpg):
        # A plan alone, or one that was put there later: nothing says what it was made of.
        return SavedPlan(tpg, plan_variant(tpg), None)
    turns, digest = None, about.get("turns_sha256")
    if digest is not None:
        turns = load_plan(folder / TURNS)
        if plan_sha256(turns) != digest:
            raise OutputError(
                f"{folder / TURNS}: is not the plan in turns of the manifest beside it"
            )
    return SavedPlan(tpg, str(about.get("plan", plan_variant(tpg))), turns)


def plan_of_run(folder: Path) -> TemporalPlanGraph:
    """Return the plan in the folder of a run, which is that of its manifest and summary.

    Args:
        folder: of the run; in one without a manifest a plan stands for itself.

    Raises:
        OutputError: there is no plan, it is damaged, or not the one that was executed.
        RobotModelError: a robot's description has changed, or is not there any more.
    """
    require_as_written(folder, PLAN_FILES)
    tpg, about = load_plan(folder), _about(folder)
    if about is not None and about.get("plan_sha256") != plan_sha256(tpg):
        raise OutputError(
            f"the plan in {folder} is not the one of {MANIFEST} beside it"
        )
    return tpg


def _about(folder: Path) -> dict[str, Any] | None:
    """Return what a manifest says of its run; None where there is none, or none of a run."""
    try:
        found = json.loads(read_file(folder / MANIFEST))["run"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
        raise OutputError(
            f"{folder / MANIFEST}: no manifest of a run: {error!r}"
        ) from error
    if not isinstance(found, dict):
        raise OutputError(f"{folder / MANIFEST}: no manifest of a run")
    return found
