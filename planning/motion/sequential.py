"""Sequential motion planning: one task after another, all other robots and objects at rest (APEX-MR IV-B)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Literal, Protocol

import numpy as np

from planning.cell.workcell import Workcell, WorldState
from planning.errors import TransitError
from planning.geometry.scene_checker import Contact, SceneChecker
from planning.motion.full_turns import take_near_turns
from planning.motion.motion_cache import CachedPath, MotionCache, Pairs, Polyline
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.motion.speed import SpeedModel, cut_path
from planning.motion.transit import TransitPlanner
from planning.progress import Progress, no_progress
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import (
    ActuationKey,
    AllowedContact,
    ExceptionKey,
    StepTasks,
    Task,
    TaskKind,
    TimeWindow,
    allowed_pairs,
    apply_handlings,
    cell_with_steps,
    still_borders,
    strongest_exception,
)
from planning.transforms import Array

MARGIN = 0.0005
"""Kept on top of the clearances by single-robot planning, so that the conflict search, which
rounds against itself, never finds a standing robot in conflict with the motion past it [m]."""

Expansion = Callable[[TaskPlan, int], Iterator[tuple[TaskPlan, StepTasks]]]
"""Given a plan and the index of the first task, yields the tasks of a step for alternative choices, each
with the plan that has that choice."""

_SMALL_STEP, _LOOKED_AT = 0.05, 201
"""Step of a joint that is tried where no path is found [rad or m], and configurations looked at."""


@dataclass(frozen=True)
class MotionSettings:
    """Settings of motion planning.

    Attributes:
        planners: transit planner of each robot.
        speeds: speed model of each robot.
        step: longest time between pose nodes [s].
        skill_seconds: nominal duration of each skill [s]; one that is not there follows its
            reference path at the speed of its robot.
        skill_exceptions: nominal durations that hold instead for a robot, a type of objects or
            both [s].
        actuation_seconds: nominal times in which tools close and open, by act, robot and tool [s]; those
            of a skill with a nominal duration are within it.
        attempts: seeds tried for a transit before another grasp is.
        seed: of the whole plan.
        paths: what finds paths in space and time, of all robots simultaneously: ``auto`` or ``rrt``.
    """

    planners: Mapping[str, TransitPlanner]
    speeds: Mapping[str, SpeedModel]
    step: float
    skill_seconds: Mapping[str, float]
    attempts: int = 5
    seed: int = 0
    skill_exceptions: Mapping[ExceptionKey, float] = field(default_factory=dict)
    actuation_seconds: Mapping[ActuationKey, float] = field(default_factory=dict)
    paths: Literal["auto", "rrt"] = "auto"

    def seconds_of(self, cell: Workcell, task: Task) -> float | None:
        """Return the nominal duration of a skill [s], None to follow its reference path."""
        kind = None if task.object is None else cell.kind_of(task.object)
        if task.kind == TaskKind.CHANGEOVER:
            kind = task.object
        found = strongest_exception(self.skill_exceptions, task.kind, task.robot, kind)
        return self.skill_seconds.get(task.kind) if found is None else found

    def seconds_along(self, task: Task, path: Array) -> float:
        """Return how long a skill without a nominal duration takes along a path, shape (w, n) [s]."""
        moving = self.speeds[task.robot].times_along(path)[-1]
        return float(moving) + sum(self.still_seconds(task))

    def still_seconds(self, task: Task) -> tuple[float, ...]:
        """Return the nominal durations of a skill's actuations when it has no nominal duration itself [s]."""
        return tuple(
            self.actuation_seconds.get(item.key, 0.0) for item in task.actuations
        )


@dataclass(frozen=True)
class StartConfiguration:
    """Initial state of a plan that does not begin at HOME.

    Attributes:
        state: where everything is.
        last_task: task that each robot did last; absent for one that did none yet.
        tasks: index of its first task.
    """

    state: WorldState
    last_task: Mapping[str, int] = field(default_factory=dict)
    tasks: int = 0


@dataclass(frozen=True)
class _Progress:
    """State of the cell, last tasks and clock after the tasks planned so far."""

    state: WorldState
    last_task: Mapping[str, int]
    clock: float


def plan_motions_sequentially(
    cell: Workcell,
    assembly: Assembly,
    plan: TaskPlan,
    settings: MotionSettings,
    progress: Progress = no_progress,
    known: MotionCache | None = None,
) -> tuple[TaskPlan, MotionPlan]:
    """Plan the paths of an assembly from its start; see ``plan_steps_sequentially``."""
    return plan_steps_sequentially(
        cell,
        plan,
        [partial(assembly.alternatives, choice.step) for choice in plan.choices],
        assembly.link,
        settings,
        progress,
        known,
        assembly.windows,
    )


