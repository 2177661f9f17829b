"""Robot models without motion: machines, and bodies that never move.

A machine is modelled as a robot, because its tasks take time and wait for other tasks. It has no bodies. The parts
that it delivers, processes or removes are objects at rest, and fixtures of the scenario represent its frame. While it
works, its closed door is an object, so that no robot can reach in.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np

from planning.cell.body import ConvexBody
from planning.cell.robot_model import KinematicChain, LinkPart, RobotModel
from planning.cell.workcell import PlacedRobot
from planning.transforms import read_only_copy


def immovable_model(name: str, bodies: Sequence[ConvexBody] = ()) -> RobotModel:
    """Return the model of bodies that never move: a prismatic joint whose range is zero.

    Args:
        name: of the model.
        bodies: what it carries, in the frame of its base.
    """
    return RobotModel(
        name=name,
        urdf=Path(name),
        package_dirs=(),
        joint_names=("none",),
        lower=read_only_copy(np.zeros(1)),
        upper=read_only_copy(np.zeros(1)),
        velocity=read_only_copy(np.ones(1)),
        chain=KinematicChain(
            read_only_copy(np.eye(4)[None]),
            read_only_copy(np.array([[1.0, 0.0, 0.0]])),
            np.ones(1, dtype=np.bool_),
        ),
        flange=read_only_copy(np.eye(4)),
        frames={},
        parts=tuple(LinkPart(0, "arm", body) for body in bodies),
        never_collide=frozenset(combinations(range(len(bodies)), 2)),
        home=read_only_copy(np.zeros(1)),
    )


@cache
def machine_model() -> RobotModel:
    """Return the model of a machine: a slide that never moves and carries nothing."""
    return immovable_model("machine")


def machine_robot(name: str) -> PlacedRobot:
    """Return the machine with a given name."""
    model = machine_model()
    return PlacedRobot(name, model, read_only_copy(np.eye(4)), model.home)
