"""Planning of a sub-problem (one part, a few robots): keyframes, then paths (Hartmann et al. IV-A to IV-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from planning.construction.candidates import Skeleton, earliest_placement_time
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.checks.time_windows import arrival_windows
from planning.construction.keyframes import (
    EarliestTimes,
    Keyframe,
    Keyframes,
    KeyframeSolver,
    intersect_windows,
)
from planning.construction.paths.rrt import space_time_rrt
from planning.construction.problem.problem import ConstructionProblem, Hold, Part
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.problem.settings import RrtSettings, SubproblemSettings
from planning.construction.step_scenes import StepScenes
from planning.construction.stopwatch import Stopwatch
from planning.construction.world.fixed_world import (
    BuildState,
    FixedWorld,
    HeldPlacement,
)
from planning.construction.world.skill_motion import SkillMotion
from planning.construction.world.timeline import RobotTimeline
from planning.handling.skill_contacts import NOTHING, grip_contact
from planning.steps.skill import Pairs
from planning.transforms import Array

_SPACING = 0.75
"""Most between places on earlier paths that are hints for new ones [s]."""


class Leg(NamedTuple):
    """A path to the beginning of a skill.

    Attributes:
        building: the state then.
        keyframe: which skill.
        start: when it begins [s].
        earliest: how soon speeds and the world at the goals would have let it begin [s].
        lost: how much later it begins than speeds alone would allow [s].
    """

    building: BuildState
    keyframe: Keyframe
    start: float
    earliest: float
    lost: float


@dataclass(frozen=True)
class LegPlanner:
    """Plans legs.

    Attributes:
        settings: effort.
        rng: what seeds are drawn from.
        watch: what takes how long.
    """

    settings: RrtSettings
    rng: np.random.Generator
    watch: Stopwatch

    def with_delay(self, spare: float) -> LegPlanner:
        """Return a leg planner that may arrive late, by at most a given time [s]."""
        enough = max(self.settings.good_enough_s, 0.7 * spare)
        return replace(self, settings=self.settings._replace(good_enough_s=enough))

    def leg(
        self,
        building: BuildState,
        robot: str,
        goals: Sequence[Keyframe],
        *,
        allowed: Pairs = NOTHING,
        hints: Array | None = None,
        linger: bool = False,
        latest: float = np.inf,
        most_loss: float = np.inf,
        work: bool = True,
    ) -> Leg | None:
        """Return a path to the beginning of a skill, None where none was found.

        Args:
            building: the state before.
            robot: the robot.
            goals: candidates of the skill; none to go HOME.
            allowed: unordered pairs of entities that may touch.
            hints, linger: see ``space_time_rrt``.
            latest: no later arrival is of use [s].
            most_loss: greatest loss of time [s].
            work: False for a retreat out of others' way.
        """
        with self.watch.time("path"):
            checker = SpaceTimeChecker(building.world, robot, allowed=allowed)
            here = checker.start_configuration()
            goals = goals or [_stand_at_home(checker)]
            far = max(checker.least_duration(here, goal.start) for goal in goals)
            # A later arrival at the farthest goal loses too much time.
            latest = min(latest, checker.start + far + most_loss)
            found = space_time_rrt(
                checker,
                np.array([goal.start for goal in goals]),
                [goal.windows for goal in goals],
                self.settings,
                latest=latest,
                hints=hints,
                linger=linger,
                seed=int(self.rng.integers(2**31)),
                watch=self.watch,
            )
        if found is None:
            return None
        goal = goals[found.goal]
        lost = found.arrival - checker.start - checker.least_duration(here, goal.start)
        building = building.moved(robot, found.time, found.path, work=work)
        return Leg(building, goal, found.arrival, found.earliest, lost)

    def retreat(self, building: BuildState, robot: str) -> BuildState | None:
        """Return the state in which a robot has retreated to HOME, out of the others' way."""
        hints = _approach_hints(building.world, robot)
        leg = self.leg(building, robot, (), hints=hints, work=False)
        return None if leg is None else leg.building


def _stand_at_home(checker: SpaceTimeChecker) -> Keyframe:
    """Return a final hold at HOME."""
    home, here = checker.home, checker.start_configuration()
    soon = checker.start + checker.least_duration(here, home)
    windows = arrival_windows([(checker, home)], np.inf, soon)
    return Keyframe(_standing(checker.robot, home), windows)


def retreat_hints(world: FixedWorld, robot: str) -> Array:
    """Return waypoint hints for a robot's retreat, shape (w, n)."""
    line = world.robots[robot]
    return _places(line, line.busy_until, line.end)


def _approach_hints(world: FixedWorld, robot: str) -> Array:
    """Return waypoint hints from a robot's last approach, usable for its return, shape (w, n)."""
    line = world.robots[robot]
    if not line.skills:
        return _places(line, 0.0, 0.0)
    since = line.skills[-2][1] if len(line.skills) > 1 else 0.0
    return _places(line, since, line.skills[-1][0])


