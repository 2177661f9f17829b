"""Where the robots of a truss stand: grippers on two sides of it, torches on the others."""

from __future__ import annotations

import math
from dataclasses import dataclass

Degrees = tuple[float, ...]
"""Of the joints of an arm."""

_TORCHES_WAIT: Degrees = (0, -150, 140, -80, -90, 0)
"""HOME of arms with torches, in nobody's way."""

_ASIDE: Degrees = (90, -140, 120, -70, -90, 0)
"""HOME of arms with grippers over their racks, where a high structure is welded from all sides."""


@dataclass(frozen=True)
class Base:
    """A robot, where it stands, and where it waits.

    Attributes:
        name: of the robot.
        tool: that it has.
        xyz: of its base [m].
        yaw: about z [deg].
        home: its HOME [deg]; None for that of its model.
    """

    name: str
    tool: str
    xyz: tuple[float, float, float]
    yaw: float
    home: Degrees | None = None

    @property
    def away(self) -> float:
        """How far away from the middle it stands [m]."""
        return math.hypot(self.xyz[0], self.xyz[1])


def site(
    *,
    grippers: tuple[float, float],
    torches: tuple[float, float],
    behind: float | None = None,
    wait: Degrees | None = None,
) -> tuple[Base, ...]:
    """Return two arms with grippers to the left and right, and one or two with torches.

    Args:
        grippers: how far away from the middle they stand, and how high [m].
        torches: the same of the arm with a torch.
        behind: how far away from the middle another arm with a torch stands on the other side
            [m]; None for none.
        wait: HOME of the arms with grippers [deg]; None for that of their model.
    """
    away, high = grippers
    far, above = torches
    bases = [
        Base("left", "gripper", (-away, 0.0, high), 0.0, wait),
        Base("welder", "torch", (0.0, far, above), -90.0, _TORCHES_WAIT),
        Base("right", "gripper", (away, 0.0, high), 180.0, wait),
    ]
    if behind is not None:
        other = (0.0, -behind, above)
        bases.append(Base("welder2", "torch", other, 90.0, _TORCHES_WAIT))
    return tuple(bases)


SITES = {
    "cube-14": site(grippers=(0.6, 0.15), torches=(0.65, 0.3)),
    "tower-24": site(grippers=(0.6, 0.15), torches=(0.75, 0.3), behind=0.75),
    "girder-30": site(grippers=(0.7, 0.15), torches=(0.6, 0.3)),
    "tower-45": site(
        grippers=(0.6, 0.32), torches=(0.75, 0.5), behind=0.75, wait=_ASIDE
    ),
}
"""By structure."""
