"""The way of a scenario: who does what, how everyone moves, what must wait for what."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from planning.assembly_work import StepExpansions
from planning.assignment import HighsAssignmentSolver
from planning.motion_plan import MotionPlan
from planning.sequential import MotionSettings, plan_sequential
from planning.speed import JointSpeed, L1Speed, SpeedModel
from planning.synchronous import plan_synchronous
from planning.task_plan import TaskPlan
from planning.transit import RrtConnect
from planning.workcell import PlacedRobot, Workcell
from scheduling.construction import build_nodes, build_tpg
from scheduling.shortcutting import shorten_tpg
from scheduling.task_conflicts import SweptTaskConflicts
from scheduling.temporal_plan_graph import TemporalPlanGraph
from twin.assemblies.kinds import assembly_kind
from twin.cell import build_workcell
from twin.duration_models import skill_models
from twin.progress import Report, report_nothing
from twin.scenario import PlanningSection, Scenario

MOTION, SLOTS, ORDER = "motions", "who moves at once", "what waits for what"
SHORTCUTS = "shortcuts"
"""Names of the stages for progress displays."""


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
            assignment, motion, synchronous (where the plan is made in slots), tpg.
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


@dataclass
class _Watch:
    """Seconds spent, by stage.

    Attributes:
        report: told how far each stage has come.
        seconds: what each stage took; a stage entered again adds up.
    """

    report: Report
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, key: str, label: str | None = None) -> Iterator[None]:
        """Measure a stage; with a label, show it as one piece of work."""
        start = time.perf_counter()
        if label is not None:
            self.report(label, 0, 1)
        try:
            yield
        finally:
            elapsed = time.perf_counter() - start
            self.seconds[key] = self.seconds.get(key, 0.0) + elapsed
        if label is not None:
            self.report(label, 1, 1)


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
        InfeasibleStepError: a step that no robot, brick and grasp can do.
        TransitError: no collision-free path was found.
        PlanInvariantError: the plan breaks a guarantee, which is a fault of this program.
    """
    watch = _Watch(progress)
    cell = build_workcell(scenario, folder)
    ready = assembly_kind(scenario.assembly).prepare(cell, watch)
    with watch.stage("assignment"):
        task_plan = HighsAssignmentSolver().assign(ready.work.problem)
    settings = motion_settings(scenario, cell, folder)
    with watch.stage("motion"):
        steps = StepExpansions(ready.work, task_plan)
        progress(MOTION, 0, len(task_plan.choices))
        motion_plan = plan_sequential(
            cell,
            steps.callables(),
            ready.work.link,
            settings,
            lambda done, total: progress(MOTION, done, total),
        )
    slots = turns = None
    if scenario.planning.coordination == "synchronous":
        with watch.stage("synchronous"):
            synchronous = plan_synchronous(
                motion_plan,
                settings,
                SweptTaskConflicts(motion_plan),
                lambda done, total: progress(SLOTS, done, total),
            )
            turns = build_nodes(motion_plan)
        motion_plan, slots = synchronous.motion_plan, synchronous.slot_of_task
    with watch.stage("tpg"):
        progress(ORDER, 0, 1)
        tpg = build_tpg(
            motion_plan, progress=lambda done, total: progress(ORDER, done, total)
        )
        if slots is not None:
            tpg = replace(tpg, slots=slots)
        progress(ORDER, 1, 1)
    if scenario.planning.shortcut_candidates:
        turns = turns or tpg
        with watch.stage("shortcut"):
            tpg = shorten_tpg(
                tpg,
                settings.speeds,
                step=settings.step,
                candidates=scenario.planning.shortcut_candidates,
                seed=scenario.seed,
                progress=lambda done, total: progress(SHORTCUTS, done, total),
            ).tpg
    return Planned(
        cell,
        ready.assembly,
        steps.plan,
        motion_plan,
        tpg,
        watch.seconds,
        turns,
    )


def motion_settings(scenario: Scenario, cell: Workcell, folder: Path) -> MotionSettings:
    """Return how the planning section of a scenario wants tasks turned into motions."""
    section = scenario.planning
    speeds = {robot.name: _speed(section, robot) for robot in cell.robots}
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


def _speed(section: PlanningSection, robot: PlacedRobot) -> SpeedModel:
    if section.speed_model == "joint":
        return JointSpeed(robot.model.velocity)
    return L1Speed(section.speed_rad_s)