def _places(line: RobotTimeline, since: float, until: float) -> Array:
    """Return configurations on a robot's path: waypoints, and some in between, shape (w, n)."""
    corners = line.time[(line.time > since) & (line.time < until)]
    times = np.unique(np.concatenate([corners, np.arange(since, until, _SPACING)]))
    path = [line.at(float(t)) for t in times]
    return np.array(path).reshape(len(times), line.path.shape[1])


@dataclass(frozen=True)
class Attempt:
    """One attempt to bring a part to its place.

    Attributes:
        part: what is placed; it is placeable.
        robots: the robots that do it, in order.
        seed: of all random numbers.
        effort: how much harder than usual is tried, from 0.
        low_effort: only paths that are easy to find are searched.
        latest: latest time at which the part is in its place [s].
        lost: greatest useful loss of time [s].
        keep: whether the robot that places the part keeps holding it.
        hold: how the first robot has it in the hand already; None where it is to be picked.
    """

    part: Part
    robots: Skeleton
    seed: Sequence[int]
    effort: int = 0
    low_effort: bool = False
    latest: float = np.inf
    lost: float = np.inf
    keep: bool = False
    hold: Hold | None = None


@dataclass(frozen=True)
class Solution:
    """A part brought to its place: the resulting state and its quality.

    Attributes:
        building: the state after it.
        late: how much later it is placed than speeds and the world at the places of its skills
            allow [s].
        lost: for how long the robots that pick and place it stood or went out of others' way
            on their way there; handing it over is not counted [s].
    """

    building: BuildState
    late: float
    lost: float


