"""Configurations at mode switches, and when each may be reached (Hartmann et al. IV-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.construction.keyframes.step_scenes import Hold
from planning.construction.world.skill_motion import SkillMotion
from planning.transforms import Array


@dataclass(frozen=True)
class Keyframe:
    """One way to do one skill.

    Attributes:
        motion: of the skill, the configuration at the switch in the middle of it.
        windows: spans of time in which the skill may begin, among all that is fixed, shape
            (w, 2) [s].
    """

    motion: SkillMotion
    windows: Array

    @property
    def start(self) -> Array:
        """The configuration to arrive at."""
        return np.asarray(self.motion.path[0])

    @property
    def earliest(self) -> float:
        """The first time at which the skill may begin [s]."""
        return float(self.windows[0, 0])


@dataclass(frozen=True)
class Meeting:
    """One way to hand the part over.

    Attributes:
        giver: the skill of the robot that brings the part to the other one's pad.
        taker: where that one stands meanwhile, shape (n,).
    """

    giver: Keyframe
    taker: Array


@dataclass(frozen=True)
class Keyframes:
    """Ways to do all switches of a sub-problem, consistent with each other.

    Every pick goes with every meeting and every place: they hold the part alike.

    Attributes:
        holds: how each robot that has the part holds it, in order.
        picks: ways to pick it, the most promising first.
        places: ways to place it, likewise.
        meetings: ways to hand it over, likewise; empty where one robot does all.
    """

    holds: tuple[Hold, ...]
    picks: tuple[Keyframe, ...]
    places: tuple[Keyframe, ...]
    meetings: tuple[Meeting, ...] = ()
