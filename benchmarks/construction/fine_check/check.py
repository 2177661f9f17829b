"""An independent check of a finished construction, from its timelines alone.

Nothing is shared with the planner's own checks: robots are read anew by pinocchio, shapes are
measured by coal, times and poses are worked out here. Checked are motions (limits, speeds, no
jumps), modes (each part is picked where it lies, held by one of its grips, and put down where
it belongs, after what it rests on), and clearances, at every moment of every motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.construction.fine_check.clearance import measure_clearances
from benchmarks.construction.fine_check.timed_motion import TimedMotion
from planning.construction.planner import ConstructionPlan
from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.world.fixed_world import PlannedTask
from planning.construction.world.timeline import ObjectChange, RobotTimeline
from planning.progress import Progress
from planning.transforms import Array, Transform, inverse
from scheduling.witness.robot import WitnessRobot

SLACK_S = 1e-6
"""Times may be off by this much [s]."""

JUMP = 5e-4
"""Corners of a part may be off by this much when it changes hands or is in its place [m]."""

_SPEED_SLACK = 1e-6
_FIRST, _LAST = "pick", "place-down"


@dataclass(frozen=True)
class Fault:
    """A fault of a plan.

    Attributes:
        t: when [s].
        kind: ``"motion"``, ``"mode"``, ``"pose"``, ``"order"`` or ``"clearance"``.
        words: what it is.
    """

    t: float
    kind: str
    words: str

    def __str__(self) -> str:
        """Return it in a line."""
        return f"{self.t:.3f} s: {self.words}"


@dataclass(frozen=True)
class FineCheck:
    """Outcome of a fine check.

    Attributes:
        measured: distances that were measured; each settles many moments.
        least_robots_m: least distance of two robots that may not touch, at any moment, to 0.05 mm;
            infinite if it is no less than 50 mm [m].
        least_others_m: likewise of a robot or its load and anything else [m].
        faults: what is wrong, by time; empty for a good plan.
    """

    measured: int
    least_robots_m: float
    least_others_m: float
    faults: tuple[Fault, ...]

    @property
    def ok(self) -> bool:
        """True when nothing is wrong."""
        return not self.faults


def check_construction(
    plan: ConstructionPlan, progress: Progress | None = None
) -> FineCheck:
    """Check a construction from scratch.

    Args:
        plan: the plan.
        progress: told how many robots and pairs of robots are measured, of how many.
    """
    motions = _motions(plan)
    faults = timeline_faults(plan, motions)
    measured = measure_clearances(plan, motions, progress)
    faults += [Fault(t, "clearance", words) for t, words in measured.found]
    return FineCheck(
        measured.measured,
        measured.least(robots=True),
        measured.least(robots=False),
        tuple(sorted(faults, key=lambda f: (f.t, f.kind, f.words))),
    )


def timeline_faults(
    plan: ConstructionPlan, motions: Mapping[str, TimedMotion] | None = None
) -> list[Fault]:
    """Return all faults but those of clearances: of motions, modes, poses and order.

    Args:
        plan: the plan.
        motions: of its robots, read anew where not given.
    """
    problem, world = plan.problem, plan.building.world
    motions = _motions(plan) if motions is None else motions
    faults: list[Fault] = []
    for robot in problem.cell.robots:
        line = world.robots[robot.name]
        model = robot.model
        faults += _motion_faults(
            line, robot.home, model.lower, model.upper, model.velocity
        )
    for part in problem.parts:
        faults += _part_faults(plan, part, motions)
    return [*faults, *_hand_faults(plan), *_order_faults(plan)]


def _motions(plan: ConstructionPlan) -> dict[str, TimedMotion]:
    robots = {robot.name: WitnessRobot(robot) for robot in plan.problem.cell.robots}
    world = plan.building.world
    return {
        name: TimedMotion(robots[name], world.robots[name]) for name in sorted(robots)
    }


def _motion_faults(
    line: RobotTimeline, home: Array, lower: Array, upper: Array, limits: Array
) -> Iterator[Fault]:
    """Yield what is wrong with a robot's motion in itself."""
    robot, time, path = line.robot, line.time, line.path
    if not (np.all(np.isfinite(time)) and np.all(np.isfinite(path))):
        yield Fault(0.0, "motion", f"{robot} has times or joint values without end")
        return
    if time[0] < -SLACK_S or np.max(np.abs(path[0] - home)) > _SPEED_SLACK:
        yield Fault(float(time[0]), "motion", f"{robot} does not start at HOME")
    for k in np.flatnonzero(np.any((path < lower - 1e-9) | (path > upper + 1e-9), 1)):
        yield Fault(float(time[k]), "motion", f"{robot} is beyond its joint limits")
    travel, span = np.abs(np.diff(path, axis=0)), np.diff(time)[:, None]
    allowed = np.asarray(limits) * (span + _SPEED_SLACK) + 1e-9
    for k in np.flatnonzero(np.any(travel > allowed, axis=1) | (span[:, 0] < 0.0)):
        joint = int(np.argmax(travel[k] - allowed[k]))
        words = (
            f"{robot} moves joint {joint + 1} by {travel[k, joint]:.4f} in"
            f" {span[k, 0]:.4f} s, faster than {float(np.asarray(limits)[joint]):.3f}/s"
        )
        yield Fault(float(time[k]), "motion", words)


