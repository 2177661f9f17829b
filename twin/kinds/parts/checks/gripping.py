"""Checks of tool orientations that steps need, and of clearance between tools and neighbouring parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from planning.cell.shape import Shape
from planning.cell.workcell import Fixture, PlacedRobot
from planning.contacts.touching import PlacedObject, nearby_entities
from planning.grips.pads import own_bodies
from planning.grips.tool_grips import robot_grips
from planning.motion.sequential import MARGIN
from planning.parts.assembly import PlacePart
from planning.parts.part_skills import process_targets
from planning.parts.part_steps import objects_at_step, steps_in_order
from planning.transforms import Array, inverse, translation
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    format_millimetres,
    name_in_file,
)
from twin.kinds.parts.checks.context import for_part_assemblies
from twin.kinds.parts.checks.orientations import (
    can_turn,
    direction_words,
    turning_axes,
    turning_words,
)
from twin.kinds.parts.ordered_parts import OrderedParts
from twin.kinds.parts.sources import TraySection

_LARGEST_LIFT, _LIFT_STEP = 0.5, 0.005
"""Largest lift, and step, of the search for a sufficient lift [m]."""

_MOST_NAMED = 4
"""Most orientations that a message names."""


@for_part_assemblies
def check_turning(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield parts and process poses that need a tool orientation outside the reach of every robot."""
    assembly, frame = parts.listed, parts.listed.frame
    for _, step, where, end in steps_in_order(subject.cell, assembly):
        if not isinstance(step, PlacePart):
            continue
        name, start = step.part, where[step.part]
        shape, rules = subject.cell.object(name).shape, assembly.handling(name).grips
        robots = _robots_for(subject, step, frame)
        ends = [("start", start, start), ("goal", end, end)]
        # A robot that can reorient a part may put it down and regrip it.
        if not any(turning_axes(robot) for robot in robots):
            ends.append(("goal", start, end))
        for key, *poses in ends:
            wanted = [
                (robot, [(pose @ grip.pose)[:3, :3] for pose in poses])
                for robot in robots
                for grip in robot_grips(robot, shape, poses[0], poses[0], rules)
            ]
            if found := _missing_orientation(wanted, frame):
                at = subject.thing_at(name, key)
                yield Finding(
                    at,
                    f"{name} cannot be gripped: {found}",
                    error=True,
                    code="not gripped",
                    parts=(name,),
                )
                break
    for number, known, work, robots in parts.works():
        targets = (
            process_targets(work.process, known.place, turn).targets.subgoals
            for turn in work.process.turns
        )
        orientations = [[goal.pose[:3, :3] for goal in own] for own in targets]
        wanted = [
            (robot, orientation) for robot in robots for orientation in orientations
        ]
        if found := _missing_orientation(wanted, work.process.frame):
            at = parts.step_at(number)
            words = f"{work.words} cannot be done: {found}"
            owner = work.spot.owner or ""
            yield Finding(at, words, error=True, code="not done", parts=(owner,))


def _missing_orientation(
    wanted: Sequence[tuple[PlacedRobot, list[Array]]], frame: str
) -> str:
    """Return the reachable and the needed orientations as text, empty if some robot reaches the needed ones.

    Args:
        wanted: robots, each with the orientations that one alternative of the step needs, in the world, shape (3, 3).
        frame: of their tools.
    """
    if not wanted or any(
        all(can_turn(r, frame, at) for at in orientation) for r, orientation in wanted
    ):
        return ""
    needed = dict.fromkeys(
        " then ".join(
            f"{direction_words(at[:, 2])}, y axis {direction_words(at[:, 1])}"
            for at in {
                at.tobytes(): at for at in (orientation[0], orientation[-1])
            }.values()
        )
        for _, orientation in wanted
    )
    can = dict.fromkeys(f"{r.name}: {turning_words(r, frame)}" for r, _ in wanted)
    return f"{'; '.join(can)}; needed: {'; or '.join([*needed][:_MOST_NAMED])}"


def _robots_for(
    subject: CheckContext, step: PlacePart, frame: str
) -> list[PlacedRobot]:
    """Return the robots allowed for a step that have its frame."""
    robots = (r for r in subject.cell.robots if frame in {"flange", *r.model.frames})
    return [robot for robot in robots if step.done_by(robot.name)]


