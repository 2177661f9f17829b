"""Finds keyframes: configurations at all remaining mode switches, jointly (Hartmann et al. IV-B).

Configurations are drawn at random and made exact by damped least squares; each is tried against
the world as it is at a drawn time. Of those that pass, all times at which the whole skill is
free are worked out, so that the path planner may arrive at any of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planning.construction.arrival_windows import arrival_windows
from planning.construction.bounds import ReachBounds
from planning.construction.keyframes import Keyframe, Keyframes
from planning.construction.skill_motion import SkillMotion, skill_motion
from planning.construction.space_time_checker import SpaceTimeChecker
from planning.construction.step_scenes import Hold, StepScenes
from planning.transforms import Array, Transform

_TURNS = (0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)
Phase = tuple[SpaceTimeChecker, SpaceTimeChecker]
"""The checks before and after a touch."""


@dataclass(frozen=True)
class KeyframeSettings:
    """How hard keyframes are looked for.

    Attributes:
        picks, places: how many ways are wanted.
        starts: configurations drawn at once.
        draws: how often, for each way to hold the part.
        spread: times are drawn up to so long after the earliest [s].
        ahead: later arrivals than so long after the earliest are not looked at, as long as
            others still move [s].
    """

    picks: int = 3
    places: int = 4
    starts: int = 12
    draws: int = 4
    spread: float = 10.0
    ahead: float = 30.0


class KeyframeSolver:
    """Finds keyframes of one sub-problem for one robot that picks and places by itself.

    Args:
        scenes: checks of the sub-problem.
        bounds: who reaches what.
        ready: the part must not be placed before [s].
        settings: how hard is looked.
        rng: what is drawn from.
    """

    def __init__(
        self,
        scenes: StepScenes,
        bounds: ReachBounds,
        ready: float,
        settings: KeyframeSettings,
        rng: np.random.Generator,
    ) -> None:
        self.scenes = scenes
        self.bounds = bounds
        self.ready = ready
        self.settings = settings
        self.rng = rng

    def alone(self, robot: str) -> Iterator[Keyframes]:
        """Yield keyframes of one robot that picks and places, for one hold after another.

        The place is looked at first: where nothing can be put down nothing need be picked.
        """
        part = self.scenes.part
        grips = set(self.bounds.pick_grips(robot, part))
        grips &= set(self.bounds.place_grips(robot, part))
        holds = [Hold(grip, turn) for grip in sorted(grips) for turn in _TURNS]
        begin = self.scenes.world.robots[robot].end
        free = self._free_place()
        for k in self.rng.permutation(len(holds)).tolist():
            hold = holds[k]
            places = self.places(robot, hold, begin, free)
            if not places:
                continue
            picks = self.picks(robot, hold, begin)
            if picks:
                yield Keyframes(hold, picks, places)

    def picks(self, robot: str, hold: Hold, begin: float) -> tuple[Keyframe, ...]:
        """Return ways to pick the part, the soonest first."""
        scenes, problem = self.scenes, self.scenes.problem
        start = problem.object(scenes.part).start
        phase = (scenes.empty_at_start(robot), scenes.held_at_start(robot, hold))
        return self._ways(
            robot,
            problem.tool_pose(scenes.part, start, *hold),
            None,
            phase,
            begin,
            problem.seconds.pick,
            self.settings.picks,
        )

    def places(
        self, robot: str, hold: Hold, begin: float, free: Array
    ) -> tuple[Keyframe, ...]:
        """Return ways to place the part, the soonest first."""
        scenes, problem = self.scenes, self.scenes.problem
        phase = (scenes.held_at_goal(robot, hold), scenes.empty_at_goal(robot))
        found = self._ways(
            robot,
            problem.tool_pose(scenes.part, scenes.part.goal, *hold),
            scenes.part.insertion,
            phase,
            max(self.ready, begin),
            problem.seconds.place,
            self.settings.places,
        )
        cut = (Keyframe(k.motion, common(k.windows, free)) for k in found)
        return tuple(k for k in cut if len(k.windows))

    def _free_place(self) -> Array:
        """Return the spans from which on nothing that is fixed runs into the part in its place."""
        checker, q = self.scenes.lying
        begin = max(self.ready, checker.start)
        # It counts as lying there from the beginning of the skill that places it.
        return arrival_windows([(checker, q)], np.inf, begin)

    def _ways(
        self,
        robot: str,
        tool: Transform,
        insertion: Array | None,
        phase: Phase,
        begin: float,
        seconds: float,
        wanted: int,
    ) -> tuple[Keyframe, ...]:
        """Return ways to touch at a tool pose; without ``insertion`` straight along the tool."""
        problem = self.scenes.problem
        placed = problem.cell.robot(robot)
        into = tool[:3, 2] if insertion is None else insertion
        ways = (problem.approach * into, -problem.approach * tool[:3, 2])
        checker, velocity = phase[0], np.asarray(problem.speeds[robot])
        q_start = checker.start_configuration()
        sampler = self.bounds.sampler(robot)
        out: list[Keyframe] = []
        for _ in range(self.settings.draws):
            drawn = sampler.sample(tool, self.rng, self.settings.starts)
            drawn.sort(key=lambda q: checker.least_duration(q_start, q))
            for q in drawn:
                soon = checker.begin[0] + checker.least_duration(q_start, q)
                soon = max(soon, begin)
                t = soon + self.rng.uniform(0.0, self.settings.spread)
                if not checker.configuration_free(q, t):
                    continue
                motion = skill_motion(placed, problem.frame, q, ways, velocity, seconds)
                if motion is None:
                    continue
                windows = self._windows(motion, phase, soon)
                if len(windows):
                    out.append(Keyframe(motion, windows))
                if len(out) >= wanted:
                    break
            if len(out) >= wanted:
                break
        return tuple(sorted(out, key=lambda k: k.earliest))

    def _windows(self, motion: SkillMotion, phase: Phase, earliest: float) -> Array:
        parts = [(phase[0], motion.before), (phase[1], motion.after)]
        latest = earliest + self.settings.ahead
        return arrival_windows(parts, motion.seconds, earliest, latest)


def common(a: Array, b: Array) -> Array:
    """Return the times that are in spans of both, shapes (w, 2) [s]."""
    out = [
        (max(lo, low), min(hi, high))
        for lo, hi in a.tolist()
        for low, high in b.tolist()
        if max(lo, low) <= min(hi, high)
    ]
    return np.array(sorted(out), dtype=np.float64).reshape(-1, 2)