def plan_steps_sequentially(
    cell: Workcell,
    plan: TaskPlan,
    expansions: Sequence[Expansion],
    link_steps: Callable[[Sequence[StepTasks]], np.ndarray],
    settings: MotionSettings,
    progress: Progress = no_progress,
    known: MotionCache | None = None,
    windows: Callable[[Sequence[StepTasks]], Iterable[TimeWindow]] = lambda _: (),
    begins: StartConfiguration | None = None,
) -> tuple[TaskPlan, MotionPlan]:
    """Plan the paths of steps in order.

    A transit that fails is tried again with other seeds, then its step with the next
    expansion (another grasp or support pose).

    Args:
        cell: the static cell; objects that come up in steps are added to it.
        plan: the choices.
        expansions: one per step.
        link_steps: returns all task dependencies, shape (e, 2), once every step is settled.
        settings: planners, speeds, attempts and seed.
        progress: called with the steps done and the steps in all.
        known: results of other plans of the same cell and settings; what is found here
            is added. The plan is the same with it and without.
        windows: returns the windows of time between tasks, once every step is settled.
        begins: where it begins; by default with every robot at HOME and everything at its start.

    Returns:
        The plan with the choices that were realised, and its motions.

    Raises:
        TransitError: no expansion of a step has a collision-free plan; names the task, the
            robot and the step.
    """
    first = begins or StartConfiguration(cell.start_state())
    now = _Progress(first.state, first.last_task, 0.0)
    steps: list[StepTasks] = []
    motions: list[TaskMotion] = []
    reached: dict[str, Array] = {}
    for number, expand in enumerate(expansions):
        first_failure: TransitError | None = None
        for chosen, expansion in expand(plan, first.tasks + len(motions)):
            turned, then_reached = take_near_turns(cell, expansion, reached)
            try:
                here = cell_with_steps(cell, [turned])
                done, after = _plan_step(here, turned, now, settings, known)
            except TransitError as failure:
                failure.step = turned.step
                first_failure = first_failure or failure
                continue
            cell, plan = here, chosen
            steps.append(turned)
            motions.extend(done)
            now, reached = after, then_reached
            break
        else:
            raise first_failure or TransitError(f"step {number + 1} has no expansion")
        progress(number + 1, len(expansions))
    tasks = tuple(task for step in steps for task in step.tasks)
    allowed = tuple(contact for step in steps for contact in step.allowed)
    links, times = link_steps(steps), tuple(windows(steps))
    return plan, MotionPlan(cell, tasks, tuple(motions), links, allowed, times)


def _plan_step(
    cell: Workcell,
    step: StepTasks,
    now: _Progress,
    settings: MotionSettings,
    known: MotionCache | None,
) -> tuple[list[TaskMotion], _Progress]:
    motions = []
    for task in step.tasks:
        waypoints, times = _way_of(cell, task, step.allowed, now, settings, known)
        motions.append(TaskMotion(waypoints, now.clock + times))
        state = apply_handlings(now.state, task.handlings)
        now = _Progress(
            state.with_robot(task.robot, waypoints[-1]),
            {**now.last_task, task.robot: task.index},
            now.clock + float(times[-1]),
        )
    return motions, now


def _way_of(
    cell: Workcell,
    task: Task,
    allowed: Sequence[AllowedContact],
    now: _Progress,
    settings: MotionSettings,
    known: MotionCache | None,
) -> Polyline:
    """Return the path of a task, cached if possible."""
    if cell.is_machine(task.robot):
        still = np.repeat(cell.robot(task.robot).home[None], 2, axis=0)
        return still, np.array([0.0, settings.seconds_of(cell, task) or 0.0])
    seed = (settings.seed * 1_000_003 + task.index) * 64
    phases = _phases(cell, task, allowed, now)

    def work_out() -> CachedPath:
        if task.kind == TaskKind.TRANSIT:
            path = _plan_transit(cell, task, phases[0], settings, seed)
            speed = settings.speeds[task.robot]
            cut = cut_path(path, speed, settings.step)
            assert cut is not None
            ends, seconds = cut
            times = np.concatenate([[0.0], np.cumsum(seconds)])
            return CachedPath((np.vstack([path[:1], ends]), times), len(path) <= 2)
        return CachedPath(_skill_path(cell, task, phases, settings), plain=True)

    if known is None:
        return work_out().path
    pairs = [phase.pairs for phase in phases]
    scene = known.scenes.scene(cell, now.state, pairs, task.handlings)
    seconds = None if task.kind == TaskKind.TRANSIT else settings.seconds_of(cell, task)
    stands = settings.still_seconds(task)
    moving = task.robot, task.kind, task.path.tobytes(), seconds, stands
    return known.path(moving, scene, seed, work_out)


@dataclass(frozen=True)
class _Phase:
    """Part of a task during which nothing changes hands.

    Attributes:
        first: waypoint that it starts at, 0 for that before the task's path.
        state: where everything is then.
        pairs: allowed contacts.
    """

    first: int
    state: WorldState
    pairs: Pairs


def _phases(
    cell: Workcell, task: Task, allowed: Sequence[AllowedContact], now: _Progress
) -> list[_Phase]:
    """Return the phases of a task in order."""
    found: list[_Phase] = []
    state = now.state
    handlings = () if task.kind == TaskKind.TRANSIT else task.handlings
    for k in sorted({0, *(h.waypoint for h in handlings)}):
        if k > 0:
            state = state.with_robot(task.robot, task.path[k - 1])
        state = apply_handlings(state, [h for h in handlings if h.waypoint == k])
        pairs = allowed_pairs(
            cell, state, task.robot, task.index, now.last_task, allowed
        )
        found.append(_Phase(k, state, pairs))
    return found


