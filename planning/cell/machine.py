"""Machines: what brings parts, works at them or takes them away, as far as a plan has to know.

A machine is something whose tasks take time and wait for others, as those of a robot do. It has
no body: what it brings, works at or takes are objects at rest, and the user's fixtures stand for
its frame. So is its door, for as long as it works.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planning.cell.robot_model import KinematicChain, RobotModel
from planning.cell.workcell import PlacedRobot
from planning.transforms import readonly

_AT_REST = readonly(np.zeros(1))

MODEL = RobotModel(
    name="machine",
    urdf=Path("machine"),
    package_dirs=(),
    joint_names=("none",),
    lower=readonly(np.zeros(1)),
    upper=readonly(np.zeros(1)),
    velocity=readonly(np.ones(1)),
    chain=KinematicChain(
        readonly(np.eye(4)[None]),
        readonly(np.array([[1.0, 0.0, 0.0]])),
        np.ones(1, dtype=np.bool_),
    ),
    flange=readonly(np.eye(4)),
    frames={},
    parts=(),
    never_collide=frozenset(),
    home=_AT_REST,
)
"""A slide that never moves and carries nothing."""


def machine(name: str) -> PlacedRobot:
    """Return the machine of a name."""
    return PlacedRobot(name, MODEL, readonly(np.eye(4)), _AT_REST)
