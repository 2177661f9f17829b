"""May this robot be here, or move along there, in the cell as it stands at one instant?"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass

import numpy as np

from planning.geometry.body import ConvexBody
from planning.geometry.chain import joint_poses
from planning.geometry.exact import (
    Solid,
    carried_solid,
    come_close,
    come_close_together,
    distance_at,
    resting_solid,
)
from planning.geometry.hull_table import HullTable, hull_table
from planning.geometry.kernel import RobotKernel, robot_kernel
from planning.geometry.proposals import (
    BOX,
    SELF,
    SKIP,
    Integers,
    Scene,
    propose,
)
from planning.geometry.separation import make_scratch, not_proved_apart
from planning.geometry.swept import sweep_segments
from planning.transforms import Array
from planning.workcell import PlacedRobot, Workcell, WorldState

RESOLUTION = 0.02
"""Stretches of a motion that move no link further than this go to the exact decision [m]."""

_PROBE = 0.35
"""Joint travel (largest joint) between the configurations probed before a whole motion [rad]."""


@dataclass(frozen=True)
class Contact:
    """Two bodies that are too close.

    Attributes:
        first: the checked robot's body, as entity and body name.
        second: the other one.
        distance: signed distance, negative for penetration [m].
        limit: least distance that was asked for [m].
    """

    first: str
    second: str
    distance: float
    limit: float

    def __str__(self) -> str:
        """Describe the contact in one phrase."""
        how = (
            f"overlap by {-self.distance * 1e3:.1f} mm"
            if self.distance < 0
            else f"come within {self.distance * 1e3:.1f} mm"
        )
        return f"{self.first} and {self.second} {how}"


def entity(robot: str, group: str) -> str:
    """Return the name by which allowed contacts speak of a robot's arm or tool."""
    return f"{robot}/{group}"