def _part_faults(
    plan: ConstructionPlan, part: Part, motions: Mapping[str, TimedMotion]
) -> Iterator[Fault]:
    """Yield what is wrong with the way of one part from the supply to its place."""
    problem, world = plan.problem, plan.building.world
    item = problem.object(part)
    work = sorted(
        (w for w in plan.building.work if w.object == part.name), key=lambda w: w.touch
    )
    changes = world.objects[part.name].changes
    kinds = [w.kind for w in work]
    if kinds[:1] != [_FIRST] or kinds[1:] != ["handover"] * (len(kinds) - 2) + [_LAST]:
        at = work[0].start if work else 0.0
        yield Fault(at, "mode", f"{part.name} goes through {', '.join(kinds) or '-'}")
        return
    if len(changes) != len(work):
        yield Fault(work[0].start, "mode", f"{part.name} changes hands without a skill")
        return
    last: str | None = None
    pose = np.asarray(item.start)
    for skill, change in zip(work, changes, strict=True):
        yield from _skill_faults(problem, skill, change, last)
        if change.holder is not None:
            yield from _grip_faults(problem, part, change)
        before = _in_world(motions, last, pose, change.time)
        after = _in_world(motions, change.holder, np.asarray(change.pose), change.time)
        jump = _moved_corners(before, after, item.size)
        if jump > JUMP:
            words = f"{part.name} jumps by {jump * 1e3:.1f} mm as it changes hands"
            yield Fault(change.time, "pose", words)
        last, pose = change.holder, np.asarray(change.pose)
    away = _moved_corners(pose, np.asarray(part.goal), item.size)
    if last is not None or away > JUMP:
        words = f"{part.name} ends {away * 1e3:.1f} mm from where it belongs"
        yield Fault(changes[-1].time, "pose", words)


def _skill_faults(
    problem: ConstructionProblem,
    skill: PlannedTask,
    change: ObjectChange,
    last: str | None,
) -> Iterator[Fault]:
    """Yield what is wrong with a skill: who does it, for how long, and what changes in it."""
    assert skill.object is not None
    kind = problem.cell.object(skill.object).kind
    nominal = problem.seconds.of(skill.kind, skill.robot, kind)
    name = f"{skill.kind} of {skill.object} by {skill.robot}"
    if abs(change.time - skill.touch) > SLACK_S or change.holder != skill.holder:
        yield Fault(skill.touch, "mode", f"{name} is not when the part changes hands")
    if not skill.start - SLACK_S <= skill.touch <= skill.end + SLACK_S:
        yield Fault(skill.touch, "mode", f"{name} has its touch outside of itself")
    if skill.end - skill.start < nominal - SLACK_S:
        words = f"{name} takes {skill.end - skill.start:.3f} s, less than {nominal} s"
        yield Fault(skill.start, "mode", words)
    if skill.kind != _FIRST and last != skill.robot:
        yield Fault(skill.start, "mode", f"{name}, who does not have it")
    if skill.kind == _FIRST and skill.holder != skill.robot:
        yield Fault(skill.start, "mode", f"{name} gives it to {skill.holder}")


