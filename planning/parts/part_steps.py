"""Steps of an assembly of parts: the parts present at each step, their contacts, and their fit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import Attachment, CellObject, Fixture, Workcell
from planning.contacts.interference import Overlaps, overlap_depth, sweeps_through
from planning.contacts.play import Play, play_in_place
from planning.contacts.touching import (
    PlacedObject,
    describe_nearest,
    nearby_entities,
    standing_fixtures,
)
from planning.errors import InfeasibleStepError
from planning.grips.grip import Grip
from planning.grips.tool_grips import tool_grips
from planning.handling.skill_scene import Objects
from planning.handling.tool_changes import with_each_tool
from planning.parts.assembly import AnyStep, PartAssembly, PlacePart, Spot, Work
from planning.statics.standing_rules import Joint
from planning.transforms import Transform, read_only_copy

TIP = 0.005
"""The tool of a process may touch bodies within this distance of the process point [m]."""

_IN = "into its place: lead it in from another side (insert), or over a shorter way (approach_m)"
_OUT = (
    "out of where it starts: take away first what is on it, or lead it out to another side"
    " (take_out), or over a shorter way (leave_m)"
)


@dataclass(frozen=True)
class Held:
    """A part that another robot grips during a step.

    Attributes:
        part: what is gripped.
        pose: of its centre in the world, where it lies.
        grips: candidate grips; the number of a grip is its place here.
    """

    part: CellObject
    pose: Transform
    grips: list[Grip]


@dataclass(frozen=True)
class KnownStep:
    """One step in its context, before assignment.

    Attributes:
        step: what is done.
        place: pose in the world of what it is done at: of the part in its place, or where it is
            put down on its way, or of the frame at which a process is done.
        around: all other parts: those of earlier steps in place, the others where they were.
        touched: what the part touches there, or the tool may touch, with the distances [m].
        held: what another robot grips meanwhile, None for nothing.
    """

    step: AnyStep
    place: Transform
    around: Objects
    touched: Mapping[str, float]
    held: Held | None

    @property
    def others(self) -> dict[str, PlacedObject]:
        """All other parts at their current poses, by name."""
        return {name: (item, at.pose) for name, (item, at) in self.around.items()}


@dataclass(frozen=True)
class PartStep(KnownStep):
    """A step in which a part is placed.

    Attributes:
        part: the placed part; it is picked at its ``start``, which is its current pose.
        grips: candidate grips; the number of a grip is its place here.
        at_start: its contacts before it is picked, with the distances [m].
    """

    step: PlacePart
    part: CellObject
    grips: list[Grip]
    at_start: Mapping[str, float]


def part_steps(cell: Workcell, assembly: PartAssembly) -> tuple[KnownStep, ...]:
    """Return the steps of an assembly; every placed part must rest on something.

    Args:
        cell: its objects are the parts.
        assembly: goals and steps.

    Raises:
        InfeasibleStepError: a part would hang in the air, goes where something is, or is taken
            on with another one on it.
    """
    out: list[KnownStep] = []
    robots = list(with_each_tool(cell.robots))
    for number, step, where, goal in steps_in_order(cell, assembly):
        held = None
        if step.hold is not None:
            part, pose = cell.object(step.hold), where[step.hold]
            rules = assembly.handling(step.hold).grips
            held = Held(part, pose, tool_grips(robots, part.shape, pose, pose, rules))
        around = {
            item.name: (item, Attachment(None, where[item.name]))
            for item in cell.objects
            if item.name in where
        }
        known = KnownStep(step, goal, around, {}, held)
        if isinstance(step, PlacePart):
            placing = place_step(cell, assembly, number, step, known)
            _require_alone(number, placing, out)
            out.append(placing)
        elif isinstance(step, Work):
            out.append(_work_step(cell, step, known, assembly.touch))
        else:
            at, touched = where[step.part], dict.fromkeys(step.parts, 0.0)
            out.append(replace(known, place=at, touched=touched))
    return tuple(out)


def steps_in_order(
    cell: Workcell, assembly: PartAssembly
) -> Iterator[tuple[int, AnyStep, dict[str, Transform], Transform]]:
    """Yield the steps with numbers from 1, and the poses of all parts as each begins.

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
            goal = assembly.goals[step.part] if stop is None else spot_pose(cell, stop)
        yield number, step, dict(where), goal
        if isinstance(step, PlacePart):
            where[step.part] = goal
        if number in supply.refills:
            where |= supply.refills[number].parts
        if number in supply.leaves:
            for name, _ in supply.leaves[number].parts:
                del where[name]