class SceneChecker:
    """Collision checks of one robot against everything else, which stands still.

    Capsules propose; what hulls in motion are not proved apart, coal decides.

    Args:
        cell: the static cell.
        robot: name of the robot that is checked.
        state: configurations of the other robots, and where every object is; what the checked
            robot holds moves with it, and what has no place is not there yet.
        allowed: unordered pairs of entities that may touch.
        margin: added to the cell's clearances [m].
    """

    def __init__(
        self,
        cell: Workcell,
        robot: str,
        state: WorldState,
        allowed: frozenset[frozenset[str]] = frozenset(),
        *,
        margin: float = 0.0,
    ) -> None:
        self.robot = cell.robot(robot)
        self._allowed = allowed
        self._between_robots = cell.clearances.robot_robot + margin
        self._to_objects = cell.clearances.robot_object + margin
        held = [
            (item, state.attachments[item.name].pose)
            for item in cell.objects
            if item.name in state.attachments
            and state.attachments[item.name].holder == robot
        ]
        self.kernel = robot_kernel(
            self.robot, [(item.body, pose) for item, pose in held]
        )
        self._own = robot_solids(self.robot, self.kernel) + [
            carried_solid(
                item.name,
                item.body,
                self.kernel,
                self.robot.model.dof - 1,
                self.robot.model.flange @ pose,
            )
            for item, pose in held
        ]
        self._boxes: list[Solid] = []
        self._half: list[Array] = []
        self._others: list[Solid] = []
        bodies = self._stand(cell, state)
        self._scene = self._compile(cell, state)
        own = [part.body for part in self.robot.model.parts]
        own += [item.body for item, _ in held]
        self._moving = self._hulls(self._own, own)
        self._standing = self._hulls(self._boxes + self._others, bodies)
        self._scratch = make_scratch(self._moving, self._standing)

    def with_allowed(self, allowed: frozenset[frozenset[str]]) -> SceneChecker:
        """Return the same checker with other pairs that may touch; the two share their memory."""
        other = copy(self)
        other._allowed = allowed
        boxes, solids, own = other._limits()
        other._scene = self._scene._replace(
            box_limit=boxes, solid_limit=solids, self_limit=own
        )
        return other

    def _stand(self, cell: Workcell, state: WorldState) -> list[ConvexBody]:
        """Collect what stands around the robot, boxes first; return the bodies."""
        bodies = []
        for fixture in cell.fixtures:
            self._boxes.append(resting_solid(fixture.name, fixture.body, fixture.pose))
            self._half.append(0.5 * np.asarray(fixture.size))
            bodies.append(fixture.body)
        poses = {
            other.name: joint_poses_of(other, state.configurations[other.name])
            for other in cell.robots
            if other.name != self.robot.name
        }
        for item in cell.objects:
            attachment = state.attachments.get(item.name)
            if attachment is None or attachment.holder == self.robot.name:
                continue
            pose = attachment.pose
            if attachment.holder is not None:
                holder = cell.robot(attachment.holder)
                pose = poses[holder.name][-1] @ holder.model.flange @ pose
            self._boxes.append(resting_solid(item.name, item.body, pose))
            self._half.append(0.5 * np.asarray(item.size))
            bodies.append(item.body)
        for other in cell.robots:
            if other.name != self.robot.name:
                for part in other.model.parts:
                    name = f"{entity(other.name, part.group)}:{part.body.name}"
                    pose = poses[other.name][part.joint + 1]
                    self._others.append(resting_solid(name, part.body, pose))
                    bodies.append(part.body)
        return bodies

    def _hulls(self, solids: list[Solid], bodies: list[ConvexBody]) -> HullTable:
        n = self.robot.model.dof
        which = np.arange(len(solids), dtype=np.int32)[None]
        return hull_table(
            self.kernel, np.zeros((1, n)), np.zeros((1, n)), which, solids, bodies
        )

    def _compile(self, cell: Workcell, state: WorldState) -> Scene:
        """Flatten it, with the least distance of every pair."""
        self._fixtures = len(cell.fixtures)
        box_limit, solid_limit, self_limit = self._limits()
        start, end, radius, first = self._other_capsules(cell, state)
        return Scene(
            np.array([s.local for s in self._boxes]).reshape(-1, 4, 4),
            np.array(self._half).reshape(-1, 3),
            _box_bounds(self._boxes, self._half),
            box_limit,
            start,
            end,
            radius,
            first,
            _capsule_bounds(start, end, radius, first),
            solid_limit,
            self_limit,
            _ranges(self.kernel.body, len(self._own)),
        )

    def _limits(self) -> tuple[Array, Array, Array]:
        """Return the least distances to boxes, to other robots, and between own bodies."""
        own = len(self._own)
        parts = len(self.robot.model.parts)
        names = [solid.name.split(":")[0] for solid in self._own]
        boxes = _places(solid.name for solid in self._boxes)
        others = _places(solid.name.split(":")[0] for solid in self._others)
        box_limit = np.full((own, len(self._boxes)), self._to_objects)
        solid_limit = np.full((own, len(self._others)), self._between_robots)
        solid_limit[parts:] = self._to_objects
        for i, name in enumerate(names):
            touchable = self._touchable(name)
            for entity_name in touchable:
                box_limit[i, boxes.get(entity_name, [])] = SKIP
                solid_limit[i, others.get(entity_name, [])] = SKIP
            if i < parts and self.robot.model.parts[i].joint < 0:
                box_limit[i, : self._fixtures] = SKIP
        return box_limit, solid_limit, self._self_limits(names)

    def _touchable(self, name: str) -> set[str]:
        """Return the entities that an own entity may touch."""
        found: set[str] = set()
        for pair in self._allowed:
            if name in pair:
                found |= pair - {name}
        return found

    def _self_limits(self, names: list[str]) -> Array:
        own, parts = len(self._own), len(self.robot.model.parts)
        limits = np.full((own, own), SKIP)
        limits[:parts, :] = 0.0
        limits[np.tril_indices(own)] = SKIP
        for i, j in self.robot.model.never_collide:
            limits[i, j] = SKIP
        for i in range(parts):
            for j in range(parts, own):
                if frozenset((names[i], names[j])) in self._allowed:
                    limits[i, j] = SKIP
        return limits

    def _other_capsules(
        self, cell: Workcell, state: WorldState
    ) -> tuple[Array, Array, Array, Integers]:
        starts, ends = [np.empty((0, 3))], [np.empty((0, 3))]
        radii, bodies = [np.empty(0)], [np.empty(0, dtype=np.int64)]
        before = 0
        for other in cell.robots:
            if other.name == self.robot.name:
                continue
            kernel = robot_kernel(other)
            q = np.asarray(state.configurations[other.name], dtype=np.float64)
            start, end, radius = sweep_segments(kernel, q[None], q[None])
            starts.append(start[0])
            ends.append(end[0])
            radii.append(radius[0])
            bodies.append(kernel.body + before)
            before += len(other.model.parts)
        first = _ranges(np.concatenate(bodies), before)
        return (
            np.concatenate(starts),
            np.concatenate(ends),
            np.concatenate(radii),
            first,
        )

    def configuration_free(self, q: Array) -> bool:
        """Tell whether the robot may stand at ``q``, shape (n,)."""
        return self._clear(q, q)

    def motion_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether the whole straight joint-space line from ``q_a`` to ``q_b`` is free.

        Args:
            q_a, q_b: ends, shape (n,).
        """
        probes = int(np.max(np.abs(q_b - q_a)) / _PROBE) + 1
        for t in _spread(probes):
            q = q_a + t * (q_b - q_a)
            if not self._clear(q, q):
                return False
        return self._clear(q_a, q_b)

    def _clear(self, q_a: Array, q_b: Array) -> bool:
        when, what, count = self._propose(q_a, q_b)
        if count == 0:
            return True
        when, what = when[:count], what[:count]
        for i in self._undecided(q_a, q_b, when, what):
            q0 = q_a + when[i, 0] * (q_b - q_a)
            q1 = q_a + when[i, 1] * (q_b - q_a)
            kind, body, other = what[i]
            mine, limit = self._own[body], self._limit(kind, body, other)
            if kind == SELF:
                hit = come_close_together(mine, self._own[other], q0, q1, limit)
            else:
                solid = self._obstacle(kind, other)
                hit = come_close(mine, q0, q1, solid, q1, q1, limit)
            if hit:
                return False
        return True

    def _undecided(
        self, q_a: Array, q_b: Array, when: Array, what: Integers
    ) -> Integers:
        """Return the proposals that need the exact decision, those against others first."""
        scene = self._scene
        kind, body, other = what.T
        apart = np.flatnonzero(kind != SELF)
        boxes = kind[apart] == BOX
        limits = np.empty(len(apart))
        limits[boxes] = scene.box_limit[body[apart][boxes], other[apart][boxes]]
        limits[~boxes] = scene.solid_limit[body[apart][~boxes], other[apart][~boxes]]
        pairs = np.empty((len(apart), 2), dtype=np.int64)
        pairs[:, 0] = body[apart]
        pairs[:, 1] = other[apart] + np.where(boxes, 0, len(self._boxes))
        left = not_proved_apart(
            self._moving,
            self._standing,
            q_a,
            q_b,
            when[apart],
            pairs,
            limits,
            self._scratch,
        )
        return np.concatenate([apart[left], np.flatnonzero(kind == SELF)])

    def contact(self, q: Array) -> Contact | None:
        """Return the closest forbidden contact at ``q``, shape (n,), None where there is none."""
        _, what, count = self._propose(q, q)
        worst: Contact | None = None
        for kind, body, other in what[:count]:
            mine = self._own[body]
            limit = self._limit(kind, body, other)
            if kind == SELF:
                second, gap = (
                    self._own[other],
                    distance_at(mine, q, self._own[other], q),
                )
            else:
                second = self._obstacle(kind, other)
                gap = distance_at(mine, q, second, q)
            if gap < limit and (
                worst is None or gap - limit < worst.distance - worst.limit
            ):
                worst = Contact(mine.name, second.name, gap, limit)
        return worst

    def _propose(self, q_a: Array, q_b: Array) -> tuple[Array, Integers, int]:
        room = 512
        while True:
            when, what, count = propose(
                self.kernel, self._scene, q_a, q_b, RESOLUTION, room
            )
            if count >= 0:
                return when, what, count
            room *= 8

    def _limit(self, kind: int, body: int, other: int) -> float:
        scene = self._scene
        table = (scene.box_limit, scene.solid_limit, scene.self_limit)[kind]
        return float(table[body, other])

    def _obstacle(self, kind: int, other: int) -> Solid:
        return self._boxes[other] if kind == BOX else self._others[other]


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


def joint_poses_of(robot: PlacedRobot, q: Array) -> Array:
    """Return the world poses of a robot's base and joints at ``q``, shape (n + 1, 4, 4)."""
    chain = robot.model.chain
    poses = np.empty((len(q) + 1, 4, 4))
    joint_poses(
        chain.placement,
        chain.axis,
        chain.prismatic,
        robot.base,
        np.asarray(q, dtype=np.float64),
        poses,
    )
    return poses


