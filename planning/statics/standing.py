"""Stability of parts at rest: by contact and friction, by joints, or because a robot holds them.

A part pushes on the parts that it touches (``contact_patch``). Friction keeps the force within a cone around the
contact normal. Joints, such as welds and screws, also bear other forces, and torques. A set of parts is stable if
forces exist that balance every weight; ``equilibrium`` is the linear program. The set must also be stable when
gravity is tilted slightly in each of four directions, so a part balanced on an edge does not count as stable.
Vertical gravity is a combination of the tilted directions. The forces combine likewise, so it needs no check.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from typing import Any

import networkx as nx
import numpy as np

from planning.cell.body import ConvexBody
from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.statics.contact_patch import ContactPatch, contact_patch
from planning.statics.equilibrium import (
    STANDARD_GRAVITY,
    ContactForce,
    Equilibrium,
    LoadCase,
    Vector,
)
from planning.statics.standing_rules import Joint, StandingRules
from planning.transforms import Array, Transform

_SIDES = 8
"""Edges of the pyramid that lies within a cone of friction."""

_AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

_State = tuple[
    frozenset[str], frozenset["Joint"], frozenset[str], frozenset[str] | None
]
"""What is there, joined and held, and what weighs."""

_DENSITY = 1000.0
"""Of a part whose mass is not given [kg/m^3]."""


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """A rigid body in its place.

    Attributes:
        name: unique among the bodies.
        pieces: convex bodies in its frame whose union it is.
        pose: of its frame in the world.
        mass: [kg].
        centre: its centre of mass in its frame, shape (3,) [m].
    """

    name: str
    pieces: tuple[ConvexBody, ...]
    pose: Transform
    mass: float
    centre: Array


def body_at(item: CellObject | Fixture, pose: Transform) -> PlacedBody:
    """Return a cell object as a body in its place."""
    shape = item.shape
    mass = item.mass if isinstance(item, CellObject) else 0.0
    return PlacedBody(
        item.name,
        shape.pieces,
        pose,
        mass or _DENSITY * shape.volume,
        shape.centre_of_mass,
    )


def ground_bodies(cell: Workcell, placed: Collection[str]) -> dict[str, PlacedBody]:
    """Return the immovable bodies: fixtures, and objects that are not placed."""
    ground = {item.name: body_at(item, item.pose) for item in cell.fixtures}
    return ground | {
        item.name: body_at(item, item.start)
        for item in cell.objects
        if item.name not in placed and not item.later
    }


class StabilityChecker:
    """Checks which sets of bodies are stable in their places.

    Args:
        bodies: everything that may be there, by name.
        ground: what never moves, by name.
        rules: friction, tilt, and what touches.
        patches: contacts by pair of names, where they are known: the second is a body, the first one or of the
            ground; by default those of the convex pieces.
    """

    def __init__(
        self,
        bodies: Mapping[str, PlacedBody],
        ground: Mapping[str, PlacedBody],
        rules: StandingRules | None = None,
        patches: Mapping[tuple[str, str], tuple[ContactPatch, ...]] | None = None,
    ) -> None:
        self.rules = rules or StandingRules()
        self.bodies = bodies
        self._ground = ground
        self._all = {**bodies, **ground}
        self._known: dict[_State, str | None] = {}
        self._boxes = {name: _boxes(body) for name, body in self._all.items()}
        self._given = patches
        self.patches = dict(patches or {})
        """Contacts by pair of names; the second is a body, the first one or of the ground."""
        self._between: dict[Joint, tuple[ContactPatch, ...]] = {}
        joints, room = list(self.rules.joints), self.rules.joined_within
        touch = self.rules.touch
        pairs = (
            ()
            if patches is not None
            else (*product(ground, bodies), *combinations(bodies, 2))
        )
        for pair in pairs:
            near = self._contacts(*pair, max(touch, room))
            if found := tuple(patch for patch in near if patch.gap <= touch):
                self.patches[pair] = found
            if any(patch.gap <= room for patch in near) and room:
                joints.append(Joint(*pair, gap=room))
        self.joints = tuple(joints)
        """Everything that is joined where all bodies are there."""

    def __reduce__(self) -> tuple[type[StabilityChecker], tuple[Any, ...]]:
        """Return the constructor arguments for another process; solvers and results stay here."""
        return StabilityChecker, (self.bodies, self._ground, self.rules, self._given)

    def touching(self) -> nx.Graph[str]:
        """Return which bodies touch each other in their places, without the ground."""
        graph: nx.Graph[str] = nx.Graph()
        graph.add_nodes_from(self.bodies)
        graph.add_edges_from(pair for pair in self.patches if pair[0] in self.bodies)
        return graph

    def touched_by(self, body: str) -> set[str]:
        """Return the bodies, ground included, that a body touches in its place."""
        pairs = (pair for pair in self.patches if body in pair)
        return {name for pair in pairs for name in pair} - {body}

    def why(self, body: str, present: Collection[str]) -> str:
        """Return in words why a body is not in equilibrium.

        Args:
            body: that falls.
            present: the bodies that are in their places; the ground always is.
        """
        solid = {*present, *self._ground}
        on = ", ".join(sorted(self.touched_by(body) & solid))
        words = f"no forces between it and {on} keep it in balance"
        return (
            f"{words if on else 'it touches nothing that is there'} (friction"
            f" {self.rules.friction:g}, gravity tilted by {math.degrees(self.rules.tilt):g}"
            " degrees)"
        )

    def falling(
        self,
        present: Collection[str],
        *,
        joints: Collection[Joint] = (),
        held: Collection[str] = (),
        weighing: Collection[str] | None = None,
    ) -> str | None:
        """Return the body farthest from equilibrium; None where all are stable.

        Args:
            present: the bodies that are in their places.
            joints: what is joined; joints of bodies that are not there do not count.
            held: bodies that robots hold: they move no more than the ground does.
            weighing: the bodies whose weight counts; all of them by default.
        """
        if not set(present) - set(held):
            return None
        weights = None if weighing is None else frozenset(weighing)
        key = frozenset(present), frozenset(joints), frozenset(held), weights
        if key not in self._known:
            solid = {*present, *self._ground}
            pushes = tuple(
                force
                for joint in joints
                if joint.first in solid and joint.second in solid
                for force in self._joint_forces(joint)
            )
            case = LoadCase(key[0], key[2], weights, pushes=pushes)
            self._known[key] = self._found(case)
        return self._known[key]

    def _found(self, case: LoadCase) -> str | None:
        for down in self._downs():
            tilted = replace(case, down=down)
            if self._program.bears(tilted) < 0.0:
                return self._program.least_pull(tilted).body
        return None

    @cached_property
    def _program(self) -> Equilibrium:
        """The program of all bodies in their places."""
        moving = {name: self.bodies[name] for name in sorted(self.bodies)}
        return Equilibrium(
            {name: _placed(body.centre, body.pose) for name, body in moving.items()},
            {name: body.mass * STANDARD_GRAVITY for name, body in moving.items()},
            [
                force
                for pair, patches in self.patches.items()
                for patch in patches
                for force in self._pushes(pair, patch)
            ],
        )

    def _pushes(
        self, pair: tuple[str, str], patch: ContactPatch
    ) -> Iterator[ContactForce]:
        """Yield the forces of a contact: at each of its corners, the edges of a friction cone."""
        across = np.linalg.svd(patch.normal[None, :])[2][1:]
        angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
        tangents = np.column_stack([np.cos(angles), np.sin(angles)]) @ across
        cone = patch.normal + self.rules.friction * tangents
        cone /= np.linalg.norm(cone, axis=1)[:, None]
        ends = self._ends(pair)
        for point, edge in product(patch.points.tolist(), cone.tolist()):
            yield ContactForce(*ends, tuple(point), tuple(edge))

    def _joint_forces(self, joint: Joint) -> Iterator[ContactForce]:
        """Yield the forces and torques of a joint."""
        ends = self._ends((joint.first, joint.second))
        x, y, z = self._middle(joint).tolist()
        for turns, limit in ((False, joint.force), (True, joint.torque)):
            for axis in _AXES:
                yield ContactForce(*ends, (x, y, z), axis, within=limit, turns=turns)

    def _ends(self, pair: tuple[str, str]) -> tuple[str | None, str | None]:
        """Return two names as the program has them, None for bodies of the ground."""
        first, second = (n if n in self.bodies else None for n in pair)
        return first, second

    def _downs(self) -> Iterator[tuple[float, float, float]]:
        """Yield the directions of gravity: tilted towards each side."""
        if self.rules.tilt == 0.0:
            yield 0.0, 0.0, -1.0
            return
        s, c = math.sin(self.rules.tilt), math.cos(self.rules.tilt)
        for x, y in ((s, 0.0), (0.0, s), (-s, 0.0), (0.0, -s)):
            yield x, y, -c

    def _contacts(
        self, first: str, second: str, touch: float
    ) -> tuple[ContactPatch, ...]:
        one, other = self._all[first], self._all[second]
        (low, high), (least, most) = self._boxes[first], self._boxes[second]
        near = np.all(low[:, None] <= most + touch, axis=2)
        near &= np.all(least <= high[:, None] + touch, axis=2)
        patches = (
            contact_patch(one.pieces[a], one.pose, other.pieces[b], other.pose)
            for a, b in np.argwhere(near).tolist()
        )
        return tuple(patch for patch in patches if patch.gap <= touch)

    def _middle(self, joint: Joint) -> Array:
        """Return the position of a joint: the middle of the contact, of the gap, or between the bodies."""
        pair = (joint.first, joint.second)
        patches = self.patches.get(pair) or self.patches.get(pair[::-1])
        if not patches and joint.gap > 0.0:
            if joint not in self._between:
                ends_at = pair if joint.second in self.bodies else pair[::-1]
                touch = self.rules.touch + joint.gap
                self._between[joint] = self._contacts(*ends_at, touch)
            patches = self._between[joint]
        if patches:
            return np.asarray(np.vstack([p.points for p in patches]).mean(axis=0))
        ends = [self._all[name] for name in pair]
        return np.asarray(np.mean([_placed(e.centre, e.pose) for e in ends], axis=0))


def _placed(point: Array, pose: Transform) -> Array:
    return np.asarray(pose[:3, :3] @ point + pose[:3, 3])


def _boxes(body: PlacedBody) -> tuple[Array, Array]:
    """Return the least and greatest coordinates of each piece in the world, shape (pieces, 3)."""
    turn, at = body.pose[:3, :3].T, body.pose[:3, 3]
    corners = [piece.vertices @ turn + at for piece in body.pieces]
    return (
        np.array([own.min(axis=0) for own in corners]),
        np.array([own.max(axis=0) for own in corners]),
    )
