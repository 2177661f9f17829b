"""Steps of an assembly where they are done: what is there by then, and what touches what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import Attachment, CellObject, Fixture, Workcell
from planning.contacts.contact_graph import near_to, standing
from planning.contacts.precedence import MOST_OVERLAP
from planning.errors import InfeasibleStepError
from planning.parts.assembly import Grip, PartAssembly
from planning.parts.steps import Place, Process, Work
from planning.parts.tool_grips import tool_grips
from planning.transforms import Transform, readonly

TIP = 0.005
"""What is nearer than this to where a process is done may be touched by its tool [m]."""

Around = Mapping[str, tuple[CellObject, Attachment]]
"""Parts by name, and where they are."""


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
        part: what is placed; it is picked at its ``start``.
        goal: pose of its centre in its place, in the world.
        around: all other parts: those of earlier steps in place, the others where they were.
        grips: ways to hold it; the number of a grip is its place here.
        at_start: what it touches before it is picked, with the distances [m].
        at_goal: what it touches once it is in place, with the distances [m].
        held: what another robot grips meanwhile, None for nothing.
    """

    step: Place
    part: CellObject
    goal: Transform
    around: Around
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
    around: Around
    touched: frozenset[str]
    held: Held | None = None


def part_steps(
    cell: Workcell, assembly: PartAssembly
) -> tuple[PartStep | WorkStep, ...]:
    """Return the steps of an assembly, every part of which comes to lie on something.

    Args:
        cell: its objects are the parts.
        assembly: goals and steps.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is.
    """
    out: list[PartStep | WorkStep] = []
    where = {item.name: item.start for item in cell.objects if not item.later}
    supply = assembly.supply
    for number, step in enumerate(assembly.steps, start=1):
        held = None
        if step.hold is not None:
            part, pose = cell.object(step.hold), where[step.hold]
            rules = assembly.ways(step.hold).grips
            grips = tool_grips(cell.robots, part.shape, pose, pose, rules)
            held = Held(part, pose, grips)
        if isinstance(step, Work):
            out.append(_work_step(cell, step, dict(where), assembly.touch, held))
        else:
            out.append(_place_step(cell, assembly, number, where, held))
            where[step.part] = assembly.goals[step.part]
            if step.part in supply.refills:
                where |= supply.refills[step.part].parts
        if number in supply.leaves:
            for name, _ in supply.leaves[number].parts:
                del where[name]
    return tuple(out)


def _place_step(
    cell: Workcell,
    assembly: PartAssembly,
    number: int,
    where: Mapping[str, Transform],
    held: Held | None,
) -> PartStep:
    step = assembly.steps[number - 1]
    assert isinstance(step, Place)
    name = step.part
    part, goal = cell.object(name), assembly.goals[name]
    around = _around(cell, {k: pose for k, pose in where.items() if k != name})
    lying = standing(cell) | {k: (item, at.pose) for k, (item, at) in around.items()}
    at_goal = near_to((part, goal), lying, assembly.touch)
    if not assembly.is_joined(name):
        _require_standing(f"step {number} ({name})", at_goal)
    _require_room(f"step {number} ({name})", at_goal)
    at_start = near_to((part, part.start), lying, assembly.touch)
    rules = assembly.ways(name).grips
    grips = tool_grips(cell.robots, part.shape, part.start, goal, rules)
    return PartStep(step, part, goal, around, grips, at_start, at_goal, held)


def _require_standing(step: str, touched: Mapping[str, float]) -> None:
    if not touched:
        raise InfeasibleStepError(
            f"{step} would leave it in the air: it touches neither a fixture nor a part that is"
            " there by then"
        )


def _require_room(step: str, touched: Mapping[str, float]) -> None:
    if not touched:
        return
    other, gap = min(touched.items(), key=lambda entry: entry[1])
    if gap < -MOST_OVERLAP:
        raise InfeasibleStepError(
            f"{step} goes where {other} is: they would overlap by {-gap * 1e3:.1f} mm"
        )


def _work_step(
    cell: Workcell,
    step: Work,
    where: Mapping[str, Transform],
    touch: float,
    held: Held | None,
) -> WorkStep:
    fixtures = {item.name: item for item in cell.fixtures}
    base: Transform = np.eye(4)
    if step.owner in fixtures:
        fixture = fixtures[step.owner]
        base = fixture.pose
        if step.frame is not None:
            base = base @ fixture.frames[step.frame]
    elif step.owner is not None:
        base = where[step.owner]
    place = readonly(base @ step.pose)
    around = _around(cell, where)
    lying = standing(cell) | {k: (item, at.pose) for k, (item, at) in around.items()}
    touched = {step.owner} - {None}
    for tip in _tips(step.process, place):
        touched |= near_to(tip, lying, touch + TIP).keys()
    names = frozenset(name for name in touched if name is not None)
    return WorkStep(step, place, around, names, held)


def _around(cell: Workcell, where: Mapping[str, Transform]) -> Around:
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
