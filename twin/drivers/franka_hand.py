"""Control of the hand of a Franka robot: grasping and opening, with reports of success."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from planning.errors import TwinError


class FrankaError(TwinError):
    """Error: a Franka robot cannot be controlled."""


@dataclass(frozen=True)
class HandGrip:
    """Grip parameters of a hand.

    Attributes:
        width: width of the object between the fingers [m].
        within: by how much that may differ; else the grasp has failed [m].
        opening: to which it opens [m].
        force: with which it presses [N].
        speed: of the fingers [m/s].
        goal: commanded width, if not ``width``: spring-like fingers, as simulated ones, press in
            proportion to the difference [m].
    """

    width: float = 0.04
    within: float = 0.005
    opening: float = 0.06
    force: float = 30.0
    speed: float = 0.05
    goal: float | None = None


class FrankaHand:
    """A hand that executes one action at a time.

    Args:
        gripper: of franky, that has been connected.
        grip: how it grips.
        failure: exception of franky for a failed command.
    """

    def __init__(self, gripper: Any, grip: HandGrip, failure: type[Exception]) -> None:
        self._gripper, self.grip, self._failure = gripper, grip, failure
        self._work: Any = None
        self._until_s = -1.0

    @property
    def is_at_work(self) -> bool:
        """Whether an action is in progress."""
        return self._work is not None

    @property
    def width(self) -> float:
        """Opening width [m]."""
        return float(self._gripper.width)

    def begin(self, act: str, seconds: float = 0.0) -> None:
        """Begin to ``close`` or ``open``; with neither, to wait for a time [s]."""
        grip = self.grip
        if act == "close":
            goal = grip.width if grip.goal is None else grip.goal
            low = goal - grip.width + grip.within
            high = grip.width + grip.within - goal
            self._work = self._gripper.grasp_async(
                goal, grip.speed, grip.force, low, high
            )
        elif act == "open":
            self._work = self._gripper.move_async(grip.opening, grip.speed)
        else:
            self._work, self._until_s = "", time.monotonic() + seconds

    def ended(self) -> bool | None:
        """Return whether the action succeeded; None while it is in progress."""
        if self._work == "":
            good = None if time.monotonic() < self._until_s else True
        elif not self._work.wait(0.0):
            good = None
        else:
            try:
                good = bool(self._work.get())
            except self._failure:  # some hands report a failure so
                good = False
        if good is not None:
            self._work = None
        return good
