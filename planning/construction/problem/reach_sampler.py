"""Random inverse kinematics: configurations that bring the tool of a mobile robot to a pose.

A robot with a mobile base reaches a pose in infinitely many configurations. Arm configurations are sampled once for
every type of robot. For a target pose, a sample with nearly the same height and tilt of the tool is selected. The
base is placed so that the tool is at the target, and damped least squares refines the configuration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import islice

import numpy as np
from scipy.spatial import KDTree

from planning.cell.robot_model import RobotModel
from planning.cell.shape import box_shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.errors import RobotModelError
from planning.geometry.robot_bodies import entity_name
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.chain import joint_table
from planning.kinematics.damped_least_squares import solve_from
from planning.kinematics.kinematics import joint_poses_of
from planning.transforms import (
    Array,
    Transform,
    identity,
    inverse,
    read_only_copy,
    translation,
)

_SAMPLES = 3000
"""Free configurations in the table of a robot, at most."""

_DRAWS = 12_000
"""Random configurations that are looked at for them."""

_NEAREST = 48
"""Entries nearest to a wanted pose that the search starts from, at least."""

_LEAN = 0.5
"""A radian of the tool's direction weighs as much as that [m]."""

_STRAY = 1.5
"""Typical distance of a drawn base from the line between two places [m]."""

_UPRIGHT = 0.05
"""A tool whose z axis is as near to the vertical (a sine) says nothing of where its base stands."""

_PROBE = (0.3, 0.3, 0.1)
"""Size of what the robots of the drawn configurations hold [m]."""


@dataclass(frozen=True)
class _ArmTable:
    """Sampled configurations in which a robot could hold a part, mobile bases at zero.

    Attributes:
        q: shape (s, n).
        tool: poses of the tool in the robot's base frame, shape (s, 4, 4).
        tree: over their features.
        spin: direction in which the last joint turns the tool about its z axis, 0 if it does not.
    """

    q: Array
    tool: Array
    tree: KDTree
    spin: float


class ReachSampler:
    """Samples configurations of one robot for tool poses.

    Attributes:
        robot: whose configurations are drawn.
        frame: name of its tool frame.
        mobile: whether it drives.
    """

    def __init__(self, robot: PlacedRobot, frame: str = "tool") -> None:
        """Take a robot and the name of a tool frame.

        Raises:
            RobotModelError: the robot has no such frame, or cannot hold anything there.
        """
        self.robot = robot
        self.frame = frame
        self.mobile = robot.model.is_mobile
        self._tip = np.ascontiguousarray(robot.model.frame_in_last_joint(frame))
        self._table = _arm_table(robot.model, frame)
        self._to_base = inverse(robot.base)

    def sample(
        self, target: Transform, rng: np.random.Generator, count: int = 8
    ) -> list[Array]:
        """Return configurations that bring the tool to a pose.

        Args:
            target: wanted pose of the tool in the world.
            rng: what is drawn from.
            count: number of starts; each yields at most one configuration.

        Returns:
            Distinct configurations within the joint limits, each of shape (n,), in random order;
            empty when none was found. Collisions are not looked at, but for those of the robot
            with itself at the starts.
        """
        wanted = np.ascontiguousarray(self._to_base @ target)
        starts = self.seeds(wanted, rng, count)
        if not len(starts):
            return []
        model = self.robot.model
        found = np.empty_like(starts)
        solved = solve_from(
            joint_table(model),
            self._tip,
            wanted,
            starts[0],
            starts,
            found,
        )
        return [found[k].copy() for k in range(solved)]

    def draw(self, rng: np.random.Generator, between: tuple[Array, Array]) -> Array:
        """Return a configuration, shape (n,).

        Args:
            rng: what it is drawn from.
            between: two places in the world, shape (2,) [m], between which a mobile base stands,
                by and large.
        """
        q = np.array(self._table.q[int(rng.integers(len(self._table.q)))])
        if self.mobile:
            model, (a, b) = self.robot.model, between
            x, y = a + rng.random() * (b - a)
            spot = self._to_base @ np.array([x, y, 0.0, 1.0])
            q[:2] = spot[:2] + rng.normal(0.0, _STRAY, 2)
            q[2] = _within(rng.uniform(-np.pi, np.pi), model, 2)
            q[:3] = np.clip(q[:3], model.lower[:3], model.upper[:3])
        return q

    def seeds(self, wanted: Transform, rng: np.random.Generator, count: int) -> Array:
        """Return seeds for the inverse kinematics, near to solutions: shape (at most ``count``, n).

        Args:
            wanted: pose of the tool in the robot's base frame.
            rng: what is drawn from.
            count: how many are wanted.
        """
        table, model = self._table, self.robot.model
        among = min(max(_NEAREST, 2 * count), len(table.q))
        _, near = table.tree.query(_features(wanted[None], self.mobile)[0], k=among)
        chosen = rng.permutation(np.atleast_1d(near))[:count]
        q = table.q[chosen].copy()
        for row, tool in zip(q, table.tool[chosen], strict=True):
            if self.mobile:
                tool = self._drive(row, tool, wanted, rng)
            if table.spin:
                turn = _turn_about_z(tool, wanted)
                row[-1] = _within(row[-1] + table.spin * turn, model, -1)
        fits = np.all((q >= model.lower) & (q <= model.upper), axis=1)
        return np.ascontiguousarray(q[fits])

    def _drive(
        self, q: Array, tool: Transform, wanted: Transform, rng: np.random.Generator
    ) -> Transform:
        """Write the position of the base to ``q``; return the resulting tool pose."""
        if np.hypot(wanted[0, 2], wanted[1, 2]) < _UPRIGHT:
            yaw = rng.uniform(-np.pi, np.pi)
        else:
            yaw = np.arctan2(wanted[1, 2], wanted[0, 2])
            yaw -= np.arctan2(tool[1, 2], tool[0, 2])
        yaw = _within(yaw, self.robot.model, 2)
        c, s = np.cos(yaw), np.sin(yaw)
        turned = np.array(tool)
        turned[:2] = np.array(((c, -s), (s, c))) @ tool[:2]
        q[:2] = wanted[:2, 3] - turned[:2, 3]
        q[2] = yaw
        turned[:2, 3] = wanted[:2, 3]
        return turned


