"""Checks of grips: contact of pads or cups, friction, and actuation times."""

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
from planning.tasks.task import Actuation, TaskKind
from planning.transforms import Transform
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    format_millimetres,
)
from twin.checks.tools import finger_gap, has_fingers
from twin.document.yaml_text import KeyPath
from twin.durations.model import DurationModel
from twin.kinds.parts.checks.context import for_part_assemblies
from twin.kinds.parts.ordered_parts import OrderedParts

_USES = {
    "pick": (Actuation.CLOSE,),
    "place-down": (Actuation.OPEN,),
    "handover": (Actuation.CLOSE, Actuation.OPEN),
    TaskKind.HOLD: (Actuation.CLOSE,),
}
"""What tools do in a skill of an assembly of parts."""


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


def check_grip_times(subject: CheckContext) -> Findings:
    """Yield skill durations that leave no time to move, or override a tool's actuation times."""
    scenario = subject.scenario
    if not scenario.actuations:
        return
    execution = scenario.execution
    given: list[tuple[KeyPath, str, str | None, object]] = [
        (("execution", "skills", skill), skill, None, duration)
        for skill, duration in execution.skills.items()
    ]
    given += [
        (("execution", "skill_overrides", k), item.skill, item.robot, item.duration)
        for k, item in enumerate(execution.skill_overrides)
    ]
    for at, skill, robot, duration in given:
        if skill not in _USES or not isinstance(duration, DurationModel):
            continue
        whole = duration.located(subject.folder).mean
        grips = sum(
            min(
                model.located(subject.folder).mean
                for (done, who, _), model in scenario.actuations.items()
                if done == act and robot in (None, who)
            )
            for act in _USES[skill]
        )
        # Nobody takes 0 s for what a tool takes: that is a bound, see check_standing_times.
        if 0.0 < whole <= grips:
            yield Finding(
                at,
                f"{skill} takes {whole:g} s, which is the time of the whole skill: motions and what the"
                f" tool takes to {' and to '.join(_USES[skill])}, which alone is {grips:g} s. If this is"
                f" what the tool takes, say it there ({_keys(skill)}), and leave {skill} away here",
            )
    whole_skills = [
        skill
        for skill, duration in execution.skills.items()
        if skill in ("pick", "place-down") and isinstance(duration, DurationModel)
    ]
    for at, act in _said(subject):
        hidden = [skill for skill in whole_skills if act in _USES[skill]]
        if hidden:
            yield Finding(
                at,
                f"counts in no {' or '.join(hidden)}: execution.skills.{hidden[0]} says how long the whole"
                " of it takes, gripping included",
            )


def _keys(skill: str) -> str:
    keys = " and ".join(f"{act}_s" for act in _USES[skill])
    return f"{keys} of the tool or of assembly.grips"


def _said(subject: CheckContext) -> Iterator[tuple[KeyPath, str]]:
    """Yield the paths of tool actuation times in the file."""
    scenario = subject.scenario
    places: list[tuple[KeyPath, object]] = [
        (("cell", "tools", name), tool) for name, tool in scenario.cell.tools.items()
    ]
    places.append((("assembly", "grips"), getattr(scenario.assembly, "grips", None)))
    for at, section in places:
        for act in (Actuation.CLOSE, Actuation.OPEN):
            if getattr(section, f"{act}_s", None) is not None:
                yield (*at, f"{act}_s"), act
