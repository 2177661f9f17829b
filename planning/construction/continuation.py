"""Resuming a construction from an intermediate state: the remaining parts, one after another.

In that state all robots are at rest, in any configuration. Some parts are in their goal places. Robots may hold other
parts; they place these first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice

import numpy as np

from planning.cell.workcell import Attachment
from planning.construction.candidates import Skeleton, rank_next, skeletons
from planning.construction.held_parts import (
    plan_held_part,
    plan_securing_part,
    release_part,
    release_path,
)
from planning.construction.keyframes import TURNS
from planning.construction.problem.problem import ConstructionProblem, Hold, Part
from planning.construction.problem.reach_bounds import reach_bounds
from planning.construction.problem.settings import PlannerSettings
from planning.construction.subproblem import (
    Attempt,
    LegPlanner,
    Solution,
    SubproblemSolver,
)
from planning.construction.world.fixed_world import (
    BuildState,
    FixedWorld,
    HeldPlacement,
    with_part_at_rest,
)
from planning.construction.world.timeline import ObjectTimeline, RobotTimeline
from planning.handling.skill_contacts import NOTHING, grip_contact
from planning.transforms import Array

_ALWAYS = float("-inf")
_SAME = 1e-6
"""Configurations and poses that differ by less are the same."""

_EFFORTS = 2
"""Number of tries to hold a part that would fall, with rising effort."""

_TEAMS = 8
"""Teams that are tried for a part, before another one is."""


@dataclass(frozen=True)
class ConstructionResumePoint:
    """State from which a construction is resumed.

    Attributes:
        configurations: of all robots, by name.
        placed: parts that are in their places, in their order.
        held: parts in hands.
        kept: parts that would fall and are held in their places, by whom, and what has come by which
            they stand; nothing as long as nothing has, then the part is the last one that was placed.
    """

    configurations: Mapping[str, Array]
    placed: tuple[str, ...] = ()
    held: Mapping[str, Attachment] = field(default_factory=dict)
    kept: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    def building(self, problem: ConstructionProblem) -> BuildState:
        """Return the search state at the resume point."""
        robots = {
            name: RobotTimeline(name, np.zeros(1), q[None])
            for name, q in self.configurations.items()
        }
        world = FixedWorld(problem.cell, robots)
        for name in self.placed:
            world = with_part_at_rest(world, name, problem.part(name).goal)
        for name, at in self.held.items():
            line = ObjectTimeline(name).then(_ALWAYS, at.holder, at.pose)
            world = world.with_object(line)
        kept = {}
        for name, (robot, last) in self.kept.items():
            q = self.configurations[robot]
            path = release_path(problem, robot, q)
            kept[name] = HeldPlacement(robot, q[None] if path is None else path, last)
        return BuildState(world, placed=dict.fromkeys(self.placed, 0.0), kept=kept)


def plan_remaining_construction(
    problem: ConstructionProblem,
    middle: ConstructionResumePoint,
    effort: PlannerSettings,
) -> BuildState:
    """Return the state with every placeable part in place and every available robot at HOME.

    Args:
        problem: all parts that stand or are to.
        middle: where it is resumed.
        effort: of the search.
    """
    return _Rest(problem, middle, effort).building


class _Rest:
    """Greedy search over the remaining parts, without backtracking."""

    def __init__(
        self,
        problem: ConstructionProblem,
        middle: ConstructionResumePoint,
        effort: PlannerSettings,
    ) -> None:
        self.problem, self.effort = problem, effort
        self.solver = SubproblemSolver(reach_bounds(problem), effort.subproblem)
        self.rng = np.random.default_rng([problem.seed, 8, len(middle.placed)])
        self.holds = {
            name: (str(at.holder), hold)
            for name, at in middle.held.items()
            if (hold := self._hold_of(name, at)) is not None
        }
        self.busy = {str(at.holder): name for name, at in middle.held.items()}
        self.building = self._left(middle.building(problem))
        self.building = self._with_robots_home(self.building)
        while (after := self._next()) is not None:
            self.building = after

    def _hold_of(self, name: str, at: Attachment) -> Hold | None:
        """Return how a part is held; None for an object that is no part of the problem."""
        parts = {part.name: part for part in self.problem.parts}
        if name not in parts or at.holder not in self.problem.team:
            return None
        for grip in range(len(parts[name].grips)):
            for turn in TURNS:
                pose = self.problem.held_in_flange(at.holder, parts[name], grip, turn)
                if np.allclose(pose, at.pose, atol=_SAME):
                    return Hold(grip, turn)
        return None

    def _left(self, building: BuildState) -> BuildState:
        """Return the state in which robots have released parts that now stand; others keep theirs."""
        for name, keeping in building.kept.items():
            part, free = self.problem.part(name), keeping.robot in self.problem.team
            done = None
            if free and keeping.last:
                last = self.problem.part(keeping.last)
                done = release_part(self.solver, building, part, last)
            if done is None:
                self.busy[keeping.robot] = name
            building = done or building
        return building

    def _with_robots_home(self, building: BuildState) -> BuildState:
        """Return the state in which robots wait at HOME, with the parts they hold, until they have work."""
        legs = LegPlanner(self.effort.subproblem.rrt, self.rng, self.solver.watch)
        for name in self.problem.team:
            robot = self.problem.cell.robot(name)
            here, part = building.world.robots[name].path[-1], self.busy.get(name)
            if part in building.kept:
                continue  # it keeps holding that
            if np.abs(here - robot.home).max() > _SAME:
                allowed = NOTHING if part is None else grip_contact(name, part)
                leg = legs.leg(building, name, (), allowed=allowed, work=False)
                building = building if leg is None else leg.building
        return building

    def _next(self) -> BuildState | None:
        """Return the state with one more part in place, None where none can be placed."""
        names = self._ranked()
        kept = [k for k, own in self.building.kept.items() if not own.last]
        if kept:
            part, near = self.problem.part(kept[0]), self.problem.graph.neighbours
            others = [name for name in names if kept[0] in near[name]]
            about = (
                self.solver,
                self.building,
                part,
                others,
                self._teams,
                self._holds_by_part,
            )
            alternatives = (
                plan_securing_part(*about, effort) for effort in range(_EFFORTS)
            )
            return self._done(next(filter(None, alternatives), None))
        for low, effort in ((True, 0), (False, 0), (False, 1)):
            for name in names:
                part = self.problem.part(name)
                teams = self._teams(self.building, part)
                for k, robots in enumerate(islice(teams, _TEAMS)):
                    seed = [self.problem.seed, 9, self.building.step, k, effort, low]
                    hold = self._holds_by_part.get(name)
                    tried = Attempt(part, robots, seed, effort, low, hold=hold)
                    done = self.solver.solve(self.building, tried)
                    if done is not None:
                        return self._done(done)
        team = self.solver, self.building, self._teams, self._holds_by_part
        alternatives = (plan_held_part(*team, effort) for effort in range(_EFFORTS))
        return self._done(next(filter(None, alternatives), None))

    def _done(self, found: Solution | None) -> BuildState | None:
        """Return the state after a solution; robots whose part is in its place have a free hand."""
        if found is None:
            return None
        after, before = found.building, self.building.kept
        stays = {k for k in before if not np.isfinite(after.kept[k].end)}
        there = after.placed.keys() - stays
        self.busy = {r: p for r, p in self.busy.items() if p not in there}
        return after

    @property
    def _holds_by_part(self) -> dict[str, Hold]:
        """Return the holds of the parts that robots have in their hands."""
        return {name: hold for name, (_, hold) in self.holds.items()}

    def _teams(self, building: BuildState, part: Part) -> Iterator[Skeleton]:
        """Yield the robots that may place a part: one that already holds it continues with it."""
        if part.name in self.busy.values() and part.name not in self.holds:
            return
        holder, _ = self.holds.get(part.name, (None, None))
        teams = skeletons(self.solver.bounds, building, part)
        if holder is not None:
            others = (name for name in self.problem.team if name != holder)
            teams = chain([(holder,)], ((holder, other) for other in others))
        busy = self.busy.keys() - {holder}
        yield from (robots for robots in teams if busy.isdisjoint(robots))

    def _ranked(self) -> Sequence[str]:
        """Return the parts that may be placed next: those in hands first, then the best."""
        if not self.problem.team:
            return ()
        ranked = rank_next(self.problem, self.building, {}, self.rng)
        return sorted(ranked, key=lambda name: name not in self.holds)