def flange_pose(robot: PlacedRobot, q: Array) -> Array:
    """Return the pose of a robot's flange in the world, shape (4, 4)."""
    return np.asarray(joint_poses_of(robot, q)[-1] @ robot.model.flange)


def _ranges(bodies: Integers, count: int) -> Integers:
    """Return where each body's capsules start in a sorted list of body indices."""
    return np.searchsorted(bodies, np.arange(count + 1)).astype(np.int64)


def _places(names: Iterable[str]) -> dict[str, list[int]]:
    """Return at which places each name stands."""
    out: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        out.setdefault(name, []).append(k)
    return out


def _box_bounds(boxes: list[Solid], half: list[Array]) -> Array:
    pose = np.array([box.local for box in boxes]).reshape(-1, 4, 4)
    extent = np.array(half).reshape(-1, 3, 1)
    reach = (np.abs(pose[:, :3, :3]) @ extent)[:, :, 0]
    return np.hstack([pose[:, :3, 3] - reach, pose[:, :3, 3] + reach])


def _capsule_bounds(start: Array, end: Array, radius: Array, first: Integers) -> Array:
    low = np.minimum(start, end) - radius[:, None]
    high = np.maximum(start, end) + radius[:, None]
    return np.array(
        [
            np.concatenate([low[i:j].min(axis=0), high[i:j].max(axis=0)])
            for i, j in zip(first, first[1:], strict=False)
        ]
    ).reshape(-1, 6)


def _spread(count: int) -> list[float]:
    """Return ``count`` parameters in (0, 1], the end first and then ever finer in between."""
    out = [1.0]
    bits = max(count - 1, 0).bit_length()
    for i in range(1, 1 << bits):
        flipped = int(f"{i:0{bits}b}"[::-1], 2)
        out.append(flipped / (1 << bits))
    return out
