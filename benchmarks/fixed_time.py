"""The baseline of the paper: the same decomposition, but every action lasts a fixed time (V-B5).

A pick begins a multiple of T after the robot became free, a place a multiple of T after the
pick. Keyframes are only drawn for such times, one after another, and paths must arrive exactly
then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planning.construction.attempt import Attempt
from planning.construction.checks.checker import Pairs
from planning.construction.effort import SubproblemSettings
from planning.construction.keyframes.keyframes import Keyframe
from planning.construction.keyframes.known_ways import way_out
from planning.construction.keyframes.solver import (
    KeyframeSolver,
    Phase,
    holds_of,
)
from planning.construction.keyframes.step_scenes import StepScenes
from planning.construction.planner import (
    ConstructionPlan,
    PlannerSettings,
    no_progress,
    plan_with,
)
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.problem.touching import PartContacts, held_by
from planning.construction.stopwatch import Stopwatch
from planning.construction.subproblem import Leg, Solution, SubproblemSolver
from planning.construction.world.building import Building
from planning.construction.world.fixed_world import drop_tail
from planning.construction.world.skill_motion import SkillMotion
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


class FixedTimeSolver(SubproblemSolver):
    """Plans one part with actions of a fixed duration, without handovers.

    Args:
        problem: parts and team.
        bounds: who reaches what.
        contacts: of all parts.
        settings: how hard is tried.
        watch: what takes how long.
        duration: T [s].
    """

    def __init__(
        self,
        problem: ConstructionProblem,
        bounds: ReachBounds,
        contacts: PartContacts,
        settings: SubproblemSettings,
        watch: Stopwatch,
        duration: float,
    ) -> None:
        super().__init__(problem, bounds, contacts, settings, watch)
        self.duration = duration

    def solve(self, building: Building, attempt: Attempt) -> Solution | None:
        """Return how a part can be brought to its place, None where that failed."""
        part, latest, robot = attempt.part, attempt.latest, attempt.robots[0]
        settings = self.settings.of(attempt)
        rng = np.random.default_rng(attempt.seed)
        hints = way_out(building.world, robot)
        world = drop_tail(building.world, robot)
        building = replace(building, world=world)
        scenes = StepScenes(self.problem, self.contacts, world, part, (robot,))
        opens = self.soonest(building, part)
        solver = FixedTimeKeyframes(scenes, self.bounds, opens, settings.keyframes, rng)
        holds = holds_of(self.bounds, robot, part)
        hold = holds[int(rng.integers(len(holds)))]
        begin = world.robots[robot].end
        with self.watch.time("keyframes"):
            free = solver.free_place()

        def pick() -> tuple[Keyframe, ...]:
            return solver.picks(robot, hold, begin)

        def place() -> tuple[Keyframe, ...]:
            return solver.places(robot, hold, begin, free)

        leg = self._action(
            building, robot, solver, pick, rng, settings, hints=hints, latest=latest
        )
        if leg is None or leg.lost >= attempt.lost:
            return None
        building, key, start, soonest, lost = leg
        late = start - soonest
        pose = self.problem.held_in_flange(robot, part, *hold)
        building = building.worked(
            key.motion, "pick", part.name, start, robot, pose, hold.grip
        )
        leg = self._action(
            building,
            robot,
            solver,
            place,
            rng,
            settings,
            allowed=held_by(robot, part),
            linger=True,
            latest=latest,
        )
        if leg is None or lost + leg.lost >= attempt.lost:
            return None
        building, key, start, soonest, more = leg
        late = start - max(opens.place, soonest - late)
        building = building.worked(
            key.motion, "place-down", part.name, start, None, part.goal, hold.grip
        )
        done = self._retract(building, robot, rng, settings)
        return None if done is None else Solution(done, late, lost + more)

    def _action(
        self,
        building: Building,
        robot: str,
        solver: FixedTimeKeyframes,
        draw: Callable[[], tuple[Keyframe, ...]],
        rng: np.random.Generator,
        settings: SubproblemSettings,
        *,
        allowed: Pairs = frozenset(),
        hints: Array | None = None,
        linger: bool = False,
        latest: float = np.inf,
    ) -> Leg | None:
        """Return a path to the beginning of a skill at the first multiple of T that works."""
        begin = building.world.robots[robot].end
        for k in range(1, _TRIALS + 1):
            solver.instant = begin + k * self.duration
            with self.watch.time("keyframes"):
                goals = draw()
            if goals:
                leg = self._leg(
                    building,
                    robot,
                    goals,
                    rng,
                    settings,
                    allowed=allowed,
                    hints=hints,
                    linger=linger,
                    latest=latest,
                )
                if leg is not None:
                    travel = leg.start - begin - leg.lost
                    slots = max(int(np.ceil(travel / self.duration - 1e-9)), 1)
                    return leg._replace(
                        soonest=begin + self.duration,
                        lost=leg.start - begin - slots * self.duration,
                    )
        return None


def plan_fixed_time(
    problem: ConstructionProblem,
    duration: float,
    settings: PlannerSettings | None = None,
    progress: Callable[[int, int], None] = no_progress,
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
    bounds = ReachBounds(problem)
    watch = Stopwatch()
    solver = FixedTimeSolver(
        problem, bounds, PartContacts(problem), settings.subproblem, watch, duration
    )
    return plan_with(solver, bounds, settings.search, progress)
