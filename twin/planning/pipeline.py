"""Stages of planning a scenario: assignment, motions, slots (synchronous policy), temporal plan graph and shortcuts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.cell.workcell import Workcell
from planning.errors import ScenarioError
from planning.motion.motion_plan import MotionPlan
from planning.motion.sequential import MotionSettings, plan_motions_sequentially
from planning.motion.speed import JointSpeed, L1Speed, LimitedSpeed, SpeedModel
from planning.tasks.highs_solver import assign_steps
from planning.transforms import Indices
from scheduling.build_tpg import build_tpg
from scheduling.conflicts.derived_tpg import OccupantConflicts
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import plan_cost
from scheduling.ordering.reordering import reorder_tasks
from scheduling.planned_motions import PlannedMotions
from scheduling.shortcuts.shortcutting import shorten_tpg
from twin.host.progress import StageWatch
from twin.planning.build_workcell import build_workcell
from twin.registry import HOOKS, PLANNERS
from twin.scenario.sections.kind import AssemblyKind, assembly_kind
from twin.scenario.sections.scenario import Scenario

MOTION = "motions"
SLOTS, ORDER = "who moves at once", "what waits for what"
SHORTCUTS = "shortcuts"
"""Names of the stages for progress displays."""

CANDIDATES_PER_STEP, FEWEST_CANDIDATES = 150, 5000
"""Most shortcuts tried by default; they end when they stop paying."""

MOST_CANDIDATES = 10_000_000
"""Shortcuts tried where only time limits them."""


def plan_motions(
    scenario: Scenario,
    folder: Path,
    watch: StageWatch,
    *,
    whole: bool = False,
    first: int | None = None,
) -> PlannedMotions:
    """Plan assignment and sequential motions, before robots move simultaneously.

    The stages are those of the kind of assembly, then assignment and motion; see plan_scenario for the
    errors. What consists of several units has the motions of the first one, and the others beside them.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start.
        watch: measures the stages.
        whole: plan every product by itself, where plans else repeat after the first ones.
        first: number of first steps to plan, every product by itself; the rest is kept.

    Raises:
        RequestError: steps of this kind are looked at together.
    """
    kind = assembly_kind(scenario.assembly)
    kind = kind.written_out() if whole or first is not None else kind
    if first is None:
        _require_plannable(scenario, kind)
    units = kind.units() if first is None else (kind,)
    found = [_unit_motions(scenario, folder, watch, unit, first) for unit in units]
    return replace(found[0], further=tuple(found[1:]))


def _unit_motions(
    scenario: Scenario,
    folder: Path,
    watch: StageWatch,
    kind: AssemblyKind,
    first: int | None,
) -> PlannedMotions:
    """Plan the motions of one unit; see ``plan_motions``."""
    cell = build_workcell(scenario, folder, kind)
    settings = motion_settings(scenario, cell, folder)
    if first is None and kind.space_time:
        return kind.plan(cell, settings, watch)
    ahead = None if first is None else kind.ahead(cell, watch)
    if first is None or ahead is None:
        work = kind.assembly(cell, watch)
    else:
        with watch.stage("assignment"):
            work = ahead.first(ahead.with_whole_products(first))
    with watch.stage("assignment"):
        chosen = assign_steps(work.problem)
    with watch.stage("motion"):
        watch.report(MOTION, 0, len(chosen.choices))
        chosen, motion_plan = plan_motions_sequentially(
            cell, work, chosen, settings, watch.reporter(MOTION)
        )
    return kind.finished(
        PlannedMotions(
            cell, work.built, chosen, motion_plan, settings, work=work, ahead=ahead
        )
    )


def _require_plannable(scenario: Scenario, kind: AssemblyKind) -> None:
    """Refuse a coordination that a kind of assembly does not support.

    Raises:
        ScenarioError: it does not; the message says why.
    """
    if scenario.planning.coordination == "sequential":
        return
    if kind.space_time:
        raise ScenarioError(
            f"a {scenario.assembly.kind} is planned in space and time at once, not in slots:"
            " leave out the planning's coordination"
        )
    if kind.machines():
        raise ScenarioError(
            "no slot can wait for machines, sources and products: leave out coordination"
        )


def wanted_steps(scenario: Scenario, least: int = 0) -> int | None:
    """Return the number of first steps to plan of a scenario that is replanned; None for all.

    Args:
        scenario: a checked scenario.
        least: minimum number, steps of spare products included.
    """
    kind = assembly_kind(scenario.assembly).written_out()
    wanted = kind.wanted_steps()
    return None if wanted == kind.steps() else max(wanted, least)


def require_sequential(scenario: Scenario) -> None:
    """Refuse a scenario that is not planned one task after another.

    Raises:
        ScenarioError: the scenario is planned in space and time.
    """
    if assembly_kind(scenario.assembly).space_time:
        raise ScenarioError(
            f"a {scenario.assembly.kind} is planned in space and time at once, not one task"
            " after another"
        )


class SlotPlan(Protocol):
    """A plan in slots; see ``scheduling.synchronous.synchronous_plan.SynchronousPlan``."""

    @property
    def motion_plan(self) -> MotionPlan:
        """The motions, timed by slots."""

    @property
    def slot_of_task(self) -> Indices:
        """Slot of each task, from 0, shape (tasks,)."""

    @property
    def jointly_planned(self) -> tuple[tuple[int, ...], ...]:
        """Groups of transits that were planned as one robot."""


def plan_synchronously(
    turns: PlannedMotions, watch: StageWatch, *, always_jointly: bool = False
) -> SlotPlan:
    """Let robots move simultaneously in slots; the stage is synchronous.

    Args:
        turns: one task after another.
        watch: measures the stage.
        always_jointly: plan all transits of a slot jointly.

    Raises:
        RequestError: the planner of slots is not installed.
    """
    plan_synchronous = HOOKS.require("synchronous plan", "a plan in slots")
    with watch.stage("synchronous"):
        slots: SlotPlan = plan_synchronous(
            turns.motion_plan,
            turns.settings,
            progress=watch.reporter(SLOTS),
            always_jointly=always_jointly,
        )
    return slots


def build_plan_graph(
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


def shorten_plan(
    tpg: TemporalPlanGraph,
    settings: MotionSettings,
    watch: StageWatch,
    *,
    candidates: int,
    seed: int,
    sidesteps: int = 0,
    seconds: float = 0.0,
    keep_slots: bool = False,
    straight: bool = False,
    conflicts: OccupantConflicts | None = None,
) -> TemporalPlanGraph:
    """Improve the task order and take shortcuts; the stage is shortcut.

    Args:
        tpg: the plan.
        settings: of its motions.
        watch: measures the stage.
        candidates: shortcuts tried.
        seed: of their draws.
        sidesteps: tried after them; where there are any, shortcuts are taken in the planned order
            of tasks, too, and the plan that ends sooner is kept.
        seconds: for which shortcuts are tried by the clock of ``watch``, 0 for as long as they
            pay [s].
        keep_slots: leave the tasks in the slots of a synchronous plan, in their order.
        straight: order tasks for straight transits, see ``reorder_tasks``.
        conflicts: what was found for other plans of the same cell.
    """
    with watch.stage("shortcut"):
        watch.report(SHORTCUTS, 0, candidates)
        speeds = settings.speeds if straight else None
        orders = [tpg if keep_slots else reorder_tasks(tpg, speeds, conflicts)]
        if sidesteps and orders[0] is not tpg:
            # A detour via HOME can be faster at first and slower later.
            orders.append(tpg)
        found = [
            shorten_tpg(
                order,
                settings.speeds,
                step=settings.step,
                candidates=candidates,
                seed=seed,
                progress=watch.reporter(SHORTCUTS),
                sidesteps=sidesteps,
                seconds=seconds / len(orders),
                clock=watch.clock,
            )
            for order in orders
        ]
        shorter = min(found, key=plan_cost)
        # A transit past HOME may serve two slots: there is nothing to wait for together any more.
        return replace(shorter, slots=np.empty(0, dtype=np.int64))


def planned_shortcuts(scenario: Scenario) -> int:
    """Return the number of shortcut candidates: given, or derived from the steps.

    What is executed slot by slot stays as it was planned.
    """
    candidates = scenario.planning.shortcut_candidates
    if candidates != "auto":
        return candidates
    if scenario.planning.shortcut_s > 0.0:
        return MOST_CANDIDATES
    slots = scenario.execution.policy == "synchronous"
    return 0 if slots else default_shortcuts(scenario)


def planned_sidesteps(scenario: Scenario) -> int:
    """Return the number of sidestep candidates: given, or derived from the plan."""
    candidates = scenario.planning.sidestep_candidates
    if candidates != "auto":
        return candidates
    return default_shortcuts(scenario) if scenario.kind.tries_sidesteps else 0


def default_shortcuts(scenario: Scenario) -> int:
    """Return the default number of shortcut candidates for the size of an assembly."""
    kind = assembly_kind(scenario.assembly)
    if kind.space_time:
        return 0  # its planner has shortened the paths already
    steps = max(unit.steps() for unit in kind.units())
    return max(CANDIDATES_PER_STEP * steps, FEWEST_CANDIDATES)


def motion_settings(scenario: Scenario, cell: Workcell, folder: Path) -> MotionSettings:
    """Return the motion settings of a scenario's planning section."""
    section = scenario.planning
    speeds = _speeds(scenario, cell)
    make_planner = PLANNERS.load(section.planner)
    planners = {
        robot.name: make_planner(
            robot.model.lower, robot.model.upper, speeds[robot.name]
        )
        for robot in cell.robots
    }
    models = scenario.execution.skill_models(folder)
    exceptions = (
        *scenario.tool_durations,
        *scenario.execution.skill_exceptions(folder),
        *assembly_kind(scenario.assembly).machine_durations(),
    )
    return MotionSettings(
        planners=planners,
        speeds=speeds,
        step=section.step_s,
        skill_seconds={skill: model.mean for skill, model in models.items()},
        attempts=section.attempts,
        seed=scenario.seed,
        skill_exceptions={
            (item.skill, item.robot, item.object): item.duration.mean
            for item in exceptions
        },
        actuation_seconds={
            key: model.located(folder).mean
            for key, model in scenario.actuations.items()
        },
        paths=section.paths,
    )


def _speeds(scenario: Scenario, cell: Workcell) -> dict[str, SpeedModel]:
    section = scenario.planning
    at_once = assembly_kind(scenario.assembly).space_time
    if scenario.speed_model == "limits" and not at_once:
        return {
            robot.name: LimitedSpeed(robot.limits or MotionLimits.of(robot.model))
            for robot in cell.robots
        }
    if scenario.speed_model == "joint" or at_once:
        return {robot.name: JointSpeed(robot.model.velocity) for robot in cell.robots}
    return {
        robot.name: L1Speed(section.l1_rad_s, robot.model.velocity)
        for robot in cell.robots
    }
