"""One object and a few robots among fixed timelines: keyframes, then paths leg by leg (IV-A to IV-C)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.construction.bounds import ReachBounds
from planning.construction.building import Building
from planning.construction.fixed_world import FixedWorld, drop_tail
from planning.construction.keyframe_solver import KeyframeSettings, KeyframeSolver
from planning.construction.keyframes import Keyframe, Keyframes
from planning.construction.object_order import ready_at
from planning.construction.part_contacts import PartContacts, held_by
from planning.construction.problem import ConstructionProblem, Part
from planning.construction.skeletons import Skeleton
from planning.construction.skill_motion import SkillMotion
from planning.construction.space_time_checker import SpaceTimeChecker
from planning.construction.space_time_rrt import RrtSettings, space_time_rrt
from planning.construction.step_scenes import StepScenes
from planning.construction.stopwatch import Stopwatch
from planning.construction.timeline import RobotTimeline
from planning.transforms import Array

_RRT = RrtSettings(
    good_enough=1.0,
    bearable=10.0,
    patience=80,
    rounds=1,
    vertices=80,
    neighbours=16,
    checks=300,
)
"""A path that arrives a second late is good enough: better ones cost more than they gain."""

_SPACING = 0.75
"""Places on ways known before that roadmaps are given are so far apart [s]."""


@dataclass(frozen=True)
class Solution:
    """A part that has been brought to its place.

    Attributes:
        building: the state after it.
        late: how much later than speeds and the world allow the paths to its skills arrive,
            in all [s].
    """

    building: Building
    late: float


@dataclass(frozen=True)
class SubproblemSettings:
    """How hard one sub-problem is worked on.

    Attributes:
        keyframes: how hard keyframes are looked for.
        rrt: how hard paths are looked for.
        holds: ways to hold the part for which paths are looked for.
    """

    keyframes: KeyframeSettings = field(default_factory=KeyframeSettings)
    rrt: RrtSettings = _RRT
    holds: int = 2

    def hasty(self) -> SubproblemSettings:
        """Return the settings with which paths are looked for that are easy to find."""
        return replace(self, rrt=replace(self.rrt, iterations=0, patience=0), holds=1)

    def harder(self, effort: int) -> SubproblemSettings:
        """Return the settings with which failures are gone through again."""
        if effort == 0:
            return self
        by = 3**effort
        keyframes = replace(
            self.keyframes,
            draws=self.keyframes.draws * by,
            places=self.keyframes.places * 2,
            ahead=self.keyframes.ahead * by,
            meetings=self.keyframes.meetings * by,
        )
        rrt = replace(self.rrt, iterations=self.rrt.iterations * by)
        return replace(self, keyframes=keyframes, rrt=rrt, holds=self.holds * by)


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
        self,
        building: Building,
        part: Part,
        skeleton: Skeleton,
        seed: Sequence[int],
        effort: int = 0,
        *,
        hasty: bool = False,
        latest: float = np.inf,
    ) -> Solution | None:
        """Return how a part can be brought to its place, None where that failed.

        Args:
            building: the state before.
            part: what is placed; it is placeable.
            skeleton: who does what.
            seed: of all random numbers.
            effort: how much harder than usual is tried.
            hasty: nothing is tried hard.
            latest: the part must be in its place by then [s].
        """
        settings = self.settings.hasty() if hasty else self.settings.harder(effort)
        self._late = 0.0
        self._latest = latest
        team = tuple(dict.fromkeys(action.robot for action in skeleton))
        rng = np.random.default_rng(seed)
        world = building.world
        hints = {robot: _way_out(world, robot) for robot in team}
        for robot in team:
            world = drop_tail(world, robot)
        building = Building(world, building.work, building.placed)
        scenes = StepScenes(self.problem, self.contacts, world, part, team)
        ready = ready_at(self.problem, part.name, building.placed)
        solver = KeyframeSolver(scenes, self.bounds, ready, settings.keyframes, rng)
        options = solver.alone(*team) if len(team) == 1 else solver.handed_over(*team)
        for _ in range(settings.holds):
            with self.watch.time("keyframes"):
                found = next(options, None)
            if found is None:
                return None
            done = self._go(building, part, team, found, hints, rng, settings)
            if done is not None:
                return Solution(done, self._late)
        return None

    def _go(
        self,
        building: Building,
        part: Part,
        team: tuple[str, ...],
        keyframes: Keyframes,
        hints: Mapping[str, Array],
        rng: np.random.Generator,
        settings: SubproblemSettings,
    ) -> Building | None:
        """Return the state after all actions with given keyframes, leg by leg."""
        problem = self.problem
        robot, hold = team[0], keyframes.holds[0]
        latest = self._latest - problem.seconds.place
        after = self._leg(
            building,
            robot,
            keyframes.picks,
            frozenset(),
            rng,
            _with_time(settings, self._spare(robot, keyframes)),
            hints=hints[robot],
            latest=latest - problem.seconds.pick,
        )
        if after is None:
            return None
        building, pick, start, soonest = after
        late = start - soonest
        pose = problem.held_in_flange(robot, part, *hold)
        building = building.worked(
            pick.motion, "pick", part.name, start, robot, pose, hold.grip
        )
        if len(team) > 1:
            met = self._hand_over(building, part, team, keyframes, rng, settings)
            if met is None:
                return None
            building, robot, hold = met, team[-1], keyframes.holds[-1]
        allowed = held_by(robot, part)
        after = self._leg(
            building,
            robot,
            keyframes.places,
            allowed,
            rng,
            settings,
            linger=True,
            latest=latest,
        )
        if after is None:
            return None
        building, place, start, soonest = after
        opens = min(float(place.windows[0, 0]) for place in keyframes.places)
        self._late = start - max(opens, soonest - late)
        building = building.worked(
            place.motion, "place-down", part.name, start, None, part.goal, hold.grip
        )
        return self._retract(building, robot, rng, settings)

    def _spare(self, robot: str, keyframes: Keyframes) -> float:
        """Return how much later than possible a part may be picked and still be in time [s]."""
        velocity = np.asarray(self.problem.speeds[robot])
        pick = keyframes.picks[0]
        have = pick.earliest + pick.motion.seconds
        spare = np.inf
        for place in keyframes.places:
            travel = np.max(np.abs(place.start - pick.motion.path[-1]) / velocity)
            spare = min(spare, place.earliest - have - float(travel))
        return max(spare, 0.0) if len(keyframes.holds) == 1 else 0.0

    def _hand_over(
        self,
        building: Building,
        part: Part,
        team: tuple[str, ...],
        keyframes: Keyframes,
        rng: np.random.Generator,
        settings: SubproblemSettings,
    ) -> Building | None:
        """Return the state in which the second robot has the part and the first is out of its way.

        The giver comes first and waits; the taker comes as soon as it can, and then the part
        changes hands at once.
        """
        giver, taker = team
        allowed = held_by(giver, part)
        meetings = [meeting.giver for meeting in keyframes.meetings]
        after = self._leg(building, giver, meetings, allowed, rng, settings)
        if after is None:
            return None
        building, chosen, waits, _ = after
        meeting = next(m for m in keyframes.meetings if m.giver is chosen)
        motion = chosen.motion
        goal = Keyframe(_standing(taker, meeting.taker), _from(chosen.windows, waits))
        after = self._leg(building, taker, [goal], frozenset(), rng, settings)
        if after is None:
            return None
        building, _, start, _ = after
        with self.watch.time("path"):
            # Others were planned before the giver was to wait here.
            checker = SpaceTimeChecker(building.world, (giver,), allowed=allowed)
            if not checker.skill_free(motion.path[:1], waits, start):
                return None
        pose = self.problem.held_in_flange(taker, part, *keyframes.holds[1])
        grip = keyframes.holds[0].grip
        building = building.worked(
            motion, "handover", part.name, start, taker, pose, grip
        )
        stand = np.array([start, start + motion.seconds])
        building = building.moved(taker, stand, np.tile(meeting.taker, (2, 1)))
        return self._retract(building, giver, rng, settings)

    def _leg(
        self,
        building: Building,
        robot: str,
        goals: Sequence[Keyframe],
        allowed: frozenset[frozenset[str]],
        rng: np.random.Generator,
        settings: SubproblemSettings,
        hints: Array | None = None,
        linger: bool = False,
        latest: float = np.inf,
    ) -> tuple[Building, Keyframe, float, float] | None:
        """Return the state at the beginning of a skill, the keyframe that it is, and when."""
        with self.watch.time("path"):
            checker = SpaceTimeChecker(building.world, (robot,), allowed=allowed)
            found = space_time_rrt(
                checker,
                np.array([goal.start for goal in goals]),
                windows=[goal.windows for goal in goals],
                hints=hints,
                linger=linger,
                latest=latest,
                settings=settings.rrt,
                seed=_seed(rng),
            )
        if found is None:
            return None
        building = building.moved(robot, found.time, found.path)
        return building, goals[found.goal], found.arrival, found.earliest

    def _retract(
        self,
        building: Building,
        robot: str,
        rng: np.random.Generator,
        settings: SubproblemSettings,
    ) -> Building | None:
        """Return the state in which a robot has gone out of the others' way."""
        home = self.problem.cell.robot(robot).home
        with self.watch.time("path"):
            checker = SpaceTimeChecker(building.world, (robot,))
            found = space_time_rrt(
                checker,
                home[None],
                stay=np.inf,
                hints=_way_in(building.world, robot),
                settings=settings.rrt,
                seed=_seed(rng),
            )
        if found is None:
            return None
        return building.moved(robot, found.time, found.path, work=False)


