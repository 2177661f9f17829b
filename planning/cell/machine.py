"""Models of immovable things: carriers without travel, and machines.

A machine is a pseudo-robot whose tasks take time and wait for others, as those of a robot do. It has no
body: the things that it brings, processes or removes are objects at rest, and the user's fixtures represent
its frame. Its door is an object, too, for as long as it works.
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
    """Return the model of a slide without travel.

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
