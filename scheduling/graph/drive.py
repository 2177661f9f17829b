"""How the nodes of a robot are passed within its limits of speed, acceleration and jerk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planning.transforms import Array


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
    """

    cruise: Array
    ramp: Array
    lag: Array
    rests: npt.NDArray[np.bool_]

    def cut(self, nodes: slice) -> Drive:
        """Return the entries of some nodes; they end at rest."""
        rests = self.rests[nodes].copy()
        rests[-1:] = True
        return Drive(self.cruise[nodes], self.ramp[nodes], self.lag[nodes], rests)

    def repeated(self, times: int) -> Drive:
        """Return the entries again and again."""
        names = ("cruise", "ramp", "lag", "rests")
        return Drive(*(np.tile(getattr(self, name), times) for name in names))
