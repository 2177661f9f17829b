"""One object and a few robots among fixed timelines: keyframes, then paths leg by leg (IV-A to IV-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planning.construction.attempt import Attempt
from planning.construction.checks.checker import Pairs, SpaceTimeChecker
from planning.construction.effort import SubproblemSettings
from planning.construction.keyframes.keyframes import Keyframe, Keyframes
from planning.construction.keyframes.known_ways import way_in, way_out
from planning.construction.keyframes.solver import KeyframeSolver, Soonest
from planning.construction.keyframes.step_scenes import StepScenes
from planning.construction.object_order import ready_at
from planning.construction.paths.rrt import space_time_rrt
from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.problem.touching import PartContacts, held_by
from planning.construction.stopwatch import Stopwatch
from planning.construction.world.building import Building
from planning.construction.world.fixed_world import drop_tail
from planning.construction.world.skill_motion import SkillMotion
from planning.transforms import Array


class Leg(NamedTuple):
    """A path to the beginning of a skill.

    Attributes:
        building: the state then.
        keyframe: which skill.
        start: when it begins [s].
        soonest: how soon speeds and the world at the goals would have let it begin [s].
        lost: how much later it begins than speeds alone would allow [s].
    """

    building: Building
    keyframe: Keyframe
    start: float
    soonest: float
    lost: float


@dataclass(frozen=True)
class Solution:
    """A part that has been brought to its place.

    Attributes:
        building: the state after it.
        late: how much later it is placed than speeds and the world at the places of its skills
            allow [s].
        lost: for how long the robots that pick and place it stood or went out of others' way
            on their way there; handing it over is not counted [s].
    """

    building: Building
    late: float
    lost: float


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

    def solve(self, building: Building, attempt: Attempt) -> Solution | None:
        """Return how a part can be brought to its place, None where that failed."""
        settings = self.settings.of(attempt)
        part, team = attempt.part, attempt.robots
        rng = np.random.default_rng(attempt.seed)
        world = building.world
        hints = way_out(world, team[0])
        for robot in team:
            world = drop_tail(world, robot)
        building = Building(world, building.work, building.placed)
        scenes = StepScenes(self.problem, self.contacts, world, part, team)
        soonest = self.soonest(building, part)
        solver = KeyframeSolver(scenes, self.bounds, soonest, settings.keyframes, rng)
        options = solver.alone(*team) if len(team) == 1 else solver.handed_over(*team)
        for _ in range(settings.holds):
            with self.watch.time("keyframes"):
                found = next(options, None)
            if found is None:
                return None
            done = self._go(building, attempt, found, rng, settings, hints)
            if done is not None:
                return done
        return None

    def soonest(self, building: Building, part: Part) -> Soonest:
        """Return when a part may be picked and placed.

        What touches it in its place has to be there, too: contacts in place are never looked
        at, and so nobody would see that another robot still has it in hand. So it is with what
        lies on it in the supply.
        """
        above = self.problem.graph.covers.get(part.name, frozenset())
        lifted = [w.end for w in building.work if w.kind == "pick" and w.part in above]
        touching = {name for pair in self.contacts.at_goal(part) for name in pair}
        there = [end for name, end in building.placed.items() if name in touching]
        ready = ready_at(self.problem, part.name, building.placed)
        return Soonest(max(lifted, default=0.0), max([ready, *there]))

    def _go(
        self,
        building: Building,
        attempt: Attempt,
        keyframes: Keyframes,
        rng: np.random.Generator,
        settings: SubproblemSettings,
        hints: Array,
    ) -> Solution | None:
        """Return the state after all actions with given keyframes, leg by leg.

        Args:
            building: the state before.
            attempt: what is placed by whom.
            keyframes: of the skills.
            rng: what is drawn from.
            settings: how hard is tried.
            hints: places on a way out for the first robot, shape (h, n).
        """
        problem, part, team = self.problem, attempt.part, attempt.robots
        robot, hold = team[0], keyframes.holds[0]
        latest = attempt.latest - problem.seconds.place
        leg = self._leg(
            building,
            robot,
            keyframes.picks,
            rng,
            settings.unhurried(self._spare(robot, keyframes)),
            hints=hints,
            latest=latest - problem.seconds.pick,
            most=attempt.lost,
        )
        if leg is None or leg.lost >= attempt.lost:
            return None
        building, pick, start, soonest, lost = leg
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
        leg = self._leg(
            building,
            robot,
            keyframes.places,
            rng,
            settings,
            allowed=held_by(robot, part),
            linger=True,
            latest=latest,
            most=attempt.lost - lost,
        )
        if leg is None or lost + leg.lost >= attempt.lost:
            return None
        building, place, start, soonest, more = leg
        opens = min(place.earliest for place in keyframes.places)
        late = start - max(opens, soonest - late)
        building = building.worked(
            place.motion, "place-down", part.name, start, None, part.goal, hold.grip
        )
        done = self._retract(building, robot, rng, settings)
        return None if done is None else Solution(done, late, lost + more)

    def _spare(self, robot: str, keyframes: Keyframes) -> float:
        """Return how much later than possible a part may be picked and still be in time [s]."""
        if len(keyframes.holds) > 1:
            return 0.0  # another robot places it
        velocity = np.asarray(self.problem.speeds[robot])
        pick = keyframes.picks[0]
        have = pick.earliest + pick.motion.seconds
        spare = np.inf
        for place in keyframes.places:
            travel = np.max(np.abs(place.start - pick.motion.path[-1]) / velocity)
            spare = min(spare, place.earliest - have - float(travel))
        return max(spare, 0.0)

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
        leg = self._leg(building, giver, meetings, rng, settings, allowed=allowed)
        if leg is None:
            return None
        building, chosen, waits, _, _ = leg
        meeting = next(m for m in keyframes.meetings if m.giver is chosen)
        motion = chosen.motion
        goal = Keyframe(_standing(taker, meeting.taker), _from(chosen.windows, waits))
        leg = self._leg(building, taker, [goal], rng, settings)
        if leg is None:
            return None
        building, _, start, _, _ = leg
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
        rng: np.random.Generator,
        settings: SubproblemSettings,
        *,
        allowed: Pairs = frozenset(),
        hints: Array | None = None,
        linger: bool = False,
        latest: float = np.inf,
        most: float = np.inf,
    ) -> Leg | None:
        """Return a path to the beginning of a skill, None where none was found."""
        with self.watch.time("path"):
            checker = SpaceTimeChecker(building.world, (robot,), allowed=allowed)
            here = checker.start_configuration()
            far = max(checker.least_duration(here, goal.start) for goal in goals)
            # Whoever is later than this at the farthest goal has lost too much.
            latest = min(latest, checker.start + far + most)
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
        goal = goals[found.goal]
        travel = checker.least_duration(checker.start_configuration(), goal.start)
        lost = found.arrival - checker.start - travel
        building = building.moved(robot, found.time, found.path)
        return Leg(building, goal, found.arrival, found.earliest, lost)

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
                hints=way_in(building.world, robot),
                settings=settings.rrt,
                seed=_seed(rng),
            )
        if found is None:
            return None
        return building.moved(robot, found.time, found.path, work=False)


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