def _features(tool: Array, mobile: bool) -> Array:
    """Return the invariants of a tool pose under base motion, shape (s, f)."""
    if mobile:
        lean = np.arcsin(np.clip(tool[:, 2, 2], -1.0, 1.0))
        return np.column_stack([tool[:, 2, 3], _LEAN * lean])
    return np.column_stack([tool[:, :3, 3], _LEAN * tool[:, :3, 2]])


@cache
def _arm_table(model: RobotModel, frame: str) -> _ArmTable:
    alone = PlacedRobot("alone", model, identity(), model.home)
    checker = _with_probe(alone, frame)
    mobile = model.is_mobile
    rng = np.random.default_rng(11)
    drawn = rng.uniform(model.lower, model.upper, (_DRAWS, model.dof))
    if mobile:
        drawn[:, :3] = 0.0
    free = (row for row in drawn if checker.configuration_free(row))
    q = np.ascontiguousarray(list(islice(free, _SAMPLES)))
    if not len(q):
        raise RobotModelError(
            f"{model.name} cannot hold a part at its frame {frame!r}: the part would always "
            "be in its own way",
            choices=tuple(model.frames),
        )
    tip = np.ascontiguousarray(model.frame_in_last_joint(frame))
    tool = np.array([joint_poses_of(alone, row)[-1] @ tip for row in q])
    along = model.chain.axis[-1] @ tip[:3, 2]
    spin = float(np.sign(along)) if abs(along) > 1.0 - 1e-9 else 0.0
    return _ArmTable(q, tool, KDTree(_features(tool, mobile)), spin)


def _with_probe(robot: PlacedRobot, frame: str) -> SceneChecker:
    """Return a checker of a robot alone, holding an object as small as the parts."""
    tool = robot.model.frame_in_flange(frame)
    size = read_only_copy(_PROBE)
    pose = tool @ translation(0.0, 0.0, 0.5 * _PROBE[2])
    probe = CellObject("probe", "probe", box_shape("probe", size), pose)
    cell = Workcell((robot,), (), (probe,))
    held = WorldState({robot.name: robot.home}, {"probe": Attachment(robot.name, pose)})
    touching = frozenset({frozenset((entity_name(robot.name, "tool"), "probe"))})
    return SceneChecker(cell, robot.name, held, touching)


def _turn_about_z(tool: Transform, wanted: Transform) -> float:
    """Return the rotation about its own z axis that brings a tool nearest to a target orientation."""
    rest = tool[:3, :3].T @ wanted[:3, :3]
    return float(np.arctan2(rest[1, 0] - rest[0, 1], rest[0, 0] + rest[1, 1]))


def _within(angle: float, model: RobotModel, joint: int) -> float:
    """Return an angle plus whole turns, within limits if possible, else unchanged."""
    if model.chain.prismatic[joint]:
        return angle
    low, high = float(model.lower[joint]), float(model.upper[joint])
    turned = low + (angle - low) % (2.0 * np.pi)
    fits = np.arange(turned, high, 2.0 * np.pi)
    return float(fits[np.argmin(np.abs(fits))]) if len(fits) else turned
