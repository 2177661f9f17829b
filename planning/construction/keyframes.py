"""Keyframes, the configurations in which a part changes hands (mode switches), and their solver (Hartmann et al. IV-B).

Configurations are sampled and refined by damped least squares. Each one is checked for collisions at a sampled time.
If it passes, all times at which the whole skill is free of collisions are computed; the path planner may arrive at
any of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property, partial
from itertools import islice, pairwise, product
from typing import NamedTuple

import numpy as np

from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.checks.time_windows import arrival_windows
from planning.construction.problem.problem import Hold, Part
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.problem.settings import KeyframeSettings
from planning.construction.step_scenes import StepScenes
from planning.construction.world.skill_motion import SkillMotion, skill_motion
from planning.transforms import Array, Transform

TURNS = (0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)
"""Turns of the tool about its z axis in which a grip is tried [rad]."""

_LIFT = 0.05
"""Longest straight path of two pads to a part that changes hands, and from it [m].

It is shorter than pads are: what is above the giver's pad must be clear of the part also where
that already is in the other hand, since robots may do any of a skill at any time of it.
"""

Phase = tuple[SpaceTimeChecker, SpaceTimeChecker]
"""The checks before and after a touch."""


@dataclass(frozen=True)
class Keyframe:
    """Motion of one skill, and the time windows in which it can begin.

    Attributes:
        motion: of the skill, the configuration at the switch in the middle of it.
        windows: spans of time in which the skill may begin, among all that is fixed, shape
            (w, 2) [s].
    """

    motion: SkillMotion
    windows: Array

    @property
    def start(self) -> Array:
        """Configuration at which the skill begins, shape (n,)."""
        return np.asarray(self.motion.path[0])

    @property
    def earliest(self) -> float:
        """Earliest time at which the skill can begin [s]."""
        return float(self.windows[0, 0])


@dataclass(frozen=True)
class Meeting:
    """A handover of the part: the giver's keyframe and the receiver's configuration.

    Attributes:
        giver: the skill of the robot that brings the part to the other one's pad.
        taker: where that one stands meanwhile, shape (n,).
    """

    giver: Keyframe
    taker: Array


@dataclass(frozen=True)
class Keyframes:
    """Consistent alternatives for all mode switches of a sub-problem.

    Every pick goes with every meeting and every place: they hold the part alike.

    Attributes:
        holds: how each robot that has the part holds it, in order.
        picks: candidates to pick it, the most promising first.
        places: candidates to place it, likewise.
        handovers: candidates of each handover, likewise; empty where one robot does all.
    """

    holds: tuple[Hold, ...]
    picks: tuple[Keyframe, ...]
    places: tuple[Keyframe, ...]
    handovers: tuple[tuple[Meeting, ...], ...] = ()


class EarliestTimes(NamedTuple):
    """Earliest times at which a part may be picked and placed.

    Attributes:
        pick: earliest pick, after the parts stacked on it [s].
        place: earliest placement, after its supports [s].
    """

    pick: float
    place: float


@dataclass
class KeyframeSolver:
    """Finds keyframes of one sub-problem, for one robot or for several with handovers.

    Attributes:
        scenes: checks of the sub-problem.
        bounds: reachability of the parts.
        earliest_times: when the part may be picked and placed.
        settings: effort.
        rng: what is drawn from.
    """

    scenes: StepScenes
    bounds: ReachBounds
    earliest_times: EarliestTimes
    settings: KeyframeSettings
    rng: np.random.Generator

    def in_hand(self, robots: tuple[str, ...], hold: Hold) -> Iterator[Keyframes]:
        """Yield keyframes for a part already in a robot's hand: place it or hand it over.

        Args:
            robots: the robots that hold it, in order; at most two.
            hold: how the first of them has it.
        """
        if len(robots) == 1:
            if places := self.places(robots[0], hold):
                yield Keyframes((hold,), (), places)
            return
        checker = self.scenes.held(robots[0], hold, at_goal=False)
        having = checker.start_configuration(), checker.start
        part = self.scenes.part
        for grip in self.bounds.place_grips(robots[-1], part):
            for turn in TURNS if part.grips_apart(hold.grip, grip) else ():
                holds = hold, Hold(grip, turn)
                if not (places := self.places(robots[-1], holds[1])):
                    continue
                if meetings := self.meetings((robots[0], robots[1]), holds, having):
                    yield Keyframes(holds, (), places, (meetings,))

    def single_robot_keyframes(self, robot: str) -> Iterator[Keyframes]:
        """Yield keyframes of one robot that picks and places, one per hold.

        The place is looked at first: where nothing can be put down nothing need be picked.
        """
        part = self.scenes.part
        holds = feasible_holds(self.bounds, robot, part)
        for k in self.rng.permutation(len(holds)).tolist():
            hold = holds[k]
            places = self.places(robot, hold)
            if not places:
                continue
            picks = self.picks(robot, hold)
            if picks:
                yield Keyframes((hold,), picks, places)

    def handed_over(self, *team: str) -> Iterator[Keyframes]:
        """Yield keyframes of a robot that picks, others that take over, and the last one, which places.

        The lower bounds come first again: place, then pick, then where all can meet.
        """
        alternatives = list(self._holds(team))
        places = cache(partial(self.places, team[-1]))
        picks = cache(partial(self.picks, team[0]))
        for k in self.rng.permutation(len(alternatives)).tolist():
            holds = alternatives[k]
            if not places(holds[-1]) or not picks(holds[0]):
                continue
            pick, handovers = picks(holds[0])[0], list[tuple[Meeting, ...]]()
            having = pick.motion.path[-1], pick.earliest + pick.motion.seconds
            for robots, both in zip(pairwise(team), pairwise(holds), strict=True):
                meetings = self.meetings(robots, both, having)
                if not meetings:
                    break
                handovers.append(meetings)
                first = meetings[0]
                done = first.giver.earliest + first.giver.motion.seconds
                having = first.taker, done
            else:
                yield Keyframes(
                    holds, picks(holds[0]), places(holds[-1]), tuple(handovers)
                )

    def _holds(self, team: tuple[str, ...]) -> Iterator[tuple[Hold, ...]]:
        """Yield combinations of holds of several robots whose pads have room next to each other on the part."""
        part, bounds = self.scenes.part, self.bounds
        middle = [range(len(part.grips))] * (len(team) - 2)
        first, last = (
            bounds.pick_grips(team[0], part),
            bounds.place_grips(team[-1], part),
        )
        for grips in product(first, *middle, last):
            if all(part.grips_apart(a, b) for a, b in pairwise(grips)):
                for turns in product(TURNS, repeat=len(team)):
                    yield tuple(map(Hold, grips, turns))

    def meetings(
        self,
        robots: tuple[str, str],
        holds: tuple[Hold, Hold],
        having: tuple[Array, float],
    ) -> tuple[Meeting, ...]:
        """Return keyframes of a handover, earliest first.

        Args:
            robots: giver and taker.
            holds: how each of them holds the part.
            having: where the giver stands when it has the part, shape (n,), and from when on [s].
        """
        found = islice(self._meetings(robots, holds, having), self.settings.places)
        return tuple(sorted(found, key=lambda m: m.giver.earliest))

    def _meetings(
        self,
        robots: tuple[str, str],
        holds: tuple[Hold, Hold],
        having: tuple[Array, float],
    ) -> Iterator[Meeting]:
        """Yield candidate handovers of the part.

        The giver moves the part against the taker's pad, and then its own pad away.
        """
        (giver, taker), (here, picked) = robots, having
        scenes, problem = self.scenes, self.scenes.problem
        lift = min(problem.approach, _LIFT)
        before = scenes.handing(giver, taker, giver, holds[0])
        after = scenes.handing(giver, taker, taker, holds[1])
        standing = before.taker.start_configuration()
        for _ in range(self.settings.meetings):
            drawn = self.bounds.draw_meeting(robots, scenes.part, holds, self.rng)
            if drawn is None:
                continue
            (q_giver, q_taker), tools = drawn
            carried = max(
                before.giver.least_duration(here, q_giver),
                before.taker.least_duration(standing, q_taker),
            )
            soon = max(picked, before.taker.start) + carried
            if not before.free(q_giver, q_taker, self._drawn_time(soon)):
                continue
            motion = skill_motion(
                problem.cell.robot(giver),
                problem.frame,
                q_giver,
                (
                    -lift * tools[1][:3, 2],
                    -lift * tools[0][:3, 2],
                ),
                problem.cell.robot(giver).model.velocity,
                problem.seconds_of("handover", giver, scenes.part),
            )
            if motion is None or not (
                before.apart(motion.before, q_taker)
                and after.apart(motion.before, q_taker)
                and after.apart(motion.after, q_taker)
            ):
                continue
            windows = arrival_windows(
                [
                    (before.giver, motion.before),
                    (before.taker, q_taker),
                    (after.giver, motion.after),
                    (after.taker, q_taker),
                ],
                motion.seconds,
                soon,
                soon + self.settings.ahead_s,
            )
            if len(windows):
                yield Meeting(Keyframe(motion, windows), q_taker)

    def picks(self, robot: str, hold: Hold) -> tuple[Keyframe, ...]:
        """Return keyframes of the pick, earliest first."""
        scenes, part = self.scenes, self.scenes.part
        phase = (
            scenes.empty(robot, at_goal=False),
            scenes.held(robot, hold, at_goal=False),
        )
        start = scenes.problem.object(part).start
        found = self._skill_motions(
            "pick", robot, hold, start, phase, self.earliest_times.pick
        )
        picks = islice(found, self.settings.picks)
        return tuple(sorted(picks, key=lambda k: k.earliest))

    def places(self, robot: str, hold: Hold) -> tuple[Keyframe, ...]:
        """Return keyframes of the place, earliest first."""
        scenes, goal, earliest = self.scenes, self.scenes.part.goal, self.earliest_times
        phase = (
            scenes.held(robot, hold, at_goal=True),
            scenes.empty(robot, at_goal=True),
        )
        found = self._skill_motions(
            "place-down", robot, hold, goal, phase, earliest.place
        )
        places = islice(found, self.settings.places)
        cut = [
            Keyframe(k.motion, intersect_windows(k.windows, self._free_place))
            for k in sorted(places, key=lambda k: k.earliest)
        ]
        return tuple(k for k in cut if len(k.windows))

    @cached_property
    def _free_place(self) -> Array:
        """Return the time spans in which the part, in its place, is clear of all fixed motion."""
        checker, q = self.scenes.lying
        begin = max(self.earliest_times.place, checker.start)
        # It counts as lying there from the beginning of the skill that places it.
        return arrival_windows([(checker, q)], np.inf, begin)

    def _skill_motions(
        self,
        skill: str,
        robot: str,
        hold: Hold,
        at: Transform,
        phase: Phase,
        earliest: float,
    ) -> Iterator[Keyframe]:
        """Yield skill motions that touch the part at rest: along the tool axis, or into its place."""
        problem, part = self.scenes.problem, self.scenes.part
        placed = problem.cell.robot(robot)
        tool = problem.tool_pose(part, at, *hold)
        into = tool[:3, 2] if skill == "pick" else part.insertion
        alternatives = (problem.approach * into, -problem.approach * tool[:3, 2])
        seconds = problem.seconds_of(skill, robot, part)
        checker, velocity = phase[0], placed.model.velocity
        q_start = checker.start_configuration()
        sampler = self.bounds.sampler(robot)
        for _ in range(self.settings.draws):
            drawn = sampler.sample(tool, self.rng, self.settings.starts)
            drawn.sort(key=lambda q: checker.least_duration(q_start, q))
            for q in drawn:
                soon = checker.start + checker.least_duration(q_start, q)
                soon = max(soon, earliest)
                if not checker.configuration_free(q, self._drawn_time(soon)):
                    continue
                motion = skill_motion(
                    placed, problem.frame, q, alternatives, velocity, seconds
                )
                if motion is None:
                    continue
                windows = self._windows(motion, phase, soon)
                if len(windows):
                    yield Keyframe(motion, windows)

    def _drawn_time(self, soon: float) -> float:
        """Draw the time at which a configuration is tried first."""
        return soon + float(self.rng.uniform(0.0, self.settings.spread_s))

    def _windows(self, motion: SkillMotion, phase: Phase, earliest: float) -> Array:
        parts = [(phase[0], motion.before), (phase[1], motion.after)]
        latest = earliest + self.settings.ahead_s
        return arrival_windows(parts, motion.seconds, earliest, latest)


def feasible_holds(bounds: ReachBounds, robot: str, part: Part) -> list[Hold]:
    """Return the holds with which a robot can both pick and place a part."""
    grips = set(bounds.pick_grips(robot, part)) & set(bounds.place_grips(robot, part))
    return [Hold(grip, turn) for grip in sorted(grips) for turn in TURNS]


def intersect_windows(a: Array, b: Array) -> Array:
    """Return the intersection of two sets of time windows, shapes (w, 2) [s]."""
    out = [
        (max(lo, low), min(hi, high))
        for lo, hi in a.tolist()
        for low, high in b.tolist()
        if max(lo, low) <= min(hi, high)
    ]
    return np.array(sorted(out), dtype=np.float64).reshape(-1, 2)
