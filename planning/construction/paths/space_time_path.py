"""A path through space-time, as data."""

from __future__ import annotations

from dataclasses import dataclass

from planning.transforms import Array


@dataclass(frozen=True)
class SpaceTimePath:
    """A collision-free path through space-time.

    Attributes:
        time: of the waypoints, rising, shape (w,) [s].
        path: waypoints of all movers, straight in between, shape (w, n). A mover that is not
            yet free to move at a waypoint stands until it is.
        goal: which goal it leads to.
        earliest: no path to any goal arrives before [s].
    """

    time: Array
    path: Array
    goal: int
    earliest: float

    @property
    def arrival(self) -> float:
        """Arrival time [s]."""
        return float(self.time[-1])