def objects_at_step(
    cell: Workcell, where: Mapping[str, Transform], but: str
) -> dict[str, PlacedObject]:
    """Return fixtures and parts at their poses as a step begins, one part excluded, by name."""
    return standing_fixtures(cell) | {
        item.name: (item, where[item.name])
        for item in cell.objects
        if item.name in where and item.name != but
    }


def sort_grips_by_clearance(step: KnownStep) -> list[int]:
    """Return the grips on a held part, those first that leave the other robot most room."""
    assert step.held is not None
    held, work = step.held, step.place[:3, 3]

    def near(k: int) -> float:
        at = (held.pose @ held.grips[k].pose)[:3, 3]
        return -round(float(np.linalg.norm(at - work)), 6)

    return sorted(range(len(held.grips)), key=near)


def place_step(
    cell: Workcell,
    assembly: PartAssembly,
    number: int,
    step: PlacePart,
    known: KnownStep,
) -> PartStep:
    """Return a step in which a part is placed.

    Args:
        cell: its objects are the parts.
        assembly: how parts are handled.
        number: of the step.
        step: what is placed.
        known: where that is put, and all parts around, itself included where it lies.

    Raises:
        InfeasibleStepError: the part would hang in the air, or goes where something is.
    """
    name, goal, around = step.part, known.place, dict(known.around)
    _, at = around.pop(name)
    part = replace(cell.object(name), start=at.pose)
    placed = standing_fixtures(cell) | replace(known, around=around).others
    touched = nearby_entities((part, goal), placed, assembly.touch)
    if not touched and not assembly.joined_to(name):
        raise InfeasibleStepError(
            f"step {number} ({name}) would leave it in the air: it touches neither a fixture nor a part"
            f" that is there by then; {describe_nearest(name, (part, goal), placed)}",
            steps=[number],
            thing=name,
        )
    _require_room(number, name, (part, goal), placed, assembly.overlaps)
    at_start = nearby_entities((part, part.start), placed, assembly.touch)
    rules = assembly.handling(name).grips
    robots = list(with_each_tool(cell.robots))
    grips = tool_grips(robots, part.shape, part.start, goal, rules)
    return PartStep(step, goal, around, touched, known.held, part, grips, at_start)


def require_clear_insertion(
    cell: Workcell, assembly: PartAssembly, steps: Iterable[KnownStep]
) -> None:
    """Check that straight paths of parts avoid their own neighbours, in place and at the start.

    As it may be touched, it is not looked at as an obstacle. What is in each other at the start
    already is a mistake of another kind.

    Raises:
        InfeasibleStepError: a part would go through something; says what helps.
    """
    for number, step in enumerate(steps, start=1):
        if not isinstance(step, PartStep):
            continue
        part, handling = step.part, assembly.handling(step.part.name)
        placed = standing_fixtures(cell) | step.others
        for place, touched, direction, length, words in (
            (
                step.place,
                step.touched,
                np.array(handling.insertion),
                handling.approach,
                _IN,
            ),
            (
                part.start,
                step.at_start,
                -np.array(handling.extraction),
                handling.leave,
                _OUT,
            ),
        ):
            for other in sorted(touched):
                most = assembly.overlaps.most(part.name, other)
                if overlap_depth((part, place), placed[other]) > most:
                    continue  # a mistake of another kind
                way = (part, place), placed[other], direction, length, most
                if sweeps_through(*way):
                    raise InfeasibleStepError(
                        f"step {number} ({part.name}) leads through {other} on the straight way"
                        f" {words}",
                        steps=[number],
                        thing=part.name,
                        blocked_by=[other],
                    )


def _require_room(
    number: int,
    name: str,
    part: PlacedObject,
    placed: Mapping[str, PlacedObject],
    overlaps: Overlaps,
) -> None:
    deep = overlaps.is_too_deep(name, part, placed)
    if not deep:
        return
    other = max(deep, key=deep.__getitem__)
    raise InfeasibleStepError(
        f"step {number} ({name}) goes where {other} is: they would overlap by"
        f" {overlaps.words(name, other, deep[other])}",
        steps=[number],
        thing=name,
        blocked_by=[other],
    )


