"""Run folder of a run in progress: the plans that are executed one after another, and the execution model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from planning.errors import ScenarioError
from scheduling.graph.plan_files import load_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.measured import packaged_timings
from twin.engine.execution_model import ExecutionModel
from twin.reading.scenario_file import load_scenario
from twin.runs.folder import FIRST, VERSIONS
from twin.scenario.manifest import MANIFEST, manifest_base, read_manifest
from twin.trial.plan_result import plan_of_run
from twin.trial.simulation import scenario_execution
from twin.uncertainty.skill_durations import SkillDurations


@dataclass(frozen=True)
class PlanHistory:
    """Plans that are executed one after another in a run.

    Attributes:
        first: with which it begins.
        version: returns the plan of a version, given its number, from 1; None where none takes over.
        late: machines of it that bring late parts.
    """

    first: TemporalPlanGraph
    version: Callable[[int], TemporalPlanGraph] | None = None
    late: frozenset[str] = frozenset()


def plan_history(folder: Path) -> PlanHistory:
    """Return the plans of a finished or ongoing run; see ``plan_of_run`` for the errors."""
    if not (folder / FIRST).is_dir():
        return PlanHistory(plan_of_run(folder))
    first, versions = load_plan(folder / FIRST), folder / VERSIONS

    def version(number: int) -> TemporalPlanGraph:
        return load_plan(versions / str(number))

    if not (versions / "1").is_dir():
        return PlanHistory(first, version)
    own = version(1)
    late = own.chain_index.keys() - first.chain_index.keys()
    return PlanHistory(own, version, frozenset(late))


def followed_execution(
    folder: Path, tpg: TemporalPlanGraph, scenario: Path | None = None
) -> tuple[str, ExecutionModel]:
    """Return the execution model of a followed run, and the name of its scenario.

    Args:
        folder: folder of the plan; its manifest names the scenario, where there is one.
        tpg: the plan.
        scenario: scenario file to use instead.

    Raises:
        InvalidScenarioError: the scenario file is not valid.
        ScenarioError: it is for other robots.
        OutputError: the manifest is damaged.
    """
    if scenario is not None:
        found, base = load_scenario(scenario), scenario.parent
    elif (folder / MANIFEST).exists():
        found, content = read_manifest(folder, "run to follow")
        base = manifest_base(folder, content)
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