@for_part_assemblies
def check_room(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield parts without clearance for any tool and grip next to their neighbours.

    The first step with one of several interchangeable parts may take any of them: it is reported only if all
    lack clearance.
    """
    assembly, cell = parts.found, parts.cell
    if isinstance(assembly, str):
        return
    groups = {name: group for group in assembly.alike for name in group}
    seen: set[str] = set()
    for _, step, where, end in steps_in_order(cell, assembly):
        if not isinstance(step, PlacePart) or step.part in seen:
            continue
        name, group = step.part, groups.get(step.part, (step.part,))
        seen.update(group if len(group) > 1 else ())
        robots = _robots_for(subject, step, assembly.frame)
        starts = [(own, where[own]) for own in group if own in where]
        for key, ends in (("start", starts), ("goal", [(name, end)])):
            if key == "goal" and len(group) > 1:
                continue
            found = [
                _missing_clearance(
                    parts,
                    robots,
                    (cell.object(own), at),
                    objects_at_step(cell, where, own),
                )
                for own, at in ends
            ]
            if found and found[0] and all(found):
                yield _no_room(subject, parts, name, key, *found[0])
                break


def _missing_clearance(
    parts: OrderedParts,
    robots: Sequence[PlacedRobot],
    part: PlacedObject,
    placed: Mapping[str, PlacedObject],
) -> tuple[float, str, str] | None:
    """Return the smallest missing clearance over the grips of a part [m], the neighbour, and the grip.

    Returns:
        None where some grip has enough clearance, or there is no grip.
    """
    (item, at), found = part, list[tuple[float, str, str]]()
    rules = parts.listed.handling(item.name).grips
    clear = parts.cell.clearances.robot_object - 1e-6
    for robot in robots:
        body = Shape((), tuple(own_bodies(robot.model)))
        if not body.pieces:
            return None
        tip = inverse(robot.model.frame_in_last_joint(rules.frame))
        for grip in robot_grips(robot, item.shape, at, at, rules):
            pose = at @ grip.pose @ tip
            near = nearby_entities((Fixture("tool", body, pose), pose), placed, clear)
            if not near:
                return None
            neighbour = min(near, key=lambda name: near[name])
            words = f"{grip.words} by {robot.name}"
            found.append((clear - near[neighbour], neighbour, words))
    return min(found, default=None)


def _no_room(
    subject: CheckContext,
    parts: OrderedParts,
    name: str,
    key: str,
    lack: float,
    neighbour: str,
    grip: str,
) -> Finding:
    """Return the finding on a part without room: an error at ``pitch_m`` where its source puts parts too close together."""
    at, remedy = subject.thing_at(name, key), "move one of the two"
    sources = {
        part.name: part.source
        for part in parts.section.parts
        if isinstance(part.source, str)
    }
    own, other = (sources.get(name_in_file(n, sources)) for n in (name, neighbour))
    source = parts.section.sources.get(own or "")
    in_source = key == "start" and own == other and source is not None
    if in_source:
        pitch = ("grid", "pitch_m") if isinstance(source, TraySection) else ("pitch_m",)
        at, remedy = (
            ("assembly", "sources", str(own), *pitch),
            "give a larger pitch_m or another order",
        )
    where = "where it lies" if key == "start" else "in its place"
    return Finding(
        at,
        f"no grip on {name} has room beside its neighbours {where}: {grip} lacks least, {format_millimetres(lack)}"
        f" beside {neighbour}; {remedy}, or take a slimmer tool",
        error=in_source,
        code="no room",
        parts=(name, neighbour),
        figures=(lack,),
    )


@for_part_assemblies
def check_lifts(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield parts whose lift does not clear the next part, such as on a conveyor."""
    assembly, cell = parts.listed, parts.cell
    clear = cell.clearances.robot_object + MARGIN - 1e-9
    for number, step, where, _ in steps_in_order(cell, assembly):
        refill = assembly.supply.refills.get(number)
        if refill is None or not isinstance(step, PlacePart):
            continue
        name, orientations, part = (
            step.part,
            assembly.handling(step.part),
            cell.object(step.part),
        )
        coming = {k: (cell.object(k), at) for k, at in dict(refill.parts).items()}
        lengths = orientations.leave + np.arange(0.0, _LARGEST_LIFT, _LIFT_STEP)
        out = [
            translation(*(x * np.array(orientations.extraction)))
            for x in lengths.tolist()
        ]
        near = [nearby_entities((part, up @ where[name]), coming, clear) for up in out]
        if first := near[0]:
            other = min(first, key=lambda k: first[k])
            remedy = f": {lengths[near.index({})]:.3f} is enough" if {} in near else ""
            own = {p.name: p.leave_m for p in parts.section.parts}
            has_own = own[name_in_file(name, own)] is not None
            yield Finding(
                subject.thing_at(name, "leave_m")
                if has_own
                else ("assembly", "leave_m"),
                f"{name} is lifted by leave_m {orientations.leave:g}, and then {other} comes up where it lay, at a"
                f" distance of {format_millimetres(abs(first[other]))}; lift it farther{remedy}",
                error=True,
                code="lift",
                parts=(name, other),
                figures=(orientations.leave, abs(first[other])),
            )