@dataclass
class SubproblemSolver:
    """Plans one part for one group of robots after another.

    Attributes:
        bounds: reachability of the parts.
        settings: effort for one sub-problem.
        watch: what takes how long.
    """

    bounds: ReachBounds
    settings: SubproblemSettings
    watch: Stopwatch = field(default_factory=Stopwatch)

    @property
    def problem(self) -> ConstructionProblem:
        """Parts and team."""
        return self.bounds.problem

    def solve(self, building: BuildState, attempt: Attempt) -> Solution | None:
        """Plan the transport of a part to its place; None where that failed."""
        settings = self.attempt_settings(attempt)
        part, team = attempt.part, attempt.robots
        rng = np.random.default_rng(attempt.seed)
        world = building.world
        hints = retreat_hints(world, team[0])
        for robot in team:
            world = world.without_retreat(robot)
        building = replace(building, world=world)
        scenes = StepScenes(self.problem, world, part, team)
        earliest_times = self.earliest_times(building, part)
        solver = KeyframeSolver(
            scenes, self.bounds, earliest_times, settings.keyframes, rng
        )
        if attempt.hold is not None:
            options = solver.in_hand(team, attempt.hold)
        else:
            one = len(team) == 1
            options = (
                solver.single_robot_keyframes(*team)
                if one
                else solver.handed_over(*team)
            )
        legs = LegPlanner(settings.rrt, rng, self.watch)
        for _ in range(settings.holds):
            with self.watch.time("keyframes"):
                found = next(options, None)
            if found is None:
                return None
            done = self._bring(building, attempt, found, legs, hints)
            if done is not None:
                return done
        return None

    def attempt_settings(self, attempt: Attempt) -> SubproblemSettings:
        """Return the effort for an attempt."""
        if attempt.low_effort:
            return self.settings.low_effort()
        return self.settings.with_more_effort(attempt.effort)

    def earliest_times(self, building: BuildState, part: Part) -> EarliestTimes:
        """Return the earliest times at which a part may be picked and placed.

        What touches it in its place has to be there, too: contacts in place are never looked
        at, and so nobody would see that another robot still has it in hand. So it is with what
        lies on it in the supply.
        """
        above = self.problem.graph.covers.get(part.name, frozenset())
        lifted = [
            w.end for w in building.work if w.kind == "pick" and w.object in above
        ]
        touching = {
            name for pair in self.problem.goal_contacts[part.name] for name in pair
        }
        there = [end for name, end in building.placed.items() if name in touching]
        ready = earliest_placement_time(self.problem, part.name, building.placed)
        return EarliestTimes(max(lifted, default=0.0), max([ready, *there]))

    def _bring(
        self,
        building: BuildState,
        attempt: Attempt,
        keyframes: Keyframes,
        legs: LegPlanner,
        hints: Array,
    ) -> Solution | None:
        """Return the state after all actions of given keyframes, leg by leg.

        Args:
            building: the state before.
            attempt: the part and its robots.
            keyframes: of the skills.
            legs: plans the paths.
            hints: places on a way out for the first robot, shape (h, n).
        """
        problem, part, team = self.problem, attempt.part, attempt.robots
        robot, late, lost = team[0], 0.0, 0.0
        latest = attempt.latest - problem.seconds_of("place-down", team[-1], part)
        if attempt.hold is None:
            picked = self._pick(building, attempt, keyframes, legs, hints, latest)
            if picked is None:
                return None
            building, late, lost = picked
        for k, robots in enumerate(pairwise(team)):
            met = self._hand_over(building, part, robots, keyframes, k, legs)
            if met is None:
                return None
            building, robot = met, team[-1]
        leg = legs.leg(
            building,
            robot,
            keyframes.places,
            allowed=grip_contact(robot, part.name),
            linger=True,
            latest=latest,
            most_loss=attempt.lost - lost,
        )
        if leg is None or lost + leg.lost >= attempt.lost:
            return None
        building, place, start, earliest, more = leg
        opens = min(place.earliest for place in keyframes.places)
        late = start - max(opens, earliest - late)
        touching = grip_contact(robot, part.name) | problem.goal_contacts[part.name]
        motion = place.motion.kept() if attempt.keep else place.motion
        building = building.worked(
            motion, "place-down", part.name, start, None, part.goal, touching
        )
        if attempt.keep:
            keeping = HeldPlacement(robot, place.motion.after)
            kept = {**building.kept, part.name: keeping}
            return Solution(replace(building, kept=kept), late, lost + more)
        done = legs.retreat(building, robot)
        return None if done is None else Solution(done, late, lost + more)

    def _pick(
        self,
        building: BuildState,
        attempt: Attempt,
        keyframes: Keyframes,
        legs: LegPlanner,
        hints: Array,
        latest: float,
    ) -> tuple[BuildState, float, float] | None:
        """Return the state with the part in the first robot's hand, its delay and the time lost [s]."""
        problem, part = self.problem, attempt.part
        robot, hold = attempt.robots[0], keyframes.holds[0]
        leg = legs.with_delay(self._spare(robot, keyframes)).leg(
            building,
            robot,
            keyframes.picks,
            hints=hints,
            latest=latest - problem.seconds_of("pick", robot, part),
            most_loss=attempt.lost,
        )
        if leg is None or leg.lost >= attempt.lost:
            return None
        building, pick, start, earliest, lost = leg
        late = start - earliest
        pose = problem.held_in_flange(robot, part, *hold)
        touching = grip_contact(robot, part.name) | problem.start_contacts[part.name]
        building = building.worked(
            pick.motion, "pick", part.name, start, robot, pose, touching
        )
        return building, late, lost

    def _spare(self, robot: str, keyframes: Keyframes) -> float:
        """Return the slack of a pick: how much later than its earliest time it may be [s]."""
        if len(keyframes.holds) > 1:
            return 0.0  # another robot places it
        velocity = self.problem.cell.robot(robot).model.velocity
        pick = keyframes.picks[0]
        have = pick.earliest + pick.motion.seconds
        spare = np.inf
        for place in keyframes.places:
            travel = np.max(np.abs(place.start - pick.motion.path[-1]) / velocity)
            spare = min(spare, place.earliest - have - float(travel))
        return max(spare, 0.0)

    def _hand_over(
        self,
        building: BuildState,
        part: Part,
        robots: tuple[str, str],
        keyframes: Keyframes,
        number: int,
        legs: LegPlanner,
    ) -> BuildState | None:
        """Return the state in which the receiver has the part and the giver has moved clear.

        The giver comes first and waits; the taker comes as soon as it can, and then the part
        changes hands at once.
        """
        giver, taker = robots
        allowed = grip_contact(giver, part.name)
        handover = keyframes.handovers[number]
        meetings = [meeting.giver for meeting in handover]
        leg = legs.leg(building, giver, meetings, allowed=allowed)
        if leg is None:
            return None
        building, chosen, waits, _, _ = leg
        meeting = next(m for m in handover if m.giver is chosen)
        motion = chosen.motion
        windows = intersect_windows(chosen.windows, np.array([[waits, np.inf]]))
        goal = Keyframe(_standing(taker, meeting.taker), windows)
        leg = legs.leg(building, taker, [goal])
        if leg is None:
            return None
        building, _, start, _, _ = leg
        with self.watch.time("path"):
            # Others were planned before the giver was to wait here.
            checker = SpaceTimeChecker(building.world, giver, allowed=allowed)
            if not checker.skill_free(motion.path[:1], waits, start):
                return None
        pose = self.problem.held_in_flange(taker, part, *keyframes.holds[number + 1])
        touching = allowed | grip_contact(taker, part.name)
        building = building.worked(
            motion, "handover", part.name, start, taker, pose, touching
        )
        stand = np.array([start, start + motion.seconds])
        building = building.moved(taker, stand, np.tile(meeting.taker, (2, 1)))
        return legs.retreat(building, giver)


def _standing(robot: str, q: Array) -> SkillMotion:
    """Return a skill in which the robot only stands."""
    return SkillMotion(robot, q[None], 0, np.zeros(1))
