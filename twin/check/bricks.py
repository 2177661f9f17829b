"""Checks of tools for bricks: they touch what they hold and support, by the distances that the audit allows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from planning.cell.cover import box_body
from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.cell.workcell import Fixture
from planning.geometry.exact import Solid, distance_at
from planning.geometry.touching import near_to
from planning.grips.tool_grips import tool_bodies
from planning.lego.bricks.assembly import (
    BRICKS,
    BrickType,
    Cell,
    PlacedBrick,
    Plate,
    Support,
)
from planning.lego.bricks.grid import box_pose, box_size, presses
from planning.lego.skills.targets import BrickGrip, support_targets
from planning.transforms import Transform, inverse, readonly
from twin.audit.contacts import CONTACT_DEPTH
from twin.audit.grips import GRIP
from twin.audit.supports import SUPPORT
from twin.check.finding import Finding, Findings, Subject, millimetres
from twin.kinds.lego.kind import LegoKind, build_lego, build_structure

_MEETS = 0.001
"""A tool is at a brick if it is no farther from it than this [m]."""

_NOWHERE = np.zeros(0)


def check_brick_tools(subject: Subject) -> Findings:
    """Yield robots whose tool, by their tool frames, is away from bricks that it holds or supports, or in them.

    Beyond what the audit allows it is an error.
    """
    if not isinstance(subject.kind, LegoKind):
        return
    for robot in subject.unlike_robots:
        model, tool = robot.model, robot.tool or "its tool"
        if not {"tool", "alt"} <= set(model.frames):
            continue  # the planner names those that it needs
        bodies = [Solid(b.name, b, np.eye(4)) for b in tool_bodies(model)]
        worst: dict[str, tuple[float, float, str, str]] = {}
        for frame, words, (meets, most), kind, pose in _bricks_at(subject.kind, model):
            box = box_body("brick", tuple(box_size(kind).tolist()))
            there = Solid("brick", box, readonly(model.flange @ pose))
            gap = min(distance_at(own, _NOWHERE, there, _NOWHERE) for own in bodies)
            if gap > meets or gap < -CONTACT_DEPTH:
                found = gap, most, frame, kind.name
                worst[words] = max(
                    worst.get(words, found), found, key=lambda own: abs(own[0])
                )
        for words, (gap, most, frame, name) in worst.items():
            side = "away from" if gap > 0.0 else "in"
            yield Finding(
                subject.robot_at(robot.name, "frames", "tool", "model"),
                f"{robot.name} would {words} a {name} with {tool} {millimetres(abs(gap))} {side} it, by its frame"
                f" {frame!r}, and at most {millimetres(most if gap > 0.0 else CONTACT_DEPTH)} is allowed: its frames"
                f" are those of a {'longer' if gap > 0.0 else 'shorter'} tool; give the tool that the frames belong"
                " to, or the frames of this one",
                error=gap > most or gap < 0.0,
            )


def check_brick_places(subject: Subject) -> Findings:
    """Yield fixtures that are in the way of bricks in their places: all bricks of a structure, or of steps."""
    if not isinstance(subject.kind, LegoKind):
        return
    section = subject.kind.section
    assembly = build_lego(section)
    fixtures = {
        item.name: (item, item.pose)
        for item in subject.cell.fixtures
        if item.name in subject.own_fixtures
    }
    for item in build_structure(section) or assembly.structure:
        pose = box_pose(assembly.plate, item)
        size = tuple(box_size(item.brick).tolist())
        brick = Fixture(item.name, Shape((), (box_body(item.name, size),)), pose)
        for name, gap in near_to((brick, pose), fixtures, 0.0).items():
            if gap < -CONTACT_DEPTH:
                yield Finding(
                    subject.thing_at(name, "pose"),
                    f"{item.name} ({item.brick.name} at {item.cell.words}) goes where {name} stands: they would overlap by"
                    f" {millimetres(-gap)}; move {name}, or the plate",
                    error=True,
                )


def _bricks_at(
    kind: LegoKind, model: RobotModel
) -> Iterator[tuple[str, str, tuple[float, float], BrickType, Transform]]:
    """Yield the bricks that a tool holds or supports.

    Yields:
        The tool frame, what is done, how far away the tool is at most, and may be [m], the type of the brick, and the pose of its
        box in the flange frame.
    """
    assembly, rules = build_lego(kind.section), kind.section.rules
    structure = build_structure(kind.section) or ()
    placed = dict.fromkeys(item.brick for item in (*assembly.steps, *structure))
    free = bool(structure)
    ups = [step.brick for step in assembly.steps if step.up]
    hold = _MEETS, GRIP
    for brick in placed:
        grip = BrickGrip(model.frames, brick, np.eye(4), presses(brick)[0])
        yield "tool", "hold", hold, brick, grip.held()
        if brick in ups or (free and rules.place_up):
            yield "alt", "hold on its side studs", hold, brick, grip.held(up=True)
    supports = {own.from_above for step in assembly.steps for own in step.supports}
    plate, pair = Plate(np.eye(4)), BRICKS["1x2"]
    for above in sorted(supports | ({False} if free and rules.support else set())):
        cell = Cell(8, 8, 4)
        pose = support_targets(plate, Support(cell, 0, above))[0].subgoals[-1].pose
        item = PlacedBrick("", pair, replace(cell, z=cell.z + (-1 if above else 1)))
        held = inverse(pose @ inverse(model.frames["tool"])) @ box_pose(plate, item)
        yield "tool", "support", (SUPPORT, SUPPORT), pair, held
