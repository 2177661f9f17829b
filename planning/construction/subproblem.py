"""One object and a few robots among fixed timelines: keyframes, then paths leg by leg (IV-A to IV-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from planning.construction.bounds import ReachBounds
from planning.construction.building import Building
from planning.construction.fixed_world import drop_tail
from planning.construction.keyframe_solver import KeyframeSettings, KeyframeSolver
from planning.construction.keyframes import Keyframe, Keyframes
from planning.construction.object_order import ready_at
from planning.construction.part_contacts import PartContacts, held_by
from planning.construction.problem import ConstructionProblem, Part
from planning.construction.skeletons import Skeleton
from planning.construction.space_time_checker import SpaceTimeChecker
from planning.construction.space_time_rrt import RrtSettings, space_time_rrt
from planning.construction.step_scenes import StepScenes
from planning.construction.stopwatch import Stopwatch


@dataclass(frozen=True)
class SubproblemSettings:
    """How hard one sub-problem is worked on.

    Attributes:
        keyframes: how hard keyframes are looked for.
        rrt: how hard paths are looked for.
        holds: ways to hold the part for which paths are looked for.
    """

    keyframes: KeyframeSettings = field(default_factory=KeyframeSettings)
    rrt: RrtSettings = field(default_factory=RrtSettings)
    holds: int = 2


class SubproblemSolver:
    """Plans one part for one skeleton after another.

    Args:
        problem: parts and team.
        bounds: who reaches what.
        contacts: of all parts.
        settings: how hard is tried.
        watch: what takes how long.
    """

    def __init__(
        self,
        problem: ConstructionProblem,
        bounds: ReachBounds,
        contacts: PartContacts,
        settings: SubproblemSettings,
        watch: Stopwatch,
    ) -> None:
        self.problem = problem
        self.bounds = bounds
        self.contacts = contacts
        self.settings = settings
        self.watch = watch

    def solve(
        self, building: Building, part: Part, skeleton: Skeleton, seed: Sequence[int]
    ) -> Building | None:
        """Return the state after a part has been brought to its place, None where that failed.

        Args:
            building: the state before.
            part: what is placed; it is placeable.
            skeleton: who does what.
            seed: of all random numbers.
        """
        robot = skeleton[0].robot
        rng = np.random.default_rng(seed)
        world = drop_tail(building.world, robot)
        building = Building(world, building.work, building.placed)
        scenes = StepScenes(self.problem, self.contacts, world, part, (robot,))
        ready = ready_at(self.problem, part.name, building.placed)
        solver = KeyframeSolver(
            scenes, self.bounds, ready, self.settings.keyframes, rng
        )
        options = solver.alone(robot)
        for _ in range(self.settings.holds):
            with self.watch.time("keyframes"):
                found = next(options, None)
            if found is None:
                return None
            done = self._go(building, part, robot, found, rng)
            if done is not None:
                return done
        return None

    def _go(
        self,
        building: Building,
        part: Part,
        robot: str,
        keyframes: Keyframes,
        rng: np.random.Generator,
    ) -> Building | None:
        """Return the state after pick, place and retract with given keyframes."""
        problem = self.problem
        after = self._leg(building, robot, keyframes.picks, frozenset(), rng)
        if after is None:
            return None
        building, pick, start = after
        pose = problem.held_in_flange(robot, part, *keyframes.hold)
        building = building.worked(
            pick.motion, "pick", part.name, start, robot, pose, keyframes.hold.grip
        )
        allowed = held_by(robot, part)
        after = self._leg(building, robot, keyframes.places, allowed, rng)
        if after is None:
            return None
        building, place, start = after
        building = building.worked(
            place.motion,
            "place-down",
            part.name,
            start,
            None,
            part.goal,
            keyframes.hold.grip,
        )
        return self._retract(building, robot, rng)

    def _leg(
        self,
        building: Building,
        robot: str,
        goals: Sequence[Keyframe],
        allowed: frozenset[frozenset[str]],
        rng: np.random.Generator,
    ) -> tuple[Building, Keyframe, float] | None:
        """Return the state at the beginning of a skill, the keyframe that it is, and when."""
        with self.watch.time("path"):
            checker = SpaceTimeChecker(building.world, (robot,), allowed=allowed)
            found = space_time_rrt(
                checker,
                np.array([goal.start for goal in goals]),
                windows=[goal.windows for goal in goals],
                settings=self.settings.rrt,
                seed=_seed(rng),
            )
        if found is None:
            return None
        building = building.moved(robot, found.time, found.path)
        return building, goals[found.goal], found.arrival

    def _retract(
        self, building: Building, robot: str, rng: np.random.Generator
    ) -> Building | None:
        """Return the state in which a robot has gone out of the others' way."""
        home = self.problem.cell.robot(robot).home
        with self.watch.time("path"):
            checker = SpaceTimeChecker(building.world, (robot,))
            found = space_time_rrt(
                checker,
                home[None],
                stay=np.inf,
                settings=self.settings.rrt,
                seed=_seed(rng),
            )
        if found is None:
            return None
        return building.moved(robot, found.time, found.path, work=False)


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**31))
