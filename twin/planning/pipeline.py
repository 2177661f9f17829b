"""From a scenario to its temporal plan graph: assignment, motions, order and shortcuts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from planning.cell.motion_limits import limits_of
from planning.cell.workcell import Workcell
from planning.errors import PlanInvariantError, ScenarioError
from planning.motion.load_bound import load_bound_s
from planning.motion.motion_plan import MotionPlan
from planning.motion.sequential import MotionSettings
from planning.motion.speed import JointSpeed, L1Speed, LimitedSpeed, RobotSpeed
from planning.motion.transit import RrtConnect
from planning.transforms import Indices
from scheduling.build_nodes import build_nodes
from scheduling.build_tpg import build_tpg
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.ordering.reordering import reorder_tasks
from scheduling.ordering.synchronous import (
    SynchronousPlan,
    TaskConflicts,
    plan_synchronous,
)
from scheduling.shortcuts.shortcutting import shorten_tpg
from twin.host.progress import Report, StageWatch, report_nothing
from twin.planning.build_workcell import build_workcell
from twin.planning.kind import PlannedMotions, assembly_kind
from twin.planning.part_assembly.pattern import repeated_plans
from twin.planning.timed import timed
from twin.run.policies import (
    AT_ONCE,
    IN_SLOTS,
    IN_TURNS,
    SHORTENED,
    SLOTS_SHORTENED,
)
from twin.scenario.sections.scenario import Scenario

SLOTS, ORDER = "who moves at once", "what waits for what"
SHORTCUTS, IMPROVEMENT = "shortcuts", "better choices"
"""Names of the stages for progress displays."""

CANDIDATES_PER_STEP, FEWEST_CANDIDATES = 150, 5000
"""Most shortcuts tried by default; they end when they stop paying."""


@dataclass(frozen=True)
class Planned(PlannedMotions):
    """A planned scenario, with what each stage made.

    Attributes:
        motion_plan: how everyone moves, one task after another, in slots, or at once.
        tpg: what must wait for what.
        planning_s: wall-clock seconds a stage: sequence (where the scenario gives a structure),
            assignment, motion, synchronous (where the plan is made in slots), tpg; of a
            construction checks, search, keyframes, path, tpg.
        turns: nodes of the sequential plan, where the plan is made in slots or shortened;
            None where ``tpg`` has the same nodes.
        variant: which plan ``tpg`` is: a plan of twin.run.policies.
        load_bound_s: a makespan at nominal durations that no choice of who does what can beat
            [s], None where that was not worked out.
        step_order: numbers that the steps had before they were put into another order; empty where
            they were not.
    """

    tpg: TemporalPlanGraph
    planning_s: Mapping[str, float]
    turns: TemporalPlanGraph | None = None
    variant: str = IN_TURNS
    load_bound_s: float | None = None
    step_order: tuple[int, ...] = ()


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
    first, planned = plan_best(scenario, folder, watch := StageWatch(progress))
    if first.pattern is not None:
        return _repeated(replace(planned, pattern=first.pattern), watch)
    if first.work is None:
        return planned
    bound = load_bound_s(first.cell, first.work, first.task_plan, first.settings)
    order = first.work.order
    moved = order if list(order) != sorted(order) else ()
    return replace(planned, load_bound_s=bound, step_order=moved)


def plan_best(
    scenario: Scenario, folder: Path, watch: StageWatch
) -> tuple[PlannedMotions, Planned]:
    """Return the plan of a scenario with its motions, improved where the scenario says so.

    See plan_scenario for the errors.
    """
    refuse_improvement(scenario)
    first = plan_motions(scenario, folder, watch)
    planned = _coordinated(scenario, first, watch)
    improves = scenario.planning.improves
    found = improved_motions(scenario, first, watch) if improves else None
    if found is None:
        return first, planned
    try:
        other = _coordinated(scenario, found, watch)
    except PlanInvariantError:  # no reason to go without the plan that holds
        return first, planned
    better = nominal_s(other.tpg) < nominal_s(planned.tpg)
    return (found, other) if better else (first, planned)


def _repeated(planned: Planned, watch: StageWatch) -> Planned:
    """Return the plan of some products for all that there are to be; the stage is products."""
    plans = {IN_TURNS: planned.turns or planned.tpg, planned.variant: planned.tpg}
    found = repeated_plans(plans, planned.pattern, watch)
    if (tpg := found[planned.variant]) is found[IN_TURNS]:
        return replace(planned, cell=tpg.cell, tpg=tpg, turns=None, variant=IN_TURNS)
    return replace(planned, cell=tpg.cell, tpg=tpg, turns=found[IN_TURNS])


def _coordinated(
    scenario: Scenario, first: PlannedMotions, watch: StageWatch
) -> Planned:
    """Return planned motions with their graph, ordered and shortened as the scenario says."""
    motion_plan, slots, turns = first.motion_plan, None, None
    variant = AT_ONCE if assembly_kind(scenario.assembly).at_once else IN_TURNS
    if scenario.planning.coordination == "synchronous":
        synchronous = plan_in_slots(first, watch)
        motion_plan, slots = synchronous.motion_plan, synchronous.slot_of_task
        turns, variant = build_nodes(first.motion_plan), IN_SLOTS
    tpg = order_motions(motion_plan, watch, slots)
    candidates = planned_shortcuts(scenario)
    if candidates:
        turns = turns or tpg
        variant = SHORTENED if variant != IN_SLOTS else SLOTS_SHORTENED
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
        first.settings,
        timed(tpg, scenario, watch),
        watch.seconds,
        None if turns is None else timed(turns, scenario, watch),
        variant,
    )


def nominal_s(tpg: TemporalPlanGraph) -> float:
    """Return the makespan of a graph at nominal durations [s]."""
    return float(earliest_times(tpg).makespan)


def refuse_improvement(scenario: Scenario) -> None:
    """Refuse to improve what is not chosen step by step, before anything is planned.

    Raises:
        ScenarioError: says which scenarios can be improved.
    """
    section = scenario.planning
    if not section.improves:
        return
    kind = scenario.assembly.kind
    if kind not in ("lego", "assembly"):
        raise ScenarioError(
            "planning.improve_s and improve_tries search for other robots, objects, grips and"
            f" supports of steps; the kind {kind!r} has none to choose from: leave them out",
            choices=("lego", "assembly"),
        )
    if section.coordination != "sequential":
        raise ScenarioError(
            "planning.improve_s and improve_tries judge a plan by its temporal plan graph, not by"
            " slots: leave them out, or the coordination 'synchronous'"
        )


def improved_motions(
    scenario: Scenario, first: PlannedMotions, watch: StageWatch
) -> PlannedMotions | None:
    """Search for a better task plan; the stage is improve.

    Returns:
        The motions of the best plan found, None where none is better than the one given.
    """
    from scheduling.improvement.rated_plans import PlanRater
    from scheduling.improvement.search import improve_plan

    if first.work is None:
        return None
    section = scenario.planning
    with watch.stage("improve"):
        watch.report(IMPROVEMENT, 0, 1)
        shortcuts = planned_shortcuts(scenario) > 0
        rater = PlanRater(first.cell, first.settings, shortcuts=shortcuts)
        work = first.work if section.improve_order else first.work.in_this_order()
        start = rater.rate_motions(work, first.task_plan, first.motion_plan)
        best = improve_plan(
            rater,
            start,
            seconds=section.improve_s,
            tries=section.improve_tries,
            seed=scenario.seed,
            progress=watch.reporter(IMPROVEMENT),
        )
    if best is start:
        return None
    found = replace(
        first,
        assembly=best.work.assembly or first.assembly,
        task_plan=best.task_plan,
        motion_plan=best.motion_plan,
        work=best.work,
    )
    return assembly_kind(scenario.assembly).finished(found)


def plan_motions(scenario: Scenario, folder: Path, watch: StageWatch) -> PlannedMotions:
    """Plan assignment and motions, before robots are let move at once.

    See the kinds of assemblies for the stages, plan_scenario for the errors.
    """
    kind = assembly_kind(scenario.assembly)
    if kind.at_once and scenario.planning.coordination != "sequential":
        raise ScenarioError(
            f"a {scenario.assembly.kind} is planned in space and time at once, not in slots:"
            " leave out the planning's coordination"
        )
    if kind.machines() and scenario.planning.coordination != "sequential":
        raise ScenarioError(
            "no slot can wait for machines, sources and products: leave out coordination"
        )
    cell = build_workcell(scenario, folder)
    return kind.plan(cell, motion_settings(scenario, cell, folder), watch)


def plan_in_turns(
    scenario: Scenario, folder: Path, watch: StageWatch
) -> PlannedMotions:
    """Plan as plan_motions does, but only what can be planned one task after another.

    Raises:
        ScenarioError: the scenario is planned in space and time.
    """
    if assembly_kind(scenario.assembly).at_once:
        raise ScenarioError(
            f"a {scenario.assembly.kind} is planned in space and time at once, not one task"
            " after another"
        )
    return plan_motions(scenario, folder, watch)


def plan_in_slots(turns: PlannedMotions, watch: StageWatch) -> SynchronousPlan:
    """Let robots move at once, in slots; the stage is synchronous."""
    with watch.stage("synchronous"):
        return plan_synchronous(
            turns.motion_plan,
            turns.settings,
            TaskConflicts(turns.motion_plan),
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
        )
        # A transit past HOME may serve two slots: there is nothing to wait for together any more.
        return replace(shorter, slots=np.empty(0, dtype=np.int64))


def planned_shortcuts(scenario: Scenario) -> int:
    """Return the number of shortcut candidates: the scenario's, or by its steps.

    What is executed slot by slot stays as it was planned.
    """
    candidates = scenario.planning.shortcut_candidates
    if candidates != "auto":
        return candidates
    slots = scenario.execution.policy == "synchronous"
    return 0 if slots else default_shortcuts(scenario)


def default_shortcuts(scenario: Scenario) -> int:
    """Return the default number of shortcut candidates for the size of an assembly."""
    kind = assembly_kind(scenario.assembly)
    if kind.at_once:
        return 0  # its planner has shortened the paths already
    return max(CANDIDATES_PER_STEP * kind.steps(), FEWEST_CANDIDATES)


def motion_settings(scenario: Scenario, cell: Workcell, folder: Path) -> MotionSettings:
    """Return the motion settings of a scenario's planning section."""
    section = scenario.planning
    speeds = _speeds(scenario, cell)
    planners = {
        robot.name: RrtConnect(robot.model.lower, robot.model.upper, speeds[robot.name])
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
    )


def _speeds(scenario: Scenario, cell: Workcell) -> dict[str, RobotSpeed]:
    section = scenario.planning
    at_once = assembly_kind(scenario.assembly).at_once
    if scenario.speed_model == "limits" and not at_once:
        return {
            robot.name: LimitedSpeed(robot.limits or limits_of(robot.model))
            for robot in cell.robots
        }
    if scenario.speed_model == "joint" or at_once:
        return {robot.name: JointSpeed(robot.model.velocity) for robot in cell.robots}
    return {
        robot.name: L1Speed(section.l1_rad_s, robot.model.velocity)
        for robot in cell.robots
    }