def _checker(cell: Workcell, task: Task, phase: _Phase) -> SceneChecker:
    return SceneChecker(cell, task.robot, phase.state, phase.pairs, margin=MARGIN)


def _plan_transit(
    cell: Workcell, task: Task, phase: _Phase, settings: MotionSettings, seed: int
) -> Array:
    start = phase.state.configurations[task.robot]
    goal = task.path[-1]
    if np.allclose(start, goal, rtol=0.0, atol=1e-9):
        return np.array([start])
    checker = _checker(cell, task, phase)
    if checker.contact(start) is not None:
        # A plan may begin where robots stand nearer to each other than they come to in one plan.
        checker = SceneChecker(cell, task.robot, phase.state, phase.pairs)
    for end, q in (("start", start), ("goal", goal)):
        contact = checker.contact(q)
        if contact is not None:
            raise TransitError(
                f"{_name(task)}: at its {end}, {contact}", blocked_by=[contact.obstacle]
            )
    for attempt in range(settings.attempts):
        path = settings.planners[task.robot].plan(checker, start, goal, seed + attempt)
        if path is not None:
            return path
    why, contact = explain_blockage(checker, start, goal)
    raise TransitError(
        f"{_name(task)}: no collision-free path found with {settings.attempts} seeds; {why}",
        blocked_by=[contact.obstacle] if contact else [],
    )


class ContactChecker(Protocol):
    """Reports what a robot touches at a configuration."""

    def contact(self, q: Array) -> Contact | None:
        """Return the closest forbidden contact at ``q``, None where there is none."""
        ...


def explain_blockage(
    checker: ContactChecker, start: Array, goal: Array
) -> tuple[str, Contact | None]:
    """Return the obstacle between two free configurations, in words and as a contact.

    That is what shuts the robot in at one of them, else what is in its way on the straight line.

    Args:
        checker: of the robot.
        start, goal: shape (n,).
    """
    for end, q in (("start", start), ("goal", goal)):
        steps = np.vstack([np.eye(len(q)), -np.eye(len(q))]) * _SMALL_STEP
        met = [checker.contact(q + step) for step in steps]
        contacts = [contact for contact in met if contact is not None]
        if len(contacts) < len(steps):
            continue
        names = Counter((c.first, c.second) for c in contacts)
        often, _ = names.most_common(1)[0]
        nearest = min(
            (c for c in contacts if (c.first, c.second) == often),
            key=lambda c: c.distance,
        )
        words = f"at its {end} no joint can turn by {_SMALL_STEP:g} rad or m: then {nearest}"
        return words, nearest
    for share in np.linspace(0.0, 1.0, _LOOKED_AT):
        contact = checker.contact(start + share * (goal - start))
        if contact is not None:
            words = f"straight on, {contact} after {100 * share:.0f} % of the way"
            return words, contact
    return "straight on something is in the way between free configurations", None


def _skill_path(
    cell: Workcell, task: Task, phases: Sequence[_Phase], settings: MotionSettings
) -> Polyline:
    waypoints = _check_skill(cell, task, phases)
    seconds = settings.seconds_of(cell, task)
    if seconds is not None:
        return waypoints, _spread_over(waypoints, seconds)
    speed = settings.speeds[task.robot]
    acts = zip(task.actuations, settings.still_seconds(task), strict=True)
    stands = {item.waypoint: lasts for item, lasts in acts}
    times = np.zeros(len(waypoints))
    for begin, end in pairwise(still_borders(task, len(waypoints) - 1)):
        if end in stands:
            passed = np.array([0.0, stands[end]])
        else:
            passed = speed.times_along(waypoints[begin : end + 1])
        times[begin : end + 1] = times[begin] + passed
    return waypoints, times


def _check_skill(cell: Workcell, task: Task, phases: Sequence[_Phase]) -> Array:
    """Return the reference path with its start, after checking every stretch of it."""
    start = phases[0].state.configurations[task.robot]
    path = np.vstack([start, task.path])
    phase_at = {phase.first: phase for phase in phases}
    for k in range(len(path)):
        if k in phase_at:
            checker = _checker(cell, task, phase_at[k])
        if k + 1 < len(path) and not checker.motion_free(path[k], path[k + 1]):
            contact = checker.contact(path[k + 1]) or checker.contact(path[k])
            why = f", {contact}" if contact else " between two free subgoals"
            raise TransitError(
                f"{_name(task)}: blocked at subgoal {k + 1}{why}",
                blocked_by=[contact.obstacle] if contact else [],
            )
    return path


def _spread_over(path: Array, seconds: float) -> Array:
    travel = np.concatenate(
        [[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).sum(axis=1))]
    )
    if travel[-1] == 0.0:
        return np.linspace(0.0, seconds, len(path))
    return np.asarray(seconds * travel / travel[-1])


def _name(task: Task) -> str:
    return f"step {task.step}, task {task.index} ({task.label}) of robot {task.robot!r}"
