"""Steps of an assembly where they are done: what is there by then, and what touches what."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import Attachment, CellObject, Fixture, Workcell
from planning.contacts.precedence import (
    Overlaps,
    leads_through,
    near_to,
    nearest_words,
    standing,
)
from planning.errors import InfeasibleStepError
from planning.parts.assembly import (
    AnyStep,
    Grip,
    MachineWork,
    PartAssembly,
    PlacePart,
    Process,
    StopOnTheWay,
    Work,
)
from planning.parts.tool_grips import tool_grips
from planning.steps.skill_scene import Objects
from planning.steps.tool_changes import with_each_tool
from planning.transforms import Transform, readonly

TIP = 0.005
"""What is nearer than this to where a process is done may be touched by its tool [m]."""

DEEPEST_NODE = 0.05
"""Deepest that bars that meet in a node may be said to be in each other [m]."""


@dataclass(frozen=True)
class Held:
    """A part that another robot grips during a step.

    Attributes:
        part: what is gripped.
        pose: of its centre in the world, where it lies.
        grips: ways to grip it; the number of a grip is its place here.
    """

    part: CellObject
    pose: Transform
    grips: list[Grip]


@dataclass(frozen=True)
class PartStep:
    """One step in which a part is placed, known before anything is assigned.

    Attributes:
        step: what is done.
        part: what is placed; it is picked at its ``start``, which is where it is by then.
        goal: pose of its centre in its place, in the world, or where it is put down on its way.
        around: all other parts: those of earlier steps in place, the others where they were.
        grips: ways to hold it; the number of a grip is its place here.
        at_start: what it touches before it is picked, with the distances [m].
        at_goal: what it touches once it is in place, with the distances [m].
        held: what another robot grips meanwhile, None for nothing.
    """

    step: PlacePart
    part: CellObject
    goal: Transform
    around: Objects
    grips: list[Grip]
    at_start: Mapping[str, float]
    at_goal: Mapping[str, float]
    held: Held | None = None


@dataclass(frozen=True)
class WorkStep:
    """One step in which a process is done, known before anything is assigned.

    Attributes:
        step: what is done.
        place: pose in the world of the frame at which it is done.
        around: all parts as they are by then.
        touched: parts and fixtures that the tool may touch.
        held: what another robot grips meanwhile, None for nothing.
    """

    step: Work
    place: Transform
    around: Objects
    touched: frozenset[str]
    held: Held | None = None


@dataclass(frozen=True)
class MachineStep:
    """One step in which a machine works at a part.

    Attributes:
        step: what is done.
        around: all parts as they are by then.
        held: None: nobody holds anything meanwhile.
    """

    step: MachineWork
    around: Objects
    held: None = None

    @property
    def touched(self) -> frozenset[str]:
        """What it is done at."""
        return frozenset({self.step.part})


KnownStep = PartStep | WorkStep | MachineStep


def part_steps(cell: Workcell, assembly: PartAssembly) -> tuple[KnownStep, ...]:
    """Return the steps of an assembly, every part of which comes to lie on something.

    Args:
        cell: its objects are the parts.
        assembly: goals and steps.

    Raises:
        InfeasibleStepError: a part would hang in the air, goes where something is, or is taken
            on with another one on it.
    """
    out: list[KnownStep] = []
    for number, step, where, goal in steps_in_order(cell, assembly):
        held = None
        if step.hold is not None:
            part, pose = cell.object(step.hold), where[step.hold]
            rules = assembly.handling(step.hold).grips
            grips = tool_grips(
                list(with_each_tool(cell.robots)), part.shape, pose, pose, rules
            )
            held = Held(part, pose, grips)
        if isinstance(step, Work):
            out.append(_work_step(cell, step, where, assembly.touch, held))
        elif isinstance(step, MachineWork):
            out.append(MachineStep(step, _around(cell, where)))
        else:
            placing = _place_step(cell, assembly, number, where, goal, held)
            _require_alone(number, placing, out)
            out.append(placing)
    return tuple(out)


def steps_in_order(
    cell: Workcell, assembly: PartAssembly
) -> Iterator[tuple[int, AnyStep, dict[str, Transform], Transform]]:
    """Yield the steps with their numbers from 1, and where all parts are as each begins.

    Last comes where the part of the step is put: in its place, or down on its way; where nothing
    is put, the origin.

    Args:
        cell: its objects are the parts.
        assembly: goals, steps and supplies.
    """
    where = {item.name: item.start for item in cell.objects if not item.later}
    supply = assembly.supply
    for number, step in enumerate(assembly.steps, start=1):
        goal: Transform = np.eye(4)
        if isinstance(step, PlacePart):
            stop = step.stop
            goal = assembly.goals[step.part] if stop is None else stop_pose(cell, stop)
        yield number, step, dict(where), goal
        if isinstance(step, PlacePart):
            where[step.part] = goal
        if number in supply.refills:
            where |= supply.refills[number].parts
        if number in supply.leaves:
            for name, _ in supply.leaves[number].parts:
                del where[name]


def far_first(step: PartStep | WorkStep) -> list[int]:
    """Return the grips on what is held, those first that leave most room for the other robot."""
    assert step.held is not None
    held = step.held
    work = (step.goal if isinstance(step, PartStep) else step.place)[:3, 3]

    def near(k: int) -> float:
        at = (held.pose @ held.grips[k].pose)[:3, 3]
        return -round(float(np.linalg.norm(at - work)), 6)

    return sorted(range(len(held.grips)), key=near)


_GRAZED = 0.001
"""By so much more than in its place a part may be in what it touches, on the way there [m]."""

_IN = "into its place: lead it in from another side (insert), or over a shorter way (approach_m)"
_OUT = (
    "out of where it starts: take away first what is on it, or lead it out to another side"
    " (take_out), or over a shorter way (leave_m)"
)


def _place_step(
    cell: Workcell,
    assembly: PartAssembly,
    number: int,
    where: Mapping[str, Transform],
    goal: Transform,
    held: Held | None,
) -> PartStep:
    step = assembly.steps[number - 1]
    assert isinstance(step, PlacePart)
    name = step.part
    part = replace(cell.object(name), start=where[name])
    around = _around(cell, {k: pose for k, pose in where.items() if k != name})
    lying = standing(cell) | {k: (item, at.pose) for k, (item, at) in around.items()}
    at_goal = near_to((part, goal), lying, assembly.touch)
    if not at_goal and not assembly.joined_to(name):
        raise InfeasibleStepError(
            f"step {number} ({name}) would leave it in the air: it touches neither a fixture nor a part"
            f" that is there by then; {nearest_words(name, (part, goal), lying)}"
        )
    _require_room(number, name, at_goal, assembly.overlaps)
    at_start = near_to((part, part.start), lying, assembly.touch)
    rules = assembly.handling(name).grips
    grips = tool_grips(
        list(with_each_tool(cell.robots)), part.shape, part.start, goal, rules
    )
    return PartStep(step, part, goal, around, grips, at_start, at_goal, held)


def require_ways(
    cell: Workcell, assembly: PartAssembly, steps: Iterable[KnownStep]
) -> None:
    """Require that parts are not led straight through what they touch in their places or at their starts.

    As it may be touched, it is not looked at as an obstacle. What is in each other at the start
    already is a mistake of another kind.

    Raises:
        InfeasibleStepError: a part would go through something; says what helps.
    """
    for number, step in enumerate(steps, start=1):
        if not isinstance(step, PartStep):
            continue
        part, ways = step.part, assembly.handling(step.part.name)
        lying = standing(cell)
        lying |= {name: (item, at.pose) for name, (item, at) in step.around.items()}
        for place, touched, direction, length, words in (
            (step.goal, step.at_goal, np.array(ways.insertion), ways.approach, _IN),
            (part.start, step.at_start, -np.array(ways.extraction), ways.leave, _OUT),
        ):
            for other, gap in sorted(touched.items()):
                most = assembly.overlaps.most(part.name, other) + _GRAZED
                way = (part, place), lying[other], direction, length, most
                if gap >= -most and leads_through(*way):
                    raise InfeasibleStepError(
                        f"step {number} ({part.name}) leads through {other} on the straight way"
                        f" {words}"
                    )


def _require_room(
    number: int, name: str, touched: Mapping[str, float], overlaps: Overlaps
) -> None:
    deep = {k: -gap for k, gap in touched.items() if -gap > overlaps.most(name, k)}
    if not deep:
        return
    other = max(deep, key=deep.__getitem__)
    most = overlaps.most(name, other)
    raise InfeasibleStepError(
        f"step {number} ({name}) goes where {other} is: they would overlap by"
        f" {deep[other] * 1e3:.1f} mm, and may by {most * 1e3:g} mm"
        + node_remedy(name, other, deep[other], overlaps)
    )


def node_remedy(name: str, other: str, depth: float, overlaps: Overlaps) -> str:
    """Return in words what would let two bars that meet in a node be in each other."""
    wide = math.ceil(depth * 1e3) / 1e3
    if wide > DEEPEST_NODE:
        return ""
    if {name, other} in overlaps.joined:
        return f"; if they meet in a node, say joined_overlap_m: {wide:g}"
    words = f"; if they meet in a node, join them (joined: [[{other}, {name}]])"
    if wide > overlaps.depth:
        words += f" and say joined_overlap_m: {wide:g}"
    return words


def _work_step(
    cell: Workcell,
    step: Work,
    where: Mapping[str, Transform],
    touch: float,
    held: Held | None,
) -> WorkStep:
    base = where.get(step.owner or "")
    if base is None:
        base = _frame_of(cell, step.owner, step.frame)
    place = readonly(base @ step.pose)
    around = _around(cell, where)
    lying = standing(cell) | {k: (item, at.pose) for k, (item, at) in around.items()}
    touched = {step.owner} - {None}
    for tip in _tips(step.process, place):
        touched |= near_to(tip, lying, touch + TIP).keys()
    names = frozenset(name for name in touched if name is not None)
    return WorkStep(step, place, around, names, held)


def stop_pose(cell: Workcell, stop: StopOnTheWay) -> Transform:
    """Return where the frame of a part comes to lie in the world at a stop."""
    return readonly(_frame_of(cell, stop.fixture, stop.frame) @ stop.pose)


def _frame_of(cell: Workcell, fixture: str | None, frame: str | None) -> Transform:
    """Return the pose of a fixture, or of one of its frames; None stands for the world."""
    for item in cell.fixtures:
        if item.name == fixture:
            inside = np.eye(4) if frame is None else item.frames[frame]
            return np.asarray(item.pose @ inside)
    return np.eye(4)


def _require_alone(number: int, step: PartStep, before: Iterable[KnownStep]) -> None:
    """Refuse to take a part on from where it was put down, if another one was put to it there."""
    part, moved = step.part.name, False
    leant: set[str] = set()
    for other in before:
        if not isinstance(other, PartStep):
            continue
        leant.discard(other.part.name)
        if other.part.name == part:
            moved, leant = True, set()
        elif moved and part in other.at_goal:
            leant.add(other.part.name)
    if leant:
        raise InfeasibleStepError(
            f"step {number} ({step.step.words}): {min(leant)} was put to it where it lies; what is"
            " put to a part must wait until that is in its place"
        )


def _around(cell: Workcell, where: Mapping[str, Transform]) -> Objects:
    return {
        item.name: (item, Attachment(None, where[item.name]))
        for item in cell.objects
        if item.name in where
    }


def _tips(process: Process, place: Transform) -> Iterator[tuple[Fixture, Transform]]:
    """Yield grains at the places that the tip of the tool comes to."""
    for at in process.path or (np.eye(4),):
        pose = readonly(place @ at)
        yield Fixture("tip", box_shape("tip", np.full(3, 1e-4)), pose), pose
