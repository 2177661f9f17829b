"""Collision checkers of one sub-problem, one per phase: what is held, and what may touch."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from planning.cell.machine import immovable
from planning.cell.shape import Shape
from planning.cell.workcell import Attachment, PlacedRobot
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.world.fixed_world import FixedWorld, lying_at
from planning.construction.world.timeline import RobotTimeline
from planning.geometry.robot_bodies import entity
from planning.steps.skill import Pairs, gripped

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
