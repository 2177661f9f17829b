"""Collision checks as path planners ask for them."""

from __future__ import annotations

from typing import Protocol

from planning.transforms import Array


class MotionChecker(Protocol):
    """Collision checks of a configuration and of a straight motion."""

    def configuration_free(self, q: Array) -> bool:
        """Tell whether the robot may stand at ``q``."""
        ...

    def motion_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether the straight line from ``q_a`` to ``q_b`` is free."""
        ...
