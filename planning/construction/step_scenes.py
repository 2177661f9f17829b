"""Collision checkers of one sub-problem, one per phase: what is held, and what may touch.

Ranking of the parts that can be placed next (Hartmann et al. IV-D1, V-A1, eq. 6).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from planning.cell.shape import Shape
from planning.cell.workcell import Attachment, PlacedRobot, immovable
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.world.fixed_world import FixedWorld, lying_at
from planning.construction.world.timeline import RobotTimeline
from planning.geometry.robot_bodies import entity
from planning.steps.skill import Pairs, gripped
from planning.transforms import Array

_GHOST = "part in its place"


class Hold(NamedTuple):
    """A hold on a part: grip and turn of the tool.

    Attributes:
        grip: number of the grip.
        turn: of the tool about its z axis [rad].
    """

    grip: int
    turn: float


@dataclass(eq=False)
class StepScenes:
    """Checkers for one part among fixed timelines, made when they are first asked for.

    Attributes:
        problem: parts and team.
        world: everything that is fixed; who works on the part stands at the end of its
            timeline.
        part: the part.
        team: who works on it.
    """

    problem: ConstructionProblem
    world: FixedWorld
    part: Part
    team: tuple[str, ...]
    _made: dict[tuple[object, ...], SpaceTimeChecker] = field(default_factory=dict)

    def empty(self, robot: str, *, at_goal: bool) -> SpaceTimeChecker:
        """Return the check of a pad at the part: in the supply, or as it leaves it in its place."""
        world = self.world
        if at_goal:
            world = lying_at(world, self.part.name, self.part.goal)
        allowed = gripped(robot, self.part.name)
        return self._checker((robot, at_goal), world, (robot,), {}, allowed)

    def held(self, robot: str, hold: Hold, *, at_goal: bool) -> SpaceTimeChecker:
        """Return the check of the part as it is lifted from the supply, or put down."""
        problem = self.problem
        touched = problem.goal_contacts if at_goal else problem.start_contacts
        allowed = gripped(robot, self.part.name) | touched[self.part.name]
        held = self._attached(robot, hold)
        key = (robot, at_goal, hold)
        return self._checker(key, self.world, (robot,), held, allowed)

    def handing(
        self, giver: str, taker: str, holder: str, hold: Hold
    ) -> SpaceTimeChecker:
        """Return the check of two robots at once, one of which holds the part.

        Args:
            giver, taker: whose pads both touch the part; configurations in this order.
            holder: one of them.
            hold: how that one holds it.
        """
        robots = giver, taker
        allowed = gripped(giver, self.part.name) | gripped(taker, self.part.name)
        held = self._attached(holder, hold)
        key = (giver, taker, holder, hold)
        return self._checker(key, self.world, robots, held, allowed)

    def _attached(self, robot: str, hold: Hold) -> dict[str, Attachment]:
        pose = self.problem.held_in_flange(robot, self.part, *hold)
        return {self.part.name: Attachment(robot, pose)}

    def _checker(
        self,
        key: tuple[object, ...],
        world: FixedWorld,
        robots: tuple[str, ...],
        held: dict[str, Attachment],
        allowed: Pairs,
    ) -> SpaceTimeChecker:
        if key not in self._made:
            checker = SpaceTimeChecker(world, robots, held=held, allowed=allowed)
            self._made[key] = checker
        return self._made[key]

    @cached_property
    def lying(self) -> tuple[SpaceTimeChecker, np.ndarray]:
        """The check of the part alone, lying in its place, and the configuration for it.

        What has been planned for later must not run into it. Whoever works on the part is
        left out.
        """
        world, item = self.world, self.problem.object(self.part)
        ghost = _ghost(item.shape, self.part)
        cell = replace(world.cell, robots=(*world.cell.robots, ghost))
        begin = min(world.robots[name].end for name in self.team)
        line = RobotTimeline(_GHOST, np.array([begin]), np.zeros((1, 1)))
        robots = {**world.robots, _GHOST: line}
        alone = FixedWorld(cell, robots, world.objects, world.swept)
        own = self.part.name
        touched = {
            frozenset((f"{_GHOST}/arm", *(pair - {own})))
            for pair in self.problem.goal_contacts[self.part.name]
        }
        spared = [own] + [entity(r, g) for r in self.team for g in ("arm", "tool")]
        touched |= {frozenset((f"{_GHOST}/arm", name)) for name in spared}
        checker = SpaceTimeChecker(
            alone, (_GHOST,), held={}, allowed=frozenset(touched)
        )
        return checker, np.zeros((1, 1))


def _ghost(shape: Shape, part: Part) -> PlacedRobot:
    """Return a robot that is nothing but the part in its place."""
    model = immovable(_GHOST, shape.pieces)
    return PlacedRobot(_GHOST, model, part.goal, model.home)


ROOM = 1.0
"""Robots that place parts nearer to each other than this are in each other's way [m]."""