def _work_step(cell: Workcell, step: Work, known: KnownStep, touch: float) -> KnownStep:
    owner, others = step.spot.owner, known.others
    place = spot_pose(cell, step.spot, {name: at for name, (_, at) in others.items()})
    touched = {} if owner is None else {owner: 0.0}
    grain = box_shape("tip", np.full(3, 1e-4))
    for at in step.process.path or (np.eye(4),):
        tip = Fixture("tip", grain, place @ at)
        touched |= nearby_entities(
            (tip, tip.pose), standing_fixtures(cell) | others, touch + TIP
        )
    return replace(known, place=place, touched=touched)


def spot_pose(
    cell: Workcell, spot: Spot, parts: Mapping[str, Transform] | None = None
) -> Transform:
    """Return the pose of a spot in the world, given the current poses of parts."""
    base = (parts or {}).get(spot.owner or "", np.eye(4))
    for item in cell.fixtures:
        if item.name == spot.owner:
            inside = np.eye(4) if spot.frame is None else item.frames[spot.frame]
            base = item.pose @ inside
    return read_only_copy(base @ spot.pose)


def _require_alone(number: int, step: PartStep, before: Iterable[KnownStep]) -> None:
    """Refuse to pick up a part from where it was put down if another one was joined to it there."""
    part, moved = step.part.name, False
    leant: set[str] = set()
    for other in before:
        if not isinstance(other, PartStep):
            continue
        leant.discard(other.part.name)
        if other.part.name == part:
            moved, leant = True, set()
        elif moved and part in other.touched:
            leant.add(other.part.name)
    if leant:
        raise InfeasibleStepError(
            f"step {number} ({step.step.words}): {min(leant)} was put to it where it lies; what is"
            " put to a part must wait until that is in its place",
            steps=[number],
            thing=part,
        )


def objects_in_place(cell: Workcell, assembly: PartAssembly) -> dict[str, PlacedObject]:
    """Return fixtures, parts in their places, and unplaced parts at their starts, by name."""
    placed = standing_fixtures(cell)
    for item in cell.objects:
        if item.name in assembly.goals:
            placed[item.name] = item, assembly.goals[item.name]
        elif not item.later:
            placed[item.name] = item, item.start
    return placed


def format_room(gap: float) -> float:
    """Return a distance in whole millimetres, rounded up [m]."""
    return math.ceil(round(gap * 1e3, 3)) / 1e3


def wide_joints(cell: Workcell, assembly: PartAssembly) -> Iterator[tuple[Joint, str]]:
    """Yield joints wider in place than their stated gap, with words.

    Args:
        cell: its objects are the parts.
        assembly: goals, joints, and what touches.
    """
    placed = objects_in_place(cell, assembly) if assembly.joints else {}
    for joint in assembly.joints:
        first, second = joint.first, joint.second
        most = assembly.touch + joint.gap
        if nearby_entities(placed[first], {second: placed[second]}, most):
            continue
        (gap,) = nearby_entities(
            placed[first], {second: placed[second]}, math.inf
        ).values()
        others = {k: v for k, v in placed.items() if k not in (first, second)}
        said = f", gap_m {joint.gap:g}" if joint.gap else ""
        yield (
            joint,
            f"{first} and {second} are joined across {gap * 1e3:.1f} mm of air, and may be"
            f" {most * 1e3:g} mm apart (touch_m {assembly.touch:g}{said}): put them nearer, or say the room"
            f" of what is between them (joined: {{parts: [{first}, {second}], gap_m: {format_room(gap):g}}}); of all"
            f" else {describe_nearest(second, placed[second], others)}",
        )


@dataclass(frozen=True)
class PartFit:
    """The fit of a part at the place of a step.

    Attributes:
        step: counted from 1.
        part: its name.
        play: across its insertion path.
        robots: that may do the step; all of the cell where it does not say.
    """

    step: int
    part: str
    play: Play
    robots: tuple[str, ...]

    @property
    def words(self) -> str:
        """Description for people: ``peg in block: 0.21 mm on all sides``."""
        return f"{self.part} in {' and '.join(self.play.guides)}: {self.play.words}"


def part_fits(cell: Workcell, assembly: PartAssembly) -> Iterator[PartFit]:
    """Yield the fits of parts that are guided into their places.

    Args:
        cell: its objects are the parts.
        assembly: its steps in order.
    """
    for number, step, where, goal in steps_in_order(cell, assembly):
        if not isinstance(step, PlacePart):
            continue
        others = objects_at_step(cell, where, but=step.part)
        way = np.array(assembly.handling(step.part).insertion)
        found = play_in_place((cell.object(step.part), goal), others, way)
        if found is not None:
            robots = tuple(r.name for r in cell.robots if step.done_by(r.name))
            yield PartFit(number, step.part, found, robots)