def _with_time(settings: SubproblemSettings, spare: float) -> SubproblemSettings:
    """Return the settings for a path that may be late: most of the time, not to spend all."""
    enough = max(settings.rrt.good_enough, 0.7 * spare)
    return replace(settings, rrt=replace(settings.rrt, good_enough=enough))


def _way_out(world: FixedWorld, robot: str) -> Array:
    """Return places on a robot's way out of others' way, shape (w, n)."""
    line = world.robots[robot]
    return _places(line, line.busy_until, line.end)


def _way_in(world: FixedWorld, robot: str) -> Array:
    """Return places on a robot's way to its last skill, which may be a way back, shape (w, n)."""
    line = world.robots[robot]
    since = line.skills[-2][1] if len(line.skills) > 1 else 0.0
    return _places(line, since, line.skills[-1][0])


def _places(line: RobotTimeline, since: float, until: float) -> Array:
    """Return places on a robot's path: waypoints, and some in between, shape (w, n)."""
    corners = line.time[(line.time > since) & (line.time < until)]
    times = np.unique(np.concatenate([corners, np.arange(since, until, _SPACING)]))
    path = [line.at(float(t)) for t in times]
    return np.array(path).reshape(len(times), line.path.shape[1])


def _standing(robot: str, q: Array) -> SkillMotion:
    """Return a skill that is nothing but standing somewhere."""
    return SkillMotion(robot, q[None], 0, np.zeros(1))


def _from(windows: Array, t: float) -> Array:
    """Return what is left of spans from a time on, shape (w, 2) [s]."""
    left = windows[windows[:, 1] >= t].copy()
    left[:, 0] = np.maximum(left[:, 0], t)
    return left


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**31))
