"""Where the robots of a truss stand: grippers on two sides of it, torches on the others."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Base:
    """A robot and where it stands.

    Attributes:
        name: of the robot.
        tool: that it has.
        xyz: of its base [m].
        yaw: about z [deg].
    """

    name: str
    tool: str
    xyz: tuple[float, float, float]
    yaw: float

    @property
    def away(self) -> float:
        """How far away from the middle it stands [m]."""
        return math.hypot(self.xyz[0], self.xyz[1])


def site(
    *,
    grippers: tuple[float, float],
    torches: tuple[float, float],
    behind: float | None = None,
) -> tuple[Base, ...]:
    """Return two arms with grippers to the left and right, and one or two with torches.

    Args:
        grippers: how far away from the middle they stand, and how high [m].
        torches: the same of the arm with a torch.
        behind: how far away from the middle another arm with a torch stands on the other side
            [m]; None for none.
    """
    away, high = grippers
    far, above = torches
    bases = [
        Base("left", "gripper", (-away, 0.0, high), 0.0),
        Base("welder", "torch", (0.0, far, above), -90.0),
        Base("right", "gripper", (away, 0.0, high), 180.0),
    ]
    if behind is not None:
        bases.append(Base("welder2", "torch", (0.0, -behind, above), 90.0))
    return tuple(bases)


SITES = {
    "cube-14": site(grippers=(0.6, 0.15), torches=(0.55, 0.3)),
    "tower-24": site(grippers=(0.6, 0.15), torches=(0.75, 0.3), behind=0.75),
    "girder-30": site(grippers=(0.7, 0.15), torches=(0.6, 0.3)),
    "tower-45": site(grippers=(0.6, 0.2), torches=(0.75, 0.5), behind=0.75),
}
"""By structure."""
