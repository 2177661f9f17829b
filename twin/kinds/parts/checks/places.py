"""Checks of goals (overlap, support and balance of parts), and of the poses for processes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from planning.cell.shape import Shape
from planning.cell.workcell import Fixture, PlacedRobot
from planning.contacts.touching import (
    PlacedObject,
    describe_nearest,
    nearby_entities,
    nearest_entity,
    standing_fixtures,
)
from planning.grips.tool_grips import tool_bodies
from planning.parts.assembly import MachineWork, PlacePart, Process
from planning.parts.part_skills import process_targets
from planning.parts.part_steps import (
    KnownStep,
    objects_at_step,
    steps_in_order,
    wide_joints,
)
from planning.transforms import Transform, inverse
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    format_millimetres,
    format_position,
    name_in_file,
)
from twin.document.yaml_text import KeyPath
from twin.kinds.parts.checks.context import for_part_assemblies
from twin.kinds.parts.ordered_parts import OrderedParts
from twin.kinds.parts.section import MachineSection

_WORK_DISTANCE = 0.02
"""Largest distance of a tool from the nearest part in a process, unless the process gives one [m]."""

_MACHINE_REACH = 0.5
"""Largest distance of a machine's parts from its door, and from each other [m]."""


@for_part_assemblies
def check_goals(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield parts that overlap or are unsupported at their goals."""
    cell, section, assembly = parts.cell_without_alike_parts, parts.section, parts.found
    if isinstance(assembly, str):
        yield Finding(("assembly", "steps"), assembly, error=True)
        return
    for number, step, where, goal in steps_in_order(cell, assembly):
        if not isinstance(step, PlacePart):
            continue
        name = step.part
        at, place = subject.thing_at(name, "goal"), "in its place"
        if step.stop is not None:
            at, place = parts.step_at(number, "at"), f"at {step.stop.words}"
        lying = objects_at_step(cell, where, but=name)
        overlaps, part = assembly.overlaps, (cell.object(name), goal)
        touched = nearby_entities(part, lying, section.touch_m)
        for other, deep in overlaps.is_too_deep(name, part, lying).items():
            when = "is" if where.get(other) is not None else "stands"
            yield Finding(
                at,
                f"{name} goes where {other} {when} by then: they would overlap by"
                f" {overlaps.words(name, other, deep)}",
                error=True,
                code="overlap",
                parts=(name, other),
                figures=(deep,),
            )
        if not touched and not assembly.joined_to(name):
            near = describe_nearest(name, part, lying)
            yield Finding(
                at,
                f"{name} would be left in the air: {place} it touches neither a fixture nor a"
                f" part that is there by then (touch_m {section.touch_m:g}); {near}",
                error=True,
                code="unsupported",
                parts=(name,),
            )


@for_part_assemblies
def check_joints(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield joints whose parts are farther apart than the joint allows."""
    listed = [set(item.parts) for item in parts.section.joined]
    known = set().union(*listed)
    for joint, words in wide_joints(subject.cell, parts.listed):
        own = {name_in_file(name, known) for name in joint.ends}
        yield Finding(
            ("assembly", "joined", listed.index(own)),
            words,
            error=True,
            code="apart",
            parts=joint.ends,
        )


@for_part_assemblies
def check_balance(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield the first part that would fall, in assembly order."""
    from planning.parts.balance import PartBalance, balance_groups

    if parts.steps is None or parts.listed.balance is None:
        return
    gone = parts.listed.supply.leaves.keys()
    for _, own, rule in balance_groups(parts.steps, parts.listed.balance, gone):
        balance = PartBalance(subject.cell, own, rule)
        if balance.fall is not None:
            yield Finding(
                subject.thing_at(balance.fall.body, "goal"),
                balance.refusal(balance.fall),
                error=True,
            )
            return


@for_part_assemblies
def check_works(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield processes whose tool stays far from all parts.

    Processes of tools that work at a distance give it as ``distance_m``.
    """
    seen = set[KeyPath]()
    for number, known, step, robots in parts.works():
        at = parts.step_at(number)
        if at in seen:
            continue  # of another product
        seen.add(at)
        lying = standing_fixtures(subject.cell) | known.others
        there = {name: lying[name] for name in known.touched} or lying
        found = [
            (gap, robot.name, name)
            for robot in robots
            for name, gap in _nearest(robot, known, step.process, there)
        ]
        room = parts.section.processes[step.process.name].distance_m
        if not found or min(found)[0] <= _WORK_DISTANCE + room:
            continue
        gap, robot, name = min(found)
        said = f"distance_m {room:g} says" if room else "works at"
        yield Finding(
            at,
            f"{step.words}: the tool of {robot} stays {format_millimetres(gap)} away from {name}, the nearest that it"
            f" could work at, and at most {format_millimetres(_WORK_DISTANCE + room)} is what a tool {said}: move the place"
            f" of work or the tool's frame {step.process.frame!r}; for what works at a distance, such as a"
            f" camera, say processes.{step.process.name}.distance_m",
        )


def _nearest(
    robot: PlacedRobot,
    known: KnownStep,
    process: Process,
    others: Mapping[str, PlacedObject],
) -> Iterator[tuple[str, float]]:
    """Yield the nearest thing to a robot's tool at each pose of its path, with distance [m]."""
    body = Shape((), tuple(tool_bodies(robot.model)))
    tip = inverse(robot.model.frame_in_last_joint(process.frame))
    execution = process_targets(process, known.place, process.turns[0])
    for goal in execution.targets.subgoals[execution.first : execution.last + 1]:
        pose: Transform = goal.pose @ tip
        found = nearest_entity((Fixture("tool", body, pose), pose), others)
        if found is not None:
            yield found


@for_part_assemblies
def check_machines(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield machines that work far from their fixtures, or at unknown places.

    If a machine names its fixtures, its parts must lie on them. If not, the machine is assumed where its parts
    are, so steps must bring them all to one place.
    """
    if isinstance(parts.found, str):
        return
    cell, machines, moved = subject.cell, parts.section.machines, set[str]()
    places: dict[str, Transform] = {}
    machined = {process.machine for process in parts.section.processes.values()}
    listed = steps_in_order(cell, parts.listed)
    works = (
        (number, step, part, where)
        for number, step, where, _ in listed
        for part in (step.parts if isinstance(step, MachineWork) else ("",))
    )
    for number, step, part, where in works:
        if isinstance(step, PlacePart):
            moved.add(step.part)
        if not isinstance(step, MachineWork) or step.machine not in machined:
            continue  # unattended processes need no machine, such as glue that cures
        name, pose = step.machine, where[part]
        own = machines.get(name, MachineSection())
        at, lying = parts.step_at(number), (cell.object(part), pose)
        first = places.setdefault(name, pose)
        spread = float(np.linalg.norm(pose[:3, 3] - first[:3, 3]))
        tell = f"machines.{name}.fixtures says where it stands"
        if own.fixtures:
            named = {
                k: v for k, v in standing_fixtures(cell).items() if k in own.fixtures
            }
            nearest = nearest_entity(lying, named)
            if nearest is not None and not nearby_entities(
                lying, named, parts.section.touch_m
            ):
                yield Finding(
                    at,
                    f"{name} works at {part}, which lies on none of its fixtures by then: {nearest[0]} is"
                    f" {format_millimetres(nearest[1])} away (touch_m {parts.section.touch_m:g}); put it there before"
                    " ({place: PART, at: {fixture: NAME}}), or change machines."
                    + name
                    + ".fixtures",
                    error=True,
                    code="off fixtures",
                    parts=(part, nearest[0]),
                    figures=(nearest[1],),
                )
        elif (
            gap := _from_door(own, lying, subject)
        ) is not None and gap > _MACHINE_REACH:
            yield Finding(
                at,
                f"{name} works at {part} {gap:.2f} m away from its door: {tell}",
                code="off door",
                parts=(part,),
                figures=(gap,),
            )
        elif spread > _MACHINE_REACH:
            yield Finding(
                at,
                f"{name} works at {part} {spread:.2f} m away from where it worked before, at"
                f" {format_position(first[:3, 3].tolist())}: one of the two is not in the machine; {tell}",
                code="two places",
                parts=(part,),
                figures=(spread, *first[:3, 3].tolist()),
            )
        elif part not in moved and own.door is None:
            yield Finding(
                at,
                f"{name} works at {part} where that lies at the start, at"
                f" {format_position(pose[:3, 3].tolist())}: no step brings it to the machine; {tell}",
                code="not brought",
                parts=(part,),
                figures=tuple(pose[:3, 3].tolist()),
            )


def _from_door(
    own: MachineSection, lying: PlacedObject, subject: CheckContext
) -> float | None:
    """Return the distance of a part from a machine's door, None without a door [m]."""
    if own.door is None:
        return None
    from twin.planning.shapes import build_shape

    shape = build_shape("door", own.door.described, subject.folder)
    pose = own.door.pose.transform()
    found = nearest_entity(lying, {"door": (Fixture("door", shape, pose), pose)})
    return None if found is None else max(0.0, found[1])
