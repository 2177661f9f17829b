"""How the nodes of a robot are passed within its limits of speed, acceleration and jerk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices

BY_JOINTS, BY_TOOL_SPEED, BY_EFFORT = 0, 1, 2
"""What sets the times of a node: speed, acceleration and jerk of joints; the speed of the tool; or,
from ``BY_EFFORT`` on, the effort of the joint that is counted on from there. Below zero, counted down
from -1, is a joint whose effort does not bear the weight, however slow it is."""


@dataclass(frozen=True, eq=False)
class Drive:
    """How fast each node of a chain can be passed, one entry a node.

    Consecutive pose nodes on a straight line in joint space are a *stretch*: the robot passes the
    borders between them at speed, and is at rest at both ends of it. Skill nodes, and nodes that do
    not move, begin and end at rest.

    Attributes:
        cruise: time at full speed; of a skill, its least duration [s].
        ramp: time from rest to full speed, the same for all nodes of a stretch; 0 for what is no
            part of one [s].
        lag: by how much the executed motion is behind the commanded one, likewise [s].
        rests: whether the robot is at rest at the end of the node.
        slowed: how many times as long its stretch or skill takes as by the limits of speed,
            acceleration and jerk of joints.
        slowed_by: what asks for that: ``BY_JOINTS``, ``BY_TOOL_SPEED``, or a joint's effort.
    """

    cruise: Array
    ramp: Array
    lag: Array
    rests: npt.NDArray[np.bool_]
    slowed: Array
    slowed_by: Indices

    def cut(self, nodes: slice) -> Drive:
        """Return the entries of some nodes; they end at rest."""
        own = {name: values[nodes] for name, values in vars(self).items()}
        own["rests"] = own["rests"].copy()
        own["rests"][-1:] = True
        return Drive(**own)

    def repeated(self, times: int) -> Drive:
        """Return the entries again and again."""
        return Drive(
            **{name: np.tile(values, times) for name, values in vars(self).items()}
        )
