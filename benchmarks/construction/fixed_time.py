"""The baseline of the paper: the same decomposition, but every action lasts a fixed time (V-B5).

A pick begins a multiple of T after the robot became free, a place a multiple of T after the
pick. Keyframes are only drawn for such times, one after another, and paths must arrive exactly
then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from planning.construction.keyframes import (
    Keyframe,
    KeyframeSolver,
    Phase,
    feasible_holds,
)
from planning.construction.planner import (
    ConstructionPlan,
    plan_with_solver,
)
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.problem.reach_bounds import reach_bounds
from planning.construction.problem.settings import PlannerSettings
from planning.construction.step_scenes import StepScenes
from planning.construction.subproblem import (
    Attempt,
    Leg,
    LegPlanner,
    Solution,
    SubproblemSolver,
    retreat_hints,
)
from planning.construction.world.fixed_world import BuildState
from planning.construction.world.skill_motion import SkillMotion
from planning.handling.skill_contacts import grip_contact
from planning.progress import Progress, no_progress
from planning.transforms import Array

_TRIALS = 11
"""Multiples of T that are tried, as many as in the authors' code."""


class FixedTimeKeyframes(KeyframeSolver):
    """Finds keyframes for one instant only.

    Attributes:
        instant: when the skill begins [s].
    """

    instant: float = 0.0

    def _drawn_time(self, soon: float) -> float:
        return max(self.instant, soon)

    def _windows(self, motion: SkillMotion, phase: Phase, earliest: float) -> Array:
        start, end = self.instant, self.instant + motion.seconds
        parts = ((phase[0], motion.before), (phase[1], motion.after))
        if start < earliest or not all(
            checker.skill_free(path, start, end) for checker, path in parts
        ):
            return np.empty((0, 2))
        return np.array([[start, start]])


@dataclass
class FixedTimeSolver(SubproblemSolver):
    """Plans one part with actions of a fixed duration, without handovers.

    Attributes:
        duration: T [s].
    """

    duration: float = 4.0

    def solve(self, building: BuildState, attempt: Attempt) -> Solution | None:
        """Return how a part can be brought to its place, None where that failed."""
        part, latest, robot = attempt.part, attempt.latest, attempt.robots[0]
        settings = self.attempt_settings(attempt)
        rng = np.random.default_rng(attempt.seed)
        hints = retreat_hints(building.world, robot)
        world = building.world.without_retreat(robot)
        building = replace(building, world=world)
        scenes = StepScenes(self.problem, world, part, (robot,))
        opens = self.earliest_times(building, part)
        solver = FixedTimeKeyframes(scenes, self.bounds, opens, settings.keyframes, rng)
        legs = LegPlanner(settings.rrt, rng, self.watch)
        holds = feasible_holds(self.bounds, robot, part)
        hold = holds[int(rng.integers(len(holds)))]
        begin = world.robots[robot].end

        def pick(instant: float) -> Leg | None:
            goals = self._drawn(solver, instant, lambda: solver.picks(robot, hold))
            if not goals:
                return None
            return legs.leg(building, robot, goals, hints=hints, latest=latest)

        def place(instant: float) -> Leg | None:
            goals = self._drawn(solver, instant, lambda: solver.places(robot, hold))
            if not goals:
                return None
            allowed = grip_contact(robot, part.name)
            return legs.leg(
                building, robot, goals, allowed=allowed, linger=True, latest=latest
            )

        leg = self._first(begin, pick)
        if leg is None or leg.lost >= attempt.lost:
            return None
        building, key, start, earliest, lost = leg
        late = start - earliest
        pose = self.problem.held_in_flange(robot, part, *hold)
        allowed = grip_contact(robot, part.name)
        touching = allowed | self.problem.start_contacts[part.name]
        building = building.worked(
            key.motion, "pick", part.name, start, robot, pose, touching
        )
        leg = self._first(building.world.robots[robot].end, place)
        if leg is None or lost + leg.lost >= attempt.lost:
            return None
        building, key, start, earliest, more = leg
        late = start - max(opens.place, earliest - late)
        touching = allowed | self.problem.goal_contacts[part.name]
        building = building.worked(
            key.motion, "place-down", part.name, start, None, part.goal, touching
        )
        done = legs.retreat(building, robot)
        return None if done is None else Solution(done, late, lost + more)

    def _drawn(
        self,
        solver: FixedTimeKeyframes,
        instant: float,
        draw: Callable[[], tuple[Keyframe, ...]],
    ) -> tuple[Keyframe, ...]:
        solver.instant = instant
        with self.watch.time("keyframes"):
            return draw()

    def _first(self, begin: float, go: Callable[[float], Leg | None]) -> Leg | None:
        """Return a path to the beginning of a skill at the first multiple of T that works."""
        for k in range(1, _TRIALS + 1):
            leg = go(begin + k * self.duration)
            if leg is not None:
                travel = leg.start - begin - leg.lost
                slots = max(int(np.ceil(travel / self.duration - 1e-9)), 1)
                return leg._replace(
                    earliest=begin + self.duration,
                    lost=leg.start - begin - slots * self.duration,
                )
        return None


def plan_fixed_time(
    problem: ConstructionProblem,
    duration: float,
    settings: PlannerSettings | None = None,
    progress: Progress = no_progress,
) -> ConstructionPlan:
    """Plan a construction with actions of a fixed duration.

    Args:
        problem: what is built by whom.
        duration: T: from the end of a skill to the beginning of the next one, or a multiple of
            it [s].
        settings: how hard is tried.
        progress: told how many parts are planned, of how many.

    Raises:
        ConstructionError: no plan was found.
    """
    settings = settings or PlannerSettings()
    bounds = reach_bounds(problem)
    solver = FixedTimeSolver(bounds, settings.subproblem, duration=duration)
    return plan_with_solver(solver, settings.search, progress)