def _grip_faults(
    problem: ConstructionProblem, part: Part, change: ObjectChange
) -> Iterator[Fault]:
    """Yield a fault where the tool does not touch the part as one of its grips says."""
    assert change.holder is not None
    model = problem.cell.robot(change.holder).model
    tool = model.frame_in_flange(problem.frame)
    touch = inverse(np.asarray(change.pose)) @ tool
    for grip in part.grips:
        near = float(np.linalg.norm(touch[:3, 3] - grip.touch[:3, 3])) < JUMP
        if near and float(touch[:3, 2] @ grip.touch[:3, 2]) > 1.0 - 1e-6:
            return
    words = f"{change.holder} holds {part.name} by none of its grips"
    yield Fault(change.time, "mode", words)


def _hand_faults(plan: ConstructionPlan) -> Iterator[Fault]:
    """Yield the times at which a robot does two skills at once or takes a second part."""
    last: dict[str, PlannedTask] = {}
    for skill in sorted(plan.building.work, key=lambda w: w.start):
        before = last.get(skill.robot)
        if before is not None and skill.start < before.end - SLACK_S:
            words = (
                f"{skill.robot} begins {skill.label} before the end of {before.label}"
            )
            yield Fault(skill.start, "mode", words)
        last[skill.robot] = skill
    events = sorted(
        (change.time, change.holder is not None, name, change.holder)
        for name, line in plan.building.world.objects.items()
        for change in line.changes
    )
    held: dict[str, str] = {}
    for t, _, name, holder in events:
        held = {robot: load for robot, load in held.items() if load != name}
        if holder is None:
            continue
        if holder in held:
            yield Fault(t, "mode", f"{holder} takes {name} and has {held[holder]}")
        held[holder] = name


def _order_faults(plan: ConstructionPlan) -> Iterator[Fault]:
    """Yield the parts that are placed before what they rest on, or on nothing; or picked too soon."""
    problem, graph = plan.problem, plan.problem.graph
    placing = {str(w.object): w for w in plan.building.work if w.holder is None}
    for name, own in placing.items():
        there = {p for p, w in placing.items() if w.end <= own.start + SLACK_S}
        missing = graph.carriers[name] - there if problem.carried else frozenset()
        if missing:
            words = f"{name} is placed before {', '.join(sorted(missing))}"
            yield Fault(own.start, "order", words)
        elif name not in graph.ground and not graph.neighbours[name] & there:
            yield Fault(own.start, "order", f"{name} is placed before its neighbours")
    picking = {str(w.object): w for w in plan.building.work if w.kind == _FIRST}
    for name, above in graph.covers.items():
        for other in sorted(above):
            if picking[name].start < picking[other].end - SLACK_S:
                words = f"{name} is picked while {other} lies on it"
                yield Fault(picking[name].start, "order", words)


def _moved_corners(before: Transform, after: Transform, size: Array) -> float:
    """Return how far the corner of a box that moves most is away [m]."""
    signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]))
    corners = signs.reshape(3, -1).T * np.asarray(size)
    gap = corners @ (before - after)[:3, :3].T + (before - after)[:3, 3]
    return float(np.max(np.linalg.norm(gap, axis=1)))


def _in_world(
    motions: Mapping[str, TimedMotion], holder: str | None, pose: Transform, t: float
) -> Transform:
    return pose if holder is None else motions[holder].flange(t) @ pose
