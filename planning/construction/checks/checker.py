"""Collision checks of a robot in space-time, against the planned motions of all robots and objects."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from planning.cell.workcell import Attachment, PlacedRobot, Workcell
from planning.construction.checks.moving_checks import (
    CHECKS,
    is_clear_throughout,
    is_configuration_clear,
    is_motion_clear,
)
from planning.construction.checks.scene import Limits, StillBoxes, make_scene
from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.fleet import make_loaded_robot
from planning.geometry.robot_bodies import (
    RobotBodies,
    cell_entities,
    limits_of_entities,
    objects_held_by,
)
from planning.geometry.standing import StandingBoxes, box_limits, stand_boxes
from planning.geometry.swept import SKIP
from planning.kinematics.kinematics import joint_poses_of
from planning.motion.sequential import MARGIN
from planning.steps.skill import Pairs
from planning.transforms import Array


class SpaceTimeChecker:
    """Continuous checks of one robot in space-time.

    All other robots follow their timelines, and so do objects. Motions that pass the checks can become nodes of a
    temporal plan graph with all its guarantees, see ``export_motion_plan``.

    Args:
        world: everything planned so far.
        robot: the moving robot, from the end of its timeline on.
        held: objects that it holds from then on, name to attachment; by default those of ``world``.
        allowed: unordered pairs of entities that may touch.
        without: names of robots that are not checked.

    Attributes:
        robot: the moving robot.
        start: start time of its motion [s].
        model: of the robot.
        home: configuration of HOME, shape (n,).
        scene: the same data for compiled code.
    """

    def __init__(
        self,
        world: FixedWorld,
        robot: str,
        *,
        held: Mapping[str, Attachment] | None = None,
        allowed: Pairs = frozenset(),
        without: Collection[str] = (),
    ) -> None:
        cell, placed = world.cell, world.cell.robot(robot)
        self.world = world
        self.robot = robot
        self.start = start = world.robots[robot].end
        self.model = placed.model
        self.home = placed.home
        if held is None:
            held = _held_by(world, robot, start)
        hand = objects_held_by(
            robot, ((cell.object(name), at) for name, at in held.items())
        )
        mover = make_loaded_robot(placed, hand)
        others = [
            (other, world.robots[other.name], world.hands_without(held)[other.name])
            for other in cell.robots
            if other.name not in (robot, *without)
        ]
        carriers, tracks = world.swept.joined(start, others, cell.object)
        # The scene holds no references to them, so this attribute keeps them alive.
        self._carriers = [mover, *carriers]
        numbers = cell_entities(cell)
        boxes, times = _still_boxes(world, held, start)
        self.scene = make_scene(
            self._carriers,
            numbers,
            tracks,
            StillBoxes(boxes.pose, boxes.half, boxes.bounds, *times, boxes.hulls),
            Limits(
                _box_limits(cell, placed, mover.bodies, boxes, allowed),
                limits_of_entities(
                    numbers, cell.clearances.robot_robot + MARGIN, allowed
                ),
                mover.bodies.limits_within(allowed),
            ),
            CHECKS,
        )

    def start_configuration(self) -> Array:
        """Return the configuration of the robot when it becomes free to move, shape (n,)."""
        return np.array(self.world.robots[self.robot].path[-1])

    def configuration_free(self, q: Array, t: float) -> bool:
        """Tell whether the robot may be at ``q``, shape (n,), at time ``t``."""
        return bool(is_configuration_clear(self.scene, _c(q), float(t)))

    def motion_free(self, q0: Array, t0: float, q1: Array, t1: float) -> bool:
        """Tell whether the whole straight motion from (q0, t0) to (q1, t1) is free.

        Speeds are not checked.
        """
        return bool(is_motion_clear(self.scene, _c(q0), float(t0), _c(q1), float(t1)))

    def skill_free(self, path: Array, start: float, end: float) -> bool:
        """Tell whether the whole path of a skill is free during a time span.

        Args:
            path: what the robot does, straight from waypoint to waypoint, shape (w, n); one
                waypoint where it stands still.
            start, end: the span [s].
        """
        return all(
            is_clear_throughout(self.scene, a, b, float(start), float(end))
            for a, b in straight_runs(path)
        )

    def least_duration(self, q0: Array, q1: Array) -> float:
        """Return the time that the slowest joint needs from ``q0`` to ``q1`` [s]."""
        return float(np.max(np.abs(_c(q1) - _c(q0)) / self.model.velocity))


def straight_runs(path: Array) -> list[tuple[Array, Array]]:
    """Return the ends of each straight motion of a path of shape (w, n); of a hold, the place twice."""
    path = _c(np.atleast_2d(path))
    return list(zip(path, path[1:] if len(path) > 1 else path, strict=False))


def _c(q: Array) -> Array:
    """Return a writable contiguous array: numba recompiles for read-only ones."""
    return np.array(q, dtype=np.float64)


def _held_by(world: FixedWorld, robot: str, t: float) -> dict[str, Attachment]:
    return {
        name: found
        for name, line in world.objects.items()
        if (found := line.at(t)) is not None and found.holder == robot
    }


def _still_boxes(
    world: FixedWorld, held: Collection[str], start: float
) -> tuple[StandingBoxes, tuple[Array, Array]]:
    """Return the boxes of fixtures and resting objects, and when each appears and disappears [s].

    Held objects, and those that are gone before the start, are excluded.
    """
    key = frozenset(held), start
    if key not in world.still_boxes:
        placed = [
            (pieces, rest)
            for pieces, rest in world.pieces_at_rest
            if rest.end > start and rest.object not in held
        ]
        boxes = stand_boxes(
            world.cell.fixtures, [p for pieces, _ in placed for p in pieces]
        )
        always = np.full(boxes.fixtures, np.inf)
        spans = [(rest.start, rest.end) for pieces, rest in placed for _ in pieces]
        come, go = np.array(spans).reshape(-1, 2).T
        times = np.append(-always, come), np.append(always, go)
        world.still_boxes[key] = boxes, times
    return world.still_boxes[key]


def _box_limits(
    cell: Workcell,
    robot: PlacedRobot,
    own: RobotBodies,
    boxes: StandingBoxes,
    allowed: Pairs,
) -> Array:
    """Return the least distances of a robot's bodies from boxes, SKIP for none, shape (o, b) [m]."""
    least = cell.clearances.robot_object + MARGIN
    limits = box_limits(own, boxes, allowed, least, least)
    bounds = boxes.bounds
    for o, (low, high) in _levels(robot, own).items():
        # It keeps its level: what is all below or above is never met.
        gap = np.maximum(bounds[:, 2] - high, low - bounds[:, 5])
        limits[o, gap >= least] = SKIP
    return limits


def _levels(robot: PlacedRobot, own: RobotBodies) -> dict[int, tuple[float, float]]:
    """Return the height ranges of bodies whose height no joint can change [m]."""
    chain, poses = robot.model.chain, joint_poses_of(robot, np.zeros(robot.model.dof))
    up = np.abs(np.einsum("ji,ji->j", poses[1:, 2, :3], chain.axis))
    keeps = np.where(chain.prismatic, up <= 1e-12, up >= 1.0 - 1e-12)
    out = {}
    for o, solid in enumerate(own.solids):
        if np.all(keeps[: solid.joint + 1]):
            z = solid.vertices @ poses[solid.joint + 1, 2, :3]
            z += poses[solid.joint + 1, 2, 3]
            out[o] = float(z.min()), float(z.max())
    return out
