"""The way of a scenario: who does what, how everyone moves, what must wait for what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from planning.cell.workcell import Workcell
from planning.motion.motion_plan import MotionPlan
from planning.motion.sequential import MotionSettings, plan_sequential
from planning.motion.speed import JointSpeed, L1Speed, SpeedModel
from planning.motion.synchronous import SynchronousPlan, plan_synchronous
from planning.motion.transit import RrtConnect
from planning.tasks.highs_solver import HighsAssignmentSolver
from planning.tasks.plan import TaskPlan
from planning.tasks.work import StepExpansions
from planning.transforms import Indices
from scheduling.build_tpg import build_nodes, build_tpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.ordering.reordering import reorder_tasks
from scheduling.ordering.task_conflicts import SweptTaskConflicts
from scheduling.shortcuts.shortcutting import shorten_tpg
from twin.assemblies.kinds import assembly_kind
from twin.host.progress import Report, report_nothing
from twin.planning.stage_watch import StageWatch
from twin.scenario.build_workcell import build_workcell
from twin.scenario.duration_models import skill_models
from twin.scenario.sections.scenario import Scenario

MOTION, SLOTS, ORDER = "motions", "who moves at once", "what waits for what"
SHORTCUTS = "shortcuts"
"""Names of the stages for progress displays."""

CANDIDATES_PER_STEP, FEWEST_CANDIDATES = 150, 5000
"""Shortcuts tried by default; twice as many gain less than 1 % in makespan."""


@dataclass(frozen=True)
class Planned:
    """A planned scenario, with what each stage made.

    Attributes:
        cell: the workcell.
        assembly: what is built, such as a ``LegoAssembly``.
        task_plan: who does what.
        motion_plan: how everyone moves, one task after another or in slots.
        tpg: what must wait for what.
        planning_s: wall-clock seconds a stage: sequence (where the scenario gives a structure),
            assignment, motion, synchronous (where the plan is made in slots), tpg; of a
            construction checks, search, keyframes, path, tpg.
        turns: nodes of the sequential plan, where the plan is made in slots or shortened;
            None where ``tpg`` has the same nodes.
    """

    cell: Workcell
    assembly: Any
    task_plan: TaskPlan
    motion_plan: MotionPlan
    tpg: TemporalPlanGraph
    planning_s: Mapping[str, float]
    turns: TemporalPlanGraph | None = None


@dataclass(frozen=True)
class PlannedInTurns:
    """A scenario with its motions: what every coordination starts from.

    Attributes:
        cell: the workcell.
        assembly: what is built, such as a ``LegoAssembly``; the plan of a construction.
        task_plan: who does what.
        motion_plan: how everyone moves while all others stand, but for constructions, in which
            all move at once.
        settings: how tasks were turned into motions.
    """

    cell: Workcell
    assembly: Any
    task_plan: TaskPlan
    motion_plan: MotionPlan
    settings: MotionSettings


def plan_scenario(
    scenario: Scenario, folder: Path = Path(), progress: Report = report_nothing
) -> Planned:
    """Plan a scenario from the cell to the temporal plan graph.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start, that of its file.
        progress: told how far each stage has come.

    Raises:
        RobotModelError: a robot description cannot be used.
        ConstructionError: a construction for which no plan was found.
        InfeasibleStepError: a step that no robot, brick and grasp can do.
        TransitError: no collision-free path was found.
        PlanInvariantError: the plan breaks a guarantee, which is a fault of this program.
    """
    watch = StageWatch(progress)
    first = plan_motions(scenario, folder, watch)
    motion_plan, slots, turns = first.motion_plan, None, None
    if scenario.planning.coordination == "synchronous":
        synchronous = plan_in_slots(first, watch)
        motion_plan, slots = synchronous.motion_plan, synchronous.slot_of_task
        turns = build_nodes(first.motion_plan)
    tpg = order_motions(motion_plan, watch, slots)
    candidates = planned_shortcuts(scenario)
    if candidates:
        turns = turns or tpg
        tpg = shorten(
            tpg,
            first.settings,
            watch,
            candidates=candidates,
            seed=scenario.seed,
            keep_slots=scenario.execution.policy == "synchronous",
        )
    return Planned(
        first.cell,
        first.assembly,
        first.task_plan,
        motion_plan,
        tpg,
        watch.seconds,
        turns,
    )


def plan_motions(scenario: Scenario, folder: Path, watch: StageWatch) -> PlannedInTurns:
    """Plan how everyone moves: one task after another, or a construction in space and time.

    See plan_in_turns and plan_in_space_time for the stages, plan_scenario for the errors.
    """
    if scenario.assembly.kind != "construction":
        return plan_in_turns(scenario, folder, watch)
    from twin.planning.space_time import plan_in_space_time

    cell = build_workcell(scenario, folder)
    plan, task_plan, motion_plan = plan_in_space_time(scenario, cell, folder, watch)
    settings = motion_settings(scenario, cell, folder)
    return PlannedInTurns(cell, plan, task_plan, motion_plan, settings)


def plan_in_turns(
    scenario: Scenario, folder: Path, watch: StageWatch
) -> PlannedInTurns:
    """Choose who does what, and plan how everyone moves, one task after another.

    The stages are sequence (where the scenario gives a structure), assignment and motion; see
    plan_scenario for the errors.
    """
    cell = build_workcell(scenario, folder)
    ready = assembly_kind(scenario.assembly).prepare(cell, watch)
    with watch.stage("assignment"):
        task_plan = HighsAssignmentSolver().assign(ready.work.problem)
    settings = motion_settings(scenario, cell, folder)
    with watch.stage("motion"):
        steps = StepExpansions(ready.work, task_plan)
        watch.report(MOTION, 0, len(task_plan.choices))
        motion_plan = plan_sequential(
            cell,
            steps.callables(),
            ready.work.link,
            settings,
            watch.reporter(MOTION),
        )
    return PlannedInTurns(cell, ready.assembly, steps.plan, motion_plan, settings)


def plan_in_slots(turns: PlannedInTurns, watch: StageWatch) -> SynchronousPlan:
    """Let robots move at once, in slots; the stage is synchronous."""
    with watch.stage("synchronous"):
        return plan_synchronous(
            turns.motion_plan,
            turns.settings,
            SweptTaskConflicts(turns.motion_plan),
            watch.reporter(SLOTS),
        )


def order_motions(
    motion_plan: MotionPlan, watch: StageWatch, slots: Indices | None = None
) -> TemporalPlanGraph:
    """Build the temporal plan graph; the stage is tpg.

    Args:
        motion_plan: how everyone moves.
        watch: measures the stage.
        slots: slot of each task, where the plan was made in slots.
    """
    with watch.stage("tpg", ORDER):
        tpg = build_tpg(motion_plan, progress=watch.reporter(ORDER))
        return tpg if slots is None else replace(tpg, slots=slots)


def shorten(
    tpg: TemporalPlanGraph,
    settings: MotionSettings,
    watch: StageWatch,
    *,
    candidates: int,
    seed: int,
    keep_slots: bool = False,
) -> TemporalPlanGraph:
    """Put tasks into a better order and take shortcuts; the stage is shortcut.

    Args:
        tpg: the plan.
        settings: of its motions.
        watch: measures the stage.
        candidates: shortcuts tried.
        seed: of their draws.
        keep_slots: leave the tasks in the slots of a synchronous plan, in their order.
    """
    with watch.stage("shortcut"):
        watch.report(SHORTCUTS, 0, candidates)
        if not keep_slots:
            tpg = reorder_tasks(tpg)
        shorter = shorten_tpg(
            tpg,
            settings.speeds,
            step=settings.step,
            candidates=candidates,
            seed=seed,
            progress=watch.reporter(SHORTCUTS),
        ).tpg
        # A transit past HOME may serve two slots: there is nothing to wait for together any more.
        return replace(shorter, slots=np.empty(0, dtype=np.int64))


def planned_shortcuts(scenario: Scenario) -> int:
    """Return how many shortcuts are tried: as many as the scenario says, or by its steps.

    What is executed slot by slot stays as it was planned.
    """
    candidates = scenario.planning.shortcut_candidates
    if candidates != "auto":
        return candidates
    slots = scenario.execution.policy == "synchronous"
    return 0 if slots else default_shortcuts(scenario)


def default_shortcuts(scenario: Scenario) -> int:
    """Return how many shortcuts suit the size of an assembly."""
    if scenario.assembly.kind == "construction":
        return 0  # its planner has shortened the paths already
    steps = assembly_kind(scenario.assembly).steps()
    return max(CANDIDATES_PER_STEP * steps, FEWEST_CANDIDATES)


def motion_settings(scenario: Scenario, cell: Workcell, folder: Path) -> MotionSettings:
    """Return how the planning section of a scenario wants tasks turned into motions."""
    section = scenario.planning
    speeds = _speeds(scenario, cell)
    planners = {
        robot.name: RrtConnect(robot.model.lower, robot.model.upper, speeds[robot.name])
        for robot in cell.robots
    }
    models = skill_models(scenario, folder)
    return MotionSettings(
        planners=planners,
        speeds=speeds,
        step=section.step_s,
        skill_seconds={skill: model.mean for skill, model in models.items()},
        attempts=section.attempts,
        seed=scenario.seed,
    )


def _speeds(scenario: Scenario, cell: Workcell) -> dict[str, SpeedModel]:
    section = scenario.planning
    # A construction is planned at the speeds of its joints, whatever else is asked for.
    if section.speed_model == "joint" or scenario.assembly.kind == "construction":
        return {robot.name: JointSpeed(robot.model.velocity) for robot in cell.robots}
    return {robot.name: L1Speed(section.speed_rad_s) for robot in cell.robots}
