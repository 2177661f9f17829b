"""Checks of LEGO tools: contact with bricks that they hold or support, with the same tolerances as in the audit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from planning.cell.cover import box_body
from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.cell.workcell import Fixture, PlacedRobot
from planning.contacts.touching import nearby_entities
from planning.errors import (
    RobotModelError,
)
from planning.geometry.exact import Solid, hull_distance_at
from planning.grips.tool_grips import tool_bodies
from planning.kinematics.kinematics import inverse_kinematics
from planning.lego.bricks.assembly import (
    BrickType,
    Cell,
    LegoAssembly,
    PlacedBrick,
    Plate,
    Support,
)
from planning.lego.bricks.brick_grips import grip_pose, legal_presses
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.grid import box_pose, box_size, top_pose
from planning.lego.skills.support_targets import support_targets
from planning.lego.skills.targets import BrickGrip
from planning.transforms import Array, Transform, inverse, read_only_copy
from twin.audits.contacts import CONTACT_DEPTH
from twin.audits.grips import GRIP
from twin.audits.supports import SUPPORT
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    KindChecks,
    format_millimetres,
)
from twin.checks.ignored_contacts import check_ignored_contacts
from twin.checks.meshes import check_meshes
from twin.checks.placements import (
    check_centres,
    check_fixtures,
    check_starts,
)
from twin.checks.reach import idle_robot, is_beyond_reach
from twin.checks.robots import (
    check_bases,
    check_efforts,
    check_homes,
    check_skill_times,
    check_speeds,
    check_standing_times,
)
from twin.checks.tools import (
    check_descriptions,
    check_flanges,
    check_openings,
    check_suction,
    check_tool_frames,
)
from twin.checks.usual import check_physics, check_rates, check_usual
from twin.kinds.lego.kind import (
    LegoKind,
    build_lego,
    build_structure,
    sequencing_rules,
    structure_and_helpers,
    tool_carrier,
)
from twin.kinds.lego.section import LegoSection

_MEETS = 0.001
"""A tool is at a brick if it is no farther from it than this [m]."""

_NOWHERE = np.zeros(0)

_MOST_STEPS = 6
"""Steps out of reach of an assembly of bricks that are named."""


def lego_kind(subject: CheckContext) -> LegoKind:
    """Return the LEGO assembly of a scenario."""
    kind = subject.kind
    assert isinstance(kind, LegoKind)
    return kind


def check_brick_tools(subject: CheckContext) -> Findings:
    """Yield robots whose tool misses or penetrates bricks that it holds or supports.

    Beyond what the audit allows it is an error.
    """
    lego = lego_kind(subject)
    for robot in subject.distinct_robots:
        model, tool = robot.model, robot.tool or "its tool"
        if not {"tool", "alt"} <= set(model.frames):
            continue  # the planner names those that it needs
        bodies = [Solid(b.name, b, np.eye(4)) for b in tool_bodies(model)]
        worst: dict[str, tuple[float, float, str, str]] = {}
        for frame, words, (meets, most), kind, pose in _bricks_at(lego, model):
            box = box_body("brick", tuple(box_size(kind).tolist()))
            there = Solid("brick", box, read_only_copy(model.flange @ pose))
            gap = min(
                hull_distance_at(own, _NOWHERE, there, _NOWHERE) for own in bodies
            )
            if gap > meets or gap < -CONTACT_DEPTH:
                found = gap, most, frame, kind.name
                worst[words] = max(
                    worst.get(words, found), found, key=lambda own: abs(own[0])
                )
        for words, (gap, most, frame, name) in worst.items():
            side = "away from" if gap > 0.0 else "in"
            yield Finding(
                subject.robot_at(robot.name, "frames", "tool", "model"),
                f"{robot.name} would {words} a {name} with {tool} {format_millimetres(abs(gap))} {side} it, by its frame"
                f" {frame!r}, and at most {format_millimetres(most if gap > 0.0 else CONTACT_DEPTH)} is allowed: its frames"
                f" are those of a {'longer' if gap > 0.0 else 'shorter'} tool; give the tool that the frames belong"
                " to, or the frames of this one",
                error=gap > most or gap < 0.0,
            )


def check_brick_places(subject: CheckContext) -> Findings:
    """Yield fixtures that overlap bricks at their goals."""
    section = lego_kind(subject).section
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
        for name, gap in nearby_entities((brick, pose), fixtures, 0.0).items():
            if gap < -CONTACT_DEPTH:
                yield Finding(
                    subject.thing_at(name, "pose"),
                    f"{item.name} ({item.brick.name} at {item.cell.words}) goes where {name} stands: they would overlap by"
                    f" {format_millimetres(-gap)}; move {name}, or the plate",
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
        grip = BrickGrip(model.frames, brick, np.eye(4), legal_presses(brick)[0])
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


def check_helpers(subject: CheckContext) -> Findings:
    """Yield temporary bricks that no robot can remove: an error where the rules require removal."""
    from planning.lego.sequencing.remedies import Design
    from planning.lego.sequencing.removal import find_unremovable_bricks

    section = lego_kind(subject).section
    structure, helpers = structure_and_helpers(section)
    if section.structure is None:
        names = {item.name: k for k, item in enumerate(build_lego(section).structure)}
        for found in find_unremovable_bricks(
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


def _check_bricks(subject: CheckContext, section: LegoSection) -> Findings:
    from planning.lego.sequencing.step_reach import find_reach_faults

    assembly, cell = build_lego(section), subject.cell
    structure = build_structure(section) or ()
    for robot in cell.robots:
        if not _handles_bricks(robot, assembly, structure):
            yield idle_robot(subject, robot, subject.kind.steps())
    if structure:
        return  # the planner finds the steps
    try:
        faults = find_reach_faults(cell, assembly)
    except RobotModelError as error:  # a frame of the LEGO tool is missing
        yield Finding(("assembly", "kind"), str(error), error=True)
        return
    for number, words in faults[:_MOST_STEPS]:
        yield Finding(("assembly", "steps", number - 1), words, error=True)
    if (more := len(faults) - _MOST_STEPS) > 0:
        last = faults[_MOST_STEPS - 1][0]
        yield Finding(("assembly", "steps", last - 1), f"and {more} more", error=True)


def _handles_bricks(
    robot: PlacedRobot, assembly: LegoAssembly, structure: Sequence[PlacedBrick]
) -> bool:
    """Return whether a robot with a brick tool reaches a stock brick or a brick's goal."""
    model = robot.model
    if "tool" not in model.frames:
        return True  # said elsewhere
    items: list[tuple[Plate, PlacedBrick]] = [
        (assembly.plate_of(item), item) for item in assembly.stock
    ]
    items += [(assembly.plate, item) for item in (*structure, *assembly.structure)]
    poses = (
        grip_pose(top_pose(plate, item), item.brick, press)
        for plate, item in items
        for press in legal_presses(item.brick)
    )
    return any(
        inverse_kinematics(robot, "tool", pose, robot.home)
        for pose in poses
        if not is_beyond_reach(robot, "tool", pose)
    )


def _placed_bricks(section: LegoSection) -> Iterator[tuple[str, Array]]:
    from twin.checks.views import box_corners

    assembly = build_lego(section)
    bricks = build_structure(section) or assembly.structure
    for placed in bricks:
        pose = box_pose(assembly.plate, placed)
        yield placed.name, box_corners(box_size(placed.brick), pose)


class LegoChecks(KindChecks):
    """Checks of a scenario with a LEGO assembly."""

    quick = (
        check_fixtures,
        check_meshes,
        check_bases,
        check_homes,
        check_starts,
        check_helpers,
        check_centres,
        check_descriptions,
        check_ignored_contacts,
        check_flanges,
        check_tool_frames,
        check_brick_places,
        check_brick_tools,
        check_openings,
        check_suction,
        check_efforts,
        check_skill_times,
        check_standing_times,
        check_speeds,
        check_usual,
        check_rates,
        check_physics,
    )

    def reach(self) -> Findings:
        """Yield unreachable steps, and robots that reach no brick."""
        return _check_bricks(self.subject, lego_kind(self.subject).section)

    def goal_pieces(self) -> Iterator[tuple[str, Array]]:
        """Yield the bricks in their places."""
        return _placed_bricks(lego_kind(self.subject).section)
