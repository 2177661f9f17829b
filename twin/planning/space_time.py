"""Constructions: planned in space and time at once, by the whole team (Hartmann et al.)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from planning.cell.workcell import Workcell
from planning.errors import ScenarioError
from planning.motion.motion_plan import MotionPlan
from planning.tasks.assignment_problem import PrimaryCandidate
from planning.tasks.plan import StepChoice, TaskPlan
from twin.assemblies.construction import ConstructionKind
from twin.planning.stage_watch import StageWatch
from twin.scenario.duration_models import skill_models
from twin.scenario.sections.construction import ConstructionSection
from twin.scenario.sections.scenario import Scenario

if TYPE_CHECKING:
    from planning.construction.planner import ConstructionPlan
    from planning.construction.problem.problem import ConstructionProblem

CHECKS, PARTS = "what can be built", "parts"
"""Names of the stages for progress displays."""


def construction_problem(
    scenario: Scenario, cell: Workcell, folder: Path
) -> ConstructionProblem:
    """Return what a scenario wants built, checked as far as lower bounds go.

    Skills are planned with the means of their durations.

    Args:
        scenario: with an assembly of kind ``construction``.
        cell: built of it.
        folder: where relative paths in it start.

    Raises:
        ConstructionError: it cannot be built as it is, or not by these robots.
        ScenarioError: the scenario asks for what constructions cannot have.
    """
    from planning.construction.problem.problem import SkillSeconds

    section = scenario.assembly
    assert isinstance(section, ConstructionSection)
    if scenario.planning.coordination != "sequential":
        raise ScenarioError(
            "a construction is planned in space and time at once, not in slots: leave out the"
            " planning's coordination"
        )
    models = skill_models(scenario, folder)
    for skill in ("pick", "place-down", "handover"):
        if skill not in models:
            raise ScenarioError(
                f"execution.skills.{skill}: a construction is planned with the mean duration of"
                " its skills, touching a part has no path of its own: give a distribution in"
                " place of kind: reference"
            )
    seconds = SkillSeconds(
        models["pick"].mean, models["place-down"].mean, models["handover"].mean
    )
    return ConstructionKind(section).problem(cell, seconds, scenario.seed)


def plan_in_space_time(
    scenario: Scenario, cell: Workcell, folder: Path, watch: StageWatch
) -> tuple[ConstructionPlan, TaskPlan, MotionPlan]:
    """Plan a construction; the stages are checks, keyframes, path and search.

    Args:
        scenario: with an assembly of kind ``construction``.
        cell: built of it.
        folder: where relative paths in it start.
        watch: measures the stages.

    Raises:
        ConstructionError: no plan was found.
    """
    from planning.construction.export.timed_tasks import motion_plan
    from planning.construction.planner import plan_construction

    with watch.stage("checks", CHECKS):
        problem = construction_problem(scenario, cell, folder)
    watch.report(PARTS, 0, len(problem.parts))
    with watch.stage("search"):
        plan = plan_construction(problem, progress=watch.reporter(PARTS))
        motions = motion_plan(problem, plan.building)
    watch.seconds |= plan.seconds
    watch.seconds["search"] -= sum(plan.seconds.values())
    return plan, _task_plan(plan), motions


def _task_plan(plan: ConstructionPlan) -> TaskPlan:
    """Return who placed what, in the order of planning."""
    placed = [work for work in plan.building.work if work.holder is None]
    return TaskPlan(
        tuple(
            StepChoice(
                PrimaryCandidate(
                    work.step, work.robot, work.part, work.grip, work.end - work.start
                )
            )
            for work in sorted(placed, key=lambda work: work.step)
        )
    )
