"""Collision checkers of one sub-problem: one per phase, each with its attached parts and allowed contacts."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from planning.cell.machine import immovable_model
from planning.cell.shape import Shape
from planning.cell.workcell import Attachment, PlacedRobot, WorldState
from planning.construction.checks.checker import SpaceTimeChecker, straight_runs
from planning.construction.problem.problem import ConstructionProblem, Hold, Part
from planning.construction.world.fixed_world import FixedWorld, with_part_at_rest
from planning.construction.world.timeline import RobotTimeline
from planning.geometry.robot_bodies import entity_name
from planning.handling.skill_contacts import grip_contact
from planning.joint_motion.moving_pairs import MovingPair
from planning.motion.sequential import MARGIN
from planning.steps.skill import Pairs
from planning.transforms import Array

_GHOST = "part in its place"


@dataclass(frozen=True)
class HandingScene:
    """Collision checkers of a handover: one for each robot, and one between the two robots.

    Attributes:
        giver: the check of the robot that gives the part, without the other one.
        taker: the check of the one that takes it, likewise.
        pair: checks them against each other.
    """

    giver: SpaceTimeChecker
    taker: SpaceTimeChecker
    pair: MovingPair

    def free(self, giver: Array, taker: Array, t: float) -> bool:
        """Tell whether both configurations are free, shapes (n,), at time ``t``."""
        return (
            self.giver.configuration_free(giver, t)
            and self.taker.configuration_free(taker, t)
            and self.pair.clear(giver, taker)
        )

    def apart(self, path: Array, taker: Array) -> bool:
        """Tell whether the giver's path is clear of the other robot, which stands."""
        return all(
            self.pair.split(a, b, taker, taker, 1) is not None
            for a, b in straight_runs(path)
        )


@dataclass(eq=False)
class StepScenes:
    """Checkers for one part among fixed timelines, created on first use.

    Attributes:
        problem: parts and team.
        world: everything that is fixed; who works on the part stands at the end of its
            timeline.
        part: the part.
        team: the robots that work on it.
    """

    problem: ConstructionProblem
    world: FixedWorld
    part: Part
    team: tuple[str, ...]
    _made: dict[tuple[object, ...], SpaceTimeChecker] = field(default_factory=dict)

    def empty(self, robot: str, *, at_goal: bool) -> SpaceTimeChecker:
        """Return the checker for an empty pad at the part: in the supply, or after release."""
        world = self._built if at_goal else self.world
        allowed = grip_contact(robot, self.part.name)
        return self._checker((robot, at_goal), world, robot, {}, allowed)

    @cached_property
    def _built(self) -> FixedWorld:
        """The world in which the part is in its place."""
        return with_part_at_rest(self.world, self.part.name, self.part.goal)

    def held(self, robot: str, hold: Hold, *, at_goal: bool) -> SpaceTimeChecker:
        """Return the checker for the held part as it is lifted from the supply, or put down."""
        problem = self.problem
        touched = problem.goal_contacts if at_goal else problem.start_contacts
        allowed = grip_contact(robot, self.part.name) | touched[self.part.name]
        held = self._attached(robot, hold)
        key = (robot, at_goal, hold)
        return self._checker(key, self.world, robot, held, allowed)

    def handing(self, giver: str, taker: str, holder: str, hold: Hold) -> HandingScene:
        """Return the checkers of two robots whose pads both touch the part.

        Args:
            giver, taker: the robots.
            holder: the one that holds the part.
            hold: how it does.
        """
        allowed = grip_contact(giver, self.part.name) | grip_contact(
            taker, self.part.name
        )
        held = self._attached(holder, hold)
        one, other = (
            self._checker(
                (robot, giver, taker, holder, hold),
                self.world,
                robot,
                held,
                allowed,
                # Robots that work on the part before or after will stand elsewhere.
                [other for other in self.team if other != robot],
            )
            for robot in (giver, taker)
        )
        state, cell = WorldState({}, held), self.world.cell
        pair = MovingPair(cell, giver, taker, state, allowed, margin=MARGIN)
        return HandingScene(one, other, pair)

    def _attached(self, robot: str, hold: Hold) -> dict[str, Attachment]:
        pose = self.problem.held_in_flange(robot, self.part, *hold)
        return {self.part.name: Attachment(robot, pose)}

    def _checker(
        self,
        key: tuple[object, ...],
        world: FixedWorld,
        robot: str,
        held: dict[str, Attachment],
        allowed: Pairs,
        without: Collection[str] = (),
    ) -> SpaceTimeChecker:
        if key not in self._made:
            self._made[key] = SpaceTimeChecker(
                world, robot, held=held, allowed=allowed, without=without
            )
        return self._made[key]

    @cached_property
    def lying(self) -> tuple[SpaceTimeChecker, np.ndarray]:
        """The checker of the part alone, in its place, and the configuration for it.

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
        near = {name for pair in self.problem.goal_contacts[own] for name in pair}
        touched = frozenset(
            frozenset((entity_name(_GHOST, "arm"), name)) for name in near | {own}
        )
        checker = SpaceTimeChecker(
            alone, _GHOST, held={}, allowed=touched, without=self.team
        )
        return checker, np.zeros((1, 1))


def _ghost(shape: Shape, part: Part) -> PlacedRobot:
    """Return a pseudo-robot that consists only of the part in its place."""
    model = immovable_model(_GHOST, shape.pieces)
    return PlacedRobot(_GHOST, model, part.goal, model.home)
