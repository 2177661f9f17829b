"""The bodies that move with a robot, collected once for each load that it carries."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from planning.cell.body import ConvexBody
from planning.cell.compiled_robot import RobotKernel, robot_kernel
from planning.cell.workcell import Attachment, CellObject, PlacedRobot
from planning.geometry.exact import Solid, carried_solid
from planning.geometry.hull_table import HullTable, hull_table
from planning.geometry.proposals import SKIP
from planning.kept_answers import KeptAnswers
from planning.kinematics.kinematics import joint_poses_of
from planning.packed import packed
from planning.transforms import Array, Indices

Held = tuple[CellObject, Attachment]


@dataclass(frozen=True)
class RobotBodies:
    """What moves with a robot: its parts, then the objects it holds.

    Attributes:
        kernel: kinematics and capsules.
        solids: for exact decisions.
        entities: as allowed contacts name them, in the order of the bodies.
        first: capsules of body o are ``first[o]:first[o + 1]``.
        hulls: their corners, in one segment.
        self_limits: least distance between two of them, upper triangle, SKIP for none.
        parts: how many belong to the robot itself.
    """

    kernel: RobotKernel
    solids: tuple[Solid, ...]
    entities: tuple[str, ...]
    first: Indices
    hulls: HullTable
    self_limits: Array
    parts: int

    def of_entity(self, name: str) -> list[int]:
        """Return the bodies of an entity."""
        return [k for k, entity_name in enumerate(self.entities) if entity_name == name]


_KNOWN: KeptAnswers[RobotBodies] = KeptAnswers(4000)


def entity(robot: str, group: str) -> str:
    """Return the name by which allowed contacts speak of a robot's arm or tool."""
    return f"{robot}/{group}"


def robot_bodies(robot: PlacedRobot, held: Sequence[Held] = ()) -> RobotBodies:
    """Return what moves with a robot that holds some objects.

    Args:
        robot: the placed robot.
        held: objects in its hand, each with its pose in the flange frame.
    """
    key = (
        robot.model,
        robot.name,
        robot.base.tobytes(),
        *((item.name, item.body, at.pose.tobytes()) for item, at in held),
    )
    return _KNOWN.get(key, lambda: _collect(robot, held))


def robot_solids(robot: PlacedRobot, kernel: RobotKernel) -> list[Solid]:
    """Return the bodies of a robot, named ``"<robot>/<group>:<body>"``."""
    return [
        carried_solid(
            f"{entity(robot.name, part.group)}:{part.body.name}",
            part.body,
            kernel,
            part.joint,
            np.eye(4),
        )
        for part in robot.model.parts
    ]


def _collect(robot: PlacedRobot, held: Sequence[Held]) -> RobotBodies:
    if not held:
        return _bare(robot)
    bare = robot_bodies(robot)
    model = robot.model
    carried = [(item.body, at.pose) for item, at in held]
    kernel = robot_kernel(robot, carried)
    load = tuple(
        carried_solid(
            item.name, item.body, kernel, model.dof - 1, model.flange @ at.pose
        )
        for item, at in held
    )
    names = tuple(item.name for item, _ in held)
    return RobotBodies(
        kernel,
        bare.solids + load,
        bare.entities + names,
        first_of_bodies(kernel.body, bare.parts + len(load)),
        _append(bare.hulls, kernel, load, [body for body, _ in carried]),
        _self_limits(bare, len(load)),
        bare.parts,
    )


def _bare(robot: PlacedRobot) -> RobotBodies:
    model = robot.model
    kernel = robot_kernel(robot)
    solids = tuple(robot_solids(robot, kernel))
    count = len(solids)
    limits = np.full((count, count), SKIP)
    limits[np.triu_indices(count, 1)] = 0.0
    for i, j in model.never_collide:
        limits[i, j] = SKIP
    which = np.arange(count, dtype=np.int32)[None]
    n = model.dof
    bodies = [part.body for part in model.parts]
    return RobotBodies(
        kernel,
        solids,
        tuple(entity(robot.name, part.group) for part in model.parts),
        first_of_bodies(kernel.body, count),
        hull_table(kernel, np.zeros((1, n)), np.zeros((1, n)), which, solids, bodies),
        limits,
        count,
    )


def _self_limits(bare: RobotBodies, load: int) -> Array:
    """Return the limits with a load: parts are held apart from it, it not from itself."""
    count = bare.parts + load
    limits = np.full((count, count), SKIP)
    limits[: bare.parts, : bare.parts] = bare.self_limits
    limits[: bare.parts, bare.parts :] = 0.0
    return limits


def _append(
    bare: HullTable,
    kernel: RobotKernel,
    load: Sequence[Solid],
    bodies: Sequence[ConvexBody],
) -> HullTable:
    """Return a table of bodies with those of the load behind."""
    which = np.arange(len(load), dtype=np.int32)[None]
    more = hull_table(kernel, bare.q_a, bare.q_b, which, load, bodies)
    count = bare.solid.shape[1] + len(load)
    table = HullTable(
        kernel,
        bare.q_a,
        bare.q_b,
        np.arange(count, dtype=np.int32)[None],
        np.concatenate([bare.joint, more.joint]),
        np.concatenate(
            [bare.corner_first, bare.corner_first[-1] + more.corner_first[1:]]
        ),
        np.concatenate([bare.corners, more.corners]),
        np.concatenate(
            [bare.capsule_first, bare.capsule_first[-1] + more.capsule_first[1:]]
        ),
        np.concatenate([bare.ends, more.ends]),
        np.concatenate([bare.radius, more.radius]),
    )
    return packed(table)


def first_of_bodies(bodies: Indices, count: int) -> Indices:
    """Return where each body's capsules start in a sorted list of body indices."""
    return np.searchsorted(bodies, np.arange(count + 1)).astype(np.int64)


def flange_pose(robot: PlacedRobot, q: Array) -> Array:
    """Return the pose of a robot's flange in the world, shape (4, 4)."""
    return np.asarray(joint_poses_of(robot, q)[-1] @ robot.model.flange)


def held_by(
    robot: str, placed: Iterable[tuple[CellObject, Attachment | None]]
) -> list[Held]:
    """Return the objects that a robot holds."""
    return [(item, at) for item, at in placed if at is not None and at.holder == robot]
