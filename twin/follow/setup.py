"""Execution model of a followed run: from its manifest, or from a scenario file."""

from __future__ import annotations

from pathlib import Path

from planning.errors import ScenarioError
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import packaged_timings
from twin.engine.execution_model import ExecutionModel
from twin.scenario.file import load_scenario
from twin.scenario.manifest import MANIFEST, read_manifest
from twin.trial.simulation import scenario_execution
from twin.uncertainty.skill_durations import SkillDurations


def followed_execution(
    folder: Path, tpg: TemporalPlanGraph, scenario: Path | None = None
) -> tuple[str, ExecutionModel]:
    """Return the execution model of a followed run, and the name of its scenario.

    Args:
        folder: of the plan; its manifest says, where there is one.
        tpg: the plan.
        scenario: scenario file that says it instead.

    Raises:
        InvalidScenarioError: the scenario file is not valid.
        ScenarioError: it is for other robots.
        OutputError: the manifest is damaged.
    """
    if scenario is not None:
        found, base = load_scenario(scenario), scenario.parent
    elif (folder / MANIFEST).exists():
        found, content = read_manifest(folder, "run to follow")
        base = Path(content.get("run", {}).get("base", "."))
    else:
        return folder.name, ExecutionModel(SkillDurations(packaged_timings()))
    names = tuple(robot.name for robot in found.cell.robots)
    planned = tuple(robot.name for robot in tpg.cell.robots)
    if names != planned:
        raise ScenarioError(
            f"the plan in {folder} is for robots {', '.join(planned)}, scenario"
            f" {found.name!r} for {', '.join(names)}"
        )
    return found.name, scenario_execution(found, base)
