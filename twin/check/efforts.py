"""Checks of what joints can exert: whether they hold the arm at HOME, and the heaviest part."""

from __future__ import annotations

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot
from planning.timing.torque import ArmDynamics, Payload, too_weak, why_unchecked
from twin.check.finding import Finding, Findings, Subject
from twin.scenario.sections.parts import PartsSection


def check_efforts(subject: Subject) -> Findings:
    """Yield robots whose efforts are too low to be those of the arm, or for the parts they place.

    Only for plans within limits, in which efforts count.
    """
    if subject.scenario.speed_model != "limits":
        return
    parts = _placed(subject)
    for robot in subject.cell.robots:
        drives, at = robot.model.drives, subject.robot_at(robot.name, "limits", "model")
        if weak := too_weak(robot):
            yield Finding(
                at,
                f"efforts of {robot.name} ({robot.model.name}) are not kept to: {weak}; give"
                " limits.effort, or a description with its masses",
            )
        if drives is None or why_unchecked(robot) is not None:
            continue
        light = [part for part in parts if part.mass <= drives.spare]
        heaviest = max(light, key=lambda part: part.mass, default=None)
        if heaviest is not None and (words := _too_heavy(robot, heaviest)):
            yield Finding(at, words)


def _placed(subject: Subject) -> list[CellObject]:
    section = subject.scenario.assembly
    if not isinstance(section, PartsSection):
        return []
    placed = {step.place for step in section.steps}
    return [
        part
        for part in subject.cell.objects
        if {part.name, part.name.rpartition(".")[0]} & placed
    ]


def _too_heavy(robot: PlacedRobot, part: CellObject) -> str | None:
    """Return in words which joint does not hold a part at HOME; None where all do."""
    model, drives = robot.model, robot.model.drives
    assert drives is not None
    tool = model.frames.get("tool", np.eye(4))
    held = Payload(part.mass, part.shape, tool)
    weight = np.abs(ArmDynamics(robot, model, [held]).gravity(robot.home))
    over = weight > drives.effort
    if not over.any():
        return None
    k = int(np.argmax(over))
    return (
        f"{robot.name} cannot hold {part.name} ({part.mass:g} kg) at HOME: {model.joint_names[k]} would"
        f" have to exert {weight[k]:.3g} N m or N, and its effort is {drives.effort[k]:g}"
    )
