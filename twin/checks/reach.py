"""Checks that robots can reach all required poses, with the inverse kinematics of the planner."""

from __future__ import annotations

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.transforms import Transform
from twin.checks.finding import CheckContext, Finding, Findings


def check_reach(subject: CheckContext) -> Findings:
    """Return findings on unreachable poses, as errors where planning would fail."""
    return subject.checks.reach()


def reach_bound(robot: PlacedRobot, frame: str) -> float:
    """Return an upper bound of the distance of a robot's frame from its first joint [m]."""
    model = robot.model
    lengths = np.linalg.norm(model.chain.placement[1:, :3, 3], axis=1).sum()
    tip = np.linalg.norm(model.frame_in_last_joint(frame)[:3, 3])
    slide = np.maximum(np.abs(model.lower), np.abs(model.upper))
    return float(lengths + tip + slide[model.chain.prismatic].sum())


def is_beyond_reach(robot: PlacedRobot, frame: str, target: Transform) -> bool:
    """Return whether a pose is beyond the arm's length in any configuration."""
    return distance_from_first_joint(robot, target) > reach_bound(robot, frame) + 1e-3


def distance_from_first_joint(robot: PlacedRobot, target: Transform) -> float:
    """Return the distance of a pose from a robot's first joint [m]."""
    first = robot.base @ robot.model.chain.placement[0]
    return float(np.linalg.norm(target[:3, 3] - first[:3, 3]))


def idle_robot(subject: CheckContext, robot: PlacedRobot, steps: int) -> Finding:
    """Return the finding that a robot can take part in no step."""
    at = subject.robot_at(robot.name)
    return Finding(
        at[:3],
        f"{robot.name} will get no task: it neither picks nor places a part in any of the {steps} steps, nor"
        " does it reach a place of work; move it nearer, give it another tool, or leave it out",
    )