_PACE = 0.8
"""Rough speed of fetching and bringing a part [m/s]."""

_ALIKE = 1.0
"""Parts that can be in place within this time of each other are equally good [s]."""

_FIRST = 3.0
"""So much later a part may come for every part that must follow it, one on the other [s]."""


def ready_at(
    problem: ConstructionProblem, part: str, placed: Mapping[str, float]
) -> float:
    """Return the time before which a part must not be placed [s].

    Args:
        problem: with the part graph.
        part: placeable.
        placed: end of the skill that placed each part [s].
    """
    graph = problem.graph
    carriers = [placed[p] for p in graph.carriers[part] if problem.carried]
    if carriers or part in graph.ground:
        return max(carriers, default=0.0)
    return min(placed[p] for p in graph.neighbours[part] if p in placed)


def rank_parts(
    problem: ConstructionProblem,
    placed: Mapping[str, float],
    closed: Mapping[str, Collection[frozenset[str]]],
    rng: np.random.Generator,
    free: float = np.inf,
    tool: Array | None = None,
) -> list[str]:
    """Return the parts that may be placed next, the best first.

    Those with most placed neighbours come first (eq. 6), of these the ones that can be in place
    soonest: what rests on a part that is placed late has to wait, and what lies far away takes
    its time to be fetched. Ties are drawn. Where others are still at work when the next robot
    becomes free, the soonest come before those with most neighbours, a part with a high pile to
    come on it before one with a low pile; and before all that parts beside which nobody works:
    robots that build side by side wait for each other. One robot alone keeps to eq. (6).

    Args:
        problem: with the part graph.
        placed: end of the skill that placed each part [s].
        closed: part to sets of placed parts that keep it from its place for good. A part that
            would complete such a set before the other one is placed is left out.
        rng: what ties are drawn from.
        free: when the next robot becomes free [s].
        tool: where its tool is then, shape (3,); all parts lie as near where not given [m].
    """
    graph, there = problem.graph, frozenset(placed)
    candidates = [
        part
        for part in graph.placeable(there, carried=problem.carried)
        if not any(
            wall <= there | {part}
            for other, walls in closed.items()
            if other not in there and other != part
            for wall in walls
        )
    ]
    drawn = dict(
        zip(candidates, rng.permutation(len(candidates)).tolist(), strict=True)
    )

    where = {part.name: part.goal[:3, 3] for part in problem.parts}
    busy = [where[part] for part, end in placed.items() if end > free]

    def rank(part: str) -> tuple[float, ...]:
        near = graph.placed_neighbours(part, there)
        away = (float(np.linalg.norm((where[part] - at)[:2])) for at in busy)
        crowd = sum(distance < ROOM for distance in away)
        ready = ready_at(problem, part, placed)
        soon = ready
        if tool is not None:
            start = problem.object(problem.part(part)).start[:3, 3]
            way = np.linalg.norm((start - tool)[:2])
            way += np.linalg.norm((where[part] - start)[:2])
            soon = max(ready, free + float(way) / _PACE)
        if busy and problem.carried:
            soon -= _FIRST * graph.piled_on[part]
        soon = np.floor(soon / _ALIKE)
        first = (soon, -near) if busy else (-near, soon)
        return (crowd, *first, ready, drawn[part])

    return sorted(candidates, key=rank)
