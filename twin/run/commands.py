"""What a robot was commanded within limits: pieces of constant acceleration along its nodes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planning.transforms import Array


@dataclass
class Commands:
    """Pieces of constant acceleration, in order; each lasts until the next one begins.

    Speeds are shares of full speed and lengths times at full speed, see ``planning.timing.stretch``.
    """

    _rows: list[tuple[float, int, float, float, float]] = field(default_factory=list)

    def add(
        self, t_ns: float, node: int, gone: float, speed: float, rate: float
    ) -> None:
        """Note that a piece begins.

        Args:
            t_ns: when [ns].
            node: in which node.
            gone: how far into it [ns].
            speed: at that moment.
            rate: its change [1/ns].
        """
        self._rows.append((t_ns, node, gone, speed, rate))

    def rows(self) -> Array:
        """Return the pieces, shape (pieces, 5): time, node, gone, speed and rate."""
        return np.array(self._rows, dtype=np.float64).reshape(-1, 5)
