"""Checks of grips: contact of finger pads or suction cups with the part, and friction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import CellObject, PlacedRobot
from planning.grips.fingers import load_on_pads
from planning.grips.grip import GripRules
from planning.grips.pads import own_bodies
from planning.grips.tool_grips import describe_missed_contact, robot_grips
from planning.parts.assembly import PartAssembly, PlacePart
from planning.transforms import Transform
from twin.checks.finding import CheckContext, Finding, Findings, format_millimetres
from twin.checks.tools import finger_gap, has_fingers
from twin.kinds.parts.checks.context import for_part_assemblies
from twin.kinds.parts.ordered_parts import OrderedParts


@for_part_assemblies
def check_holds(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield parts without proper tool contact.

    Where no tool would, at the start or in place, it is an error.
    """
    assembly = parts.listed
    for name in dict.fromkeys(assembly.placed):
        part, rules = subject.cell.object(name), assembly.handling(name).grips
        may = {robot.model: robot for robot in _placing(subject, assembly, name)}
        reported = set[RobotModel]()
        for at, where in (
            (part.start, "where it lies at the start"),
            (assembly.goals[name], "in its place"),
        ):
            missed = {model: _missed(may[model], part, at, rules) for model in may}
            for model, words in missed.items():
                if words and model not in reported:
                    reported.add(model)
                    yield Finding(
                        subject.robot_at(may[model].name, "tool", "model"),
                        f"{may[model].name} would hold {name} by none of its grips {where}: {words}",
                        error=all(own is None or own for own in missed.values()),
                        code="hold",
                        parts=(may[model].name, name),
                    )


def _placing(
    subject: CheckContext, assembly: PartAssembly, part: str
) -> Iterator[PlacedRobot]:
    """Yield the robots allowed to place a part that have its frame."""
    own = [s for s in assembly.steps if isinstance(s, PlacePart) and s.part == part]
    for robot in reversed(subject.cell.robots):
        known = assembly.frame in {"flange", *robot.model.frames}
        if known and any(step.done_by(robot.name) for step in own):
            yield robot


def _missed(
    robot: PlacedRobot, part: CellObject, at: Transform, rules: GripRules
) -> str | None:
    """Return why a tool holds a part by none of its grips, from the first grip.

    Returns:
        Empty where it holds by one of them, None where there are no grips.
    """
    first: str | None = None
    for grip in robot_grips(robot, part.shape, at, at, rules):
        words = describe_missed_contact(robot, part, grip, rules)
        if words is None:
            return ""
        first = first or words
    return first


@for_part_assemblies
def check_friction(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield parts that slip, or turn about the pad axis, with every grip.

    Looked at where the tool says with which force it closes.
    """
    assembly = parts.listed
    for name in dict.fromkeys(assembly.placed):
        part, rules = subject.cell.object(name), assembly.handling(name).grips
        for robot in {r.model: r for r in _placing(subject, assembly, name)}.values():
            loads = []
            for pose in (part.start, assembly.goals[name]):
                of = assembly.frame, pose, assembly.friction
                grips = robot_grips(robot, part.shape, pose, pose, rules)
                found = (load_on_pads(robot, part, grip, *of) for grip in grips)
                known = [load for load in found if load is not None]
                if known:
                    loads.append(min(known, key=lambda load: load.share))
            worst = max(loads, key=lambda load: load.share, default=None)
            if worst is None or worst.share <= 1.0 or robot.model.grip is None:
                continue
            grip = robot.model.grip
            yield Finding(
                subject.robot_at(robot.name, "tool", "model"),
                f"the pads of {grip.tool} hold {name} ({part.mass:g} kg) at best {format_millimetres(worst.moment_arm)} beside"
                f" its centre of mass: {worst.force:.3g} N pull along them and {round(worst.torque, 6):.3g} N m turn it about"
                f" their axis; friction bears {worst.most_force:.3g} N or {round(worst.most_torque, 6):.3g} N m (force_n"
                f" {grip.force:g}, balance.friction {assembly.friction:g}): hold it nearer to its centre of mass,"
                " or with more force or larger pads",
                code="slip",
                parts=(grip.tool, name),
                figures=(worst.moment_arm, worst.force, worst.torque),
            )


@for_part_assemblies
def check_pads(subject: CheckContext, _: OrderedParts) -> Findings:
    """Yield tools with fingers whose pads cannot be identified by shape."""
    for robot in subject.distinct_robots:
        model = robot.model
        if model.grip is None or model.grip.opening in (None, (0.0, 0.0)):
            continue
        gap = finger_gap(model, model.frames.get("tool", np.eye(4)))
        if gap is not None and own_bodies(model) and not has_fingers(model):
            yield Finding(
                subject.robot_at(robot.name, "tool", "model"),
                f"the shapes of {model.grip.tool} have no finger on either side of its tcp that reaches"
                " farther out than what is between: whether it touches the parts that it grips is neither"
                " planned nor audited; give its fingers shapes of their own, on both sides along 'closing'",
            )
