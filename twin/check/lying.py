"""Checks of what lies somewhere, and what is done to it: overlaps, what hangs or falls, places of work."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from planning.cell.shape import Mesh, Shape
from planning.cell.workcell import Fixture, PlacedRobot
from planning.contacts.interference import Overlaps, depth, depth_words
from planning.geometry.touching import (
    Lying,
    bounds,
    near_to,
    nearest_to,
    nearest_words,
    standing,
)
from planning.grips.tool_grips import tool_bodies
from planning.kinematics.kinematics import frame_in_last_joint
from planning.meshes.holes import open_share
from planning.parts.assembly import MachineWork, PlacePart, Process
from planning.parts.part_skills import process_targets
from planning.parts.part_steps import (
    KnownStep,
    lying_by_then,
    steps_in_order,
    wide_joints,
)
from planning.transforms import Transform, inverse
from twin.check.finding import (
    Finding,
    Findings,
    OrderedParts,
    Subject,
    in_file,
    millimetres,
    of_parts,
    position,
)
from twin.kinds.lego.section import LegoSection
from twin.kinds.parts.section import MachineSection, PartsSection

_TOUCH = 0.002
"""Distance up to which things touch where the scenario does not say [m]."""

_MISPLACED = 0.002
"""A centre of mass no farther outside of its part is one of a measured part [m]."""

_MERGED = 0.005
"""Fixtures of one piece of furniture may overlap by this [m]."""


def check_starts(subject: Subject) -> Findings:
    """Yield what overlaps at the start, and what lies on nothing."""
    cell, touch = subject.cell, _touch(subject)
    there = [item for item in cell.objects if not item.later]
    lying: list[tuple[str, Lying]] = [(item.name, (item, item.start)) for item in there]
    lying += list(standing(cell).items())
    moved = {item.name for item in there if not item.fixed}
    things = dict(lying)
    overlaps = Overlaps() if subject.parts is None else subject.parts.listed.overlaps
    touched: dict[str, set[str]] = {}
    for one, other, gap in close_pairs(lying, touch, first=len(there)):
        most = overlaps.most(one, other)
        deep = depth(things[one], things[other]) if -gap > most else 0.0
        if deep > most:
            movable = one in moved or other in moved
            yield Finding(
                subject.thing_at(one, "start"),
                f"{one} and {other} overlap by {depth_words(deep)} at the start, and may by"
                f" {depth_words(most)}: no two things can be in one place",
                error=movable,
            )
        touched.setdefault(one, set()).add(other)
        touched.setdefault(other, set()).add(one)
    resting = {item.name for item in cell.fixtures}
    ahead = list(resting)
    while ahead:
        for name in touched.get(ahead.pop(), set()) - resting:
            resting.add(name)
            ahead.append(name)
    for item in there:
        if item.name not in resting:
            yield Finding(
                subject.thing_at(item.name, "start"),
                f"{item.name} hangs in the air at the start: nothing that stands on a fixture is"
                f" within {millimetres(touch)} of it{_below(lying, item.name)}",
            )


@of_parts
def check_goals(subject: Subject, parts: OrderedParts) -> Findings:
    """Yield parts of an assembly that overlap, or hang in the air, in their places."""
    cell, section, assembly = parts.there, parts.section, parts.found
    if isinstance(assembly, str):
        yield Finding(("assembly", "steps"), assembly, error=True)
        return
    for number, step, where, goal in steps_in_order(cell, assembly):
        if not isinstance(step, PlacePart):
            continue
        name = step.part
        at, place = subject.thing_at(name, "goal"), "in its place"
        if step.stop is not None:
            at, place = subject.step_at(number, "at"), f"at {step.stop.words}"
        lying = lying_by_then(cell, where, but=name)
        overlaps, part = assembly.overlaps, (cell.object(name), goal)
        touched = near_to(part, lying, section.touch_m)
        for other, deep in overlaps.too_deep(name, part, lying).items():
            when = "is" if where.get(other) is not None else "stands"
            yield Finding(
                at,
                f"{name} goes where {other} {when} by then: they would overlap by"
                f" {overlaps.words(name, other, deep)}",
                error=True,
            )
        if not touched and not assembly.joined_to(name):
            near = nearest_words(name, part, lying)
            yield Finding(
                at,
                f"{name} would be left in the air: {place} it touches neither a fixture nor a"
                f" part that is there by then (touch_m {section.touch_m:g}); {near}",
                error=True,
            )


@of_parts
def check_joints(subject: Subject, parts: OrderedParts) -> Findings:
    """Yield what is joined to something that is farther from it than the joint says."""
    listed = [set(item.parts) for item in parts.section.joined]
    known = set().union(*listed)
    for joint, words in wide_joints(subject.cell, parts.listed):
        own = {in_file(name, known) for name in joint.ends}
        yield Finding(("assembly", "joined", listed.index(own)), words, error=True)


def check_centres(subject: Subject) -> Findings:
    """Yield parts whose centre of mass is outside the box around them, where none can be."""
    for item in subject.cell.objects:
        shape = item.shape
        if shape.own_centre is None:
            continue
        beyond = np.maximum(shape.low - shape.own_centre, shape.own_centre - shape.high)
        if (farthest := float(np.max(beyond))) > _MISPLACED:
            low, high = position(shape.low.tolist()), position(shape.high.tolist())
            yield Finding(
                subject.thing_at(item.name, "centre_of_mass_m"),
                f"the centre of mass of {item.name} is {millimetres(farthest)} outside it: in the frame of its"
                f" shape it reaches from {low} to {high}",
            )


@of_parts
def check_balance(subject: Subject, parts: OrderedParts) -> Findings:
    """Yield the first part that would fall, in the order in which parts are put in place."""
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


def check_fixtures(subject: Subject) -> Findings:
    """Yield fixtures of the file that are in each other; boxes of one thing may be, a little."""
    lying = [
        (name, item)
        for name, item in standing(subject.cell).items()
        if name in subject.own_fixtures
    ]
    for one, other, gap in close_pairs(lying, 0.0):
        if gap < -_MERGED:
            yield Finding(
                subject.thing_at(other),
                f"fixtures {one} and {other} overlap by {millimetres(-gap)}: harmless if they are one"
                " thing, a mistake if not",
            )


def close_pairs(
    lying: Sequence[tuple[str, Lying]], within: float, *, first: int | None = None
) -> Iterator[tuple[str, str, float]]:
    """Yield what is near each other, with the distance, negative for overlap [m].

    Args:
        lying: names, and what lies where.
        within: greatest distance [m].
        first: one of each pair is among so many first ones; by default any.
    """
    if not lying:
        return
    corners = np.array([bounds(item) for _, item in lying])
    centre = 0.5 * (corners[:, 0] + corners[:, 1])
    half = 0.5 * (corners[:, 1] - corners[:, 0])
    for i in range(len(lying) if first is None else first):
        apart = np.abs(centre[i + 1 :] - centre[i]) - half[i + 1 :] - half[i]
        near = i + 1 + np.flatnonzero(np.all(apart <= within, axis=1))
        others = dict(lying[j] for j in near.tolist())
        for other, gap in near_to(lying[i][1], others, within).items():
            yield lying[i][0], other, gap


def _touch(subject: Subject) -> float:
    section = subject.scenario.assembly
    return section.touch_m if isinstance(section, PartsSection) else _TOUCH


def _below(lying: Sequence[tuple[str, Lying]], name: str) -> str:
    """Return what is below a thing, and how far, in words."""
    things: Mapping[str, Lying] = dict(lying)
    low, high = bounds(things[name])
    best: tuple[float, str] | None = None
    for other, item in things.items():
        other_low, other_high = bounds(item)
        beside = np.any(low[:2] > other_high[:2]) or np.any(high[:2] < other_low[:2])
        drop = float(low[2] - other_high[2])
        if other == name or beside or drop < 0.0:
            continue
        if best is None or drop < best[0]:
            best = drop, other
    return "" if best is None else f"; {best[1]} is {millimetres(best[0])} below"


_MISSED = 1e-4
"""So much of a surface may be outside of all pieces before it is worth a word [m]."""


_OPEN = 0.005
"""A mesh of which no more is missing is closed but for cracks, share of its surface."""


def check_meshes(subject: Subject) -> Findings:
    """Yield meshes with holes, and those with surface outside of the pieces that stand for them."""
    things = [(f.name, f.shape) for f in subject.cell.fixtures]
    things += [(o.name, o.shape) for o in subject.cell.objects]
    meshes = [
        (name, element.form)
        for name, shape in things
        for element in shape.elements
        if isinstance(element.form, Mesh)
    ]
    for name, mesh in meshes:
        at, missing = (
            subject.thing_at(name, "shape"),
            open_share(mesh.vertices, mesh.faces),
        )
        if mesh.missed > _MISSED:
            yield Finding(
                at,
                f"the surface of {name} is up to {millimetres(mesh.missed)} outside"
                " of the convex pieces that planning sees: close its holes, or give a smaller"
                " within_m",
            )
        if missing > _OPEN:
            yield Finding(
                at,
                f"the surface of {name} is open: {100 * missing:.2g} % of it is missing in the mesh {mesh.source}, and"
                f" usual is at most {100 * _OPEN:g} %; planning closes the holes, which may not be what was meant:"
                " close them in the file",
            )


_BRIDGED = 0.02
"""A tool that stays no farther than this from what it works at works at it [m]."""

_BESIDE = 0.5
"""A machine works at parts no farther than this from its door, and from each other [m]."""


@of_parts
def check_works(subject: Subject, parts: OrderedParts) -> Findings:
    """Yield processes in which the tool stays far from all that they are done at.

    Some tools do work at a distance, and their processes say at which (``distance_m``).
    """
    for number, known, step, robots in parts.works():
        if number > parts.count:
            continue  # of another product
        lying = standing(subject.cell) | known.others
        there = {name: lying[name] for name in known.touched} or lying
        found = [
            (gap, robot.name, name)
            for robot in robots
            for name, gap in _nearest(robot, known, step.process, there)
        ]
        room = parts.section.processes[step.process.name].distance_m
        if not found or min(found)[0] <= _BRIDGED + room:
            continue
        gap, robot, name = min(found)
        said = f"distance_m {room:g} says" if room else "works at"
        yield Finding(
            subject.step_at(number),
            f"{step.words}: the tool of {robot} stays {millimetres(gap)} away from {name}, the nearest that it"
            f" could work at, and at most {millimetres(_BRIDGED + room)} is what a tool {said}: move the place"
            f" of work or the tool's frame {step.process.frame!r}; for what works at a distance, such as a"
            f" camera, say processes.{step.process.name}.distance_m",
        )


def _nearest(
    robot: PlacedRobot, known: KnownStep, process: Process, there: Mapping[str, Lying]
) -> Iterator[tuple[str, float]]:
    """Yield what is nearest to the tool of a robot at each pose of its path, and how far it is [m]."""
    body = Shape((), tuple(tool_bodies(robot.model)))
    tip = inverse(frame_in_last_joint(robot.model, process.frame))
    way = process_targets(process, known.place, process.turns[0])
    for goal in way.targets.subgoals[way.first : way.last + 1]:
        pose: Transform = goal.pose @ tip
        found = nearest_to((Fixture("tool", body, pose), pose), there)
        if found is not None:
            yield found


@of_parts
def check_machines(subject: Subject, parts: OrderedParts) -> Findings:
    """Yield machines that work at parts elsewhere than they stand, or nowhere that anybody tells.

    Where a machine names its fixtures, a part that lies on none of them cannot be worked at. Where it does
    not, it stands where its parts are brought to; so they are to be brought, and to one place.
    """
    if isinstance(parts.found, str):
        return
    cell, machines, moved = subject.cell, parts.section.machines, set[str]()
    places: dict[str, Transform] = {}
    machined = {process.machine for process in parts.section.processes.values()}
    for number, step, where, _ in steps_in_order(cell, parts.listed):
        if isinstance(step, PlacePart):
            moved.add(step.part)
        if not isinstance(step, MachineWork) or step.machine not in machined:
            continue  # nobody does what needs no machine, such as glue that cures
        name, pose = step.machine, where[step.part]
        own = machines.get(name, MachineSection())
        at, lying = subject.step_at(number), (cell.object(step.part), pose)
        first = places.setdefault(name, pose)
        spread = float(np.linalg.norm(pose[:3, 3] - first[:3, 3]))
        tell = f"machines.{name}.fixtures says where it stands"
        if own.fixtures:
            named = {k: v for k, v in standing(cell).items() if k in own.fixtures}
            nearest = nearest_to(lying, named)
            if nearest is not None and not near_to(lying, named, parts.section.touch_m):
                yield Finding(
                    at,
                    f"{name} works at {step.part}, which lies on none of its fixtures by then: {nearest[0]} is"
                    f" {millimetres(nearest[1])} away (touch_m {parts.section.touch_m:g}); put it there before"
                    " ({place: PART, at: {fixture: NAME}}), or change machines."
                    + name
                    + ".fixtures",
                    error=True,
                )
        elif (gap := _from_door(own, lying, subject)) is not None and gap > _BESIDE:
            yield Finding(
                at,
                f"{name} works at {step.part} {gap:.2f} m away from its door: {tell}",
            )
        elif spread > _BESIDE:
            yield Finding(
                at,
                f"{name} works at {step.part} {spread:.2f} m away from where it worked before, at"
                f" {position(first[:3, 3].tolist())}: one of the two is not in the machine; {tell}",
            )
        elif step.part not in moved and own.door is None:
            yield Finding(
                at,
                f"{name} works at {step.part} where that lies at the start, at"
                f" {position(pose[:3, 3].tolist())}: no step brings it to the machine; {tell}",
            )


def _from_door(own: MachineSection, lying: Lying, subject: Subject) -> float | None:
    """Return how far a part is from the door of a machine, None where it has none [m]."""
    if own.door is None:
        return None
    from twin.planning.shapes import build_shape
    from twin.scenario.sections.shapes import build_transform

    shape = build_shape("door", own.door.described, subject.folder)
    pose = build_transform(own.door.pose)
    found = nearest_to(lying, {"door": (Fixture("door", shape, pose), pose)})
    return None if found is None else max(0.0, found[1])


def check_helpers(subject: Subject) -> Findings:
    """Yield temporary bricks that nobody can take out again: an error where the rules ask for that."""
    from planning.lego.sequencing.remedies import Design, shut_in
    from twin.kinds.lego.kind import (
        build_lego,
        sequencing_rules,
        structure_and_helpers,
        tool_carrier,
    )

    section = subject.scenario.assembly
    if not isinstance(section, LegoSection):
        return
    structure, helpers = structure_and_helpers(section)
    if section.structure is None:
        names = {item.name: k for k, item in enumerate(build_lego(section).structure)}
        for found in shut_in(
            (*structure, *helpers), frozenset(h.name for h in helpers)
        ):
            yield Finding(
                ("assembly", "steps", names[found.brick.name]),
                f"it only helps, and cannot be taken out again: {found.words}",
                error=section.rules.scaffold == "removable",
            )
    elif section.rules.scaffold is True:
        rules = sequencing_rules(
            section,
            robots=len(subject.cell.robots),
            carrier=tool_carrier(subject.cell),
        )
        plain = Design(structure, build_lego(section).scaffold, (), rules)
        for found in plain.on_plinth().scaffolded().shut_in:
            yield Finding(
                ("assembly", "rules"),
                f"a temporary brick that it takes cannot be taken out again: {found.words}",
            )
