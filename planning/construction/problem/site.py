"""Sites of constructions: where the parts of a model lie before they are picked, as cell and problem.

Feasibility checks of a construction problem that need no search.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Fixture, Workcell, start_state
from planning.construction.problem.models import ModelPart
from planning.construction.problem.problem import ConstructionProblem, Part, face_grips
from planning.construction.problem.reach_bounds import (
    ReachBounds,
    reach_bounds,
    require_reach,
)
from planning.contacts.interference import Overlaps
from planning.contacts.precedence import build_part_graph, stacked, with_insertions
from planning.errors import ConstructionError, listed
from planning.geometry.scene_checker import SceneChecker
from planning.geometry.touching import NEAR, TOUCH, Lying, near_to, standing
from planning.transforms import Array, Transform, readonly, rotation, translation


@dataclass(frozen=True)
class Spiral:
    """Parts on a spiral around the site, the first ones innermost.

    The defaults are those of Hartmann et al.: part i lies at radius 3 + 0.05 i m and angle
    i / 2 rad.

    Attributes:
        radius: of the first part [m].
        growth: how much further out each next part lies [m].
        turn: angle from one part to the next; an even share of a full turn leaves straight
            lanes between the parts, from the outside to the site [rad].
        across: whether parts lie with their longer edge across the radius, not along it.
        high: parts of a stack, the first ones on top.
    """

    radius: float = 3.0
    growth: float = 0.05
    turn: float = 0.5
    across: bool = False
    high: int = 1

    def spots(self, count: int) -> list[Transform]:
        """Return a pose on the ground for each stack; x points away from the site's middle.

        Where they lie across the radius, y points towards it instead.
        """
        way = rotation("z", 0.5 * np.pi if self.across else 0.0)
        return [
            rotation("z", k * self.turn)
            @ translation(self.radius + k * self.growth, 0.0, 0.0)
            @ way
            for k in range(count)
        ]


@dataclass(frozen=True)
class Rows:
    """Parts in rows on one side of the site, the first ones nearest to it.

    Attributes:
        first: middle of the first row on the ground, x and y [m].
        columns: parts of a row.
        pitch: distance of parts in a row, and of rows [m].
        yaw: direction in which further rows lie [rad].
        high: parts of a stack, the first ones on top.
    """

    first: tuple[float, float]
    columns: int
    pitch: tuple[float, float]
    yaw: float = 0.0
    high: int = 1

    def spots(self, count: int) -> list[Transform]:
        """Return a pose on the ground for each stack; x points along ``yaw``."""
        frame = translation(self.first[0], self.first[1], 0.0) @ rotation("z", self.yaw)
        out = []
        for k in range(count):
            row, column = divmod(k, self.columns)
            side = (column - 0.5 * (self.columns - 1)) * self.pitch[0]
            out.append(frame @ translation(row * self.pitch[1], side, 0.0))
        return out


SupplyLayout = Spiral | Rows


def lay_out(
    parts: Sequence[ModelPart], layout: SupplyLayout, *, near: bool = False
) -> dict[str, Transform]:
    """Return the start pose of every part: flat, its first face up.

    Args:
        parts: the model.
        layout: the spots.
        near: whether every stack lies near the place where its parts belong, as far as others
            leave it room; by default they lie in their order.
    """
    stacks = [parts[k : k + layout.high] for k in range(0, len(parts), layout.high)]
    spots = layout.spots(len(stacks))
    if near and parts:
        spots = [spots[k] for k in _nearest(stacks, spots)]
    out: dict[str, Transform] = {}
    for stack, spot in zip(stacks, spots, strict=True):
        height = 0.0
        for part in reversed(stack):
            flat = lying(part)
            out[part.name] = readonly(spot @ translation(0.0, 0.0, height) @ flat)
            height += 2.0 * float(flat[2, 3])
    return out


def _nearest(
    stacks: Sequence[Sequence[ModelPart]], spots: Sequence[Transform]
) -> list[int]:
    """Return the spot of each stack: the least sum of squared distances to where parts belong."""
    at = np.array([spot[:2, 3] for spot in spots])
    to = np.array([np.mean([p.goal[:2, 3] for p in s], axis=0) for s in stacks])
    away = np.sum((to[:, None] - at[None]) ** 2, axis=2)
    chosen = linear_sum_assignment(away)[1]
    return [int(k) for k in chosen]


def lying(part: ModelPart) -> Transform:
    """Return the pose of a part that lies on the ground with its first face up.

    The longer edge of that face points along the x axis of its spot.
    """
    face = part.faces[0]
    up, sign = "xyz".index(face[1]), 1.0 if face[0] == "+" else -1.0
    along = max((k for k in range(3) if k != up), key=lambda k: float(part.size[k]))
    axes = np.zeros((3, 3))
    axes[along, 0], axes[up, 2] = 1.0, sign
    axes[:, 1] = np.cross(axes[:, 2], axes[:, 0])
    pose = translation(0.0, 0.0, 0.5 * float(part.size[up]))
    pose[:3, :3] = axes.T
    return pose


GROUND = "ground"
"""Name of the floor."""

_DEPTH = 0.2
"""Thickness of the ground [m]."""


def ground_fixture(edge: float = 30.0) -> Fixture:
    """Return a square floor whose top is at height zero.

    Args:
        edge: its length [m].
    """
    pose = readonly(translation(0.0, 0.0, -_DEPTH / 2.0))
    return Fixture(GROUND, box_shape(GROUND, (edge, edge, _DEPTH)), pose)


def part_objects(
    parts: Sequence[ModelPart],
    layout: SupplyLayout,
    starts: Mapping[str, Transform] | None = None,
    *,
    near: bool = False,
) -> tuple[CellObject, ...]:
    """Return the parts of a model as objects that lie in the supply.

    Args:
        parts: the model.
        layout: where parts lie.
        starts: poses of parts that lie elsewhere; they leave no gap in the layout.
        near: whether parts lie near where they belong, see ``lay_out``.
    """
    poses = dict(starts or {})
    others = [part for part in parts if part.name not in poses]
    poses |= lay_out(others, layout, near=near)
    return tuple(
        CellObject(
            name=part.name,
            kind=" x ".join(f"{edge:.4g}" for edge in part.size),
            shape=box_shape(part.name, part.size),
            start=readonly(poses[part.name]),
            mass=part.mass,
            colour=part.colour,
        )
        for part in parts
    )


def build_problem(
    cell: Workcell,
    parts: Sequence[ModelPart],
    *,
    offsets: Sequence[float] = (0.0,),
    insertions: Mapping[str, Array] | None = None,
    approach: float = 0.1,
    touch: float = TOUCH,
) -> ConstructionProblem:
    """Return the problem of building a model in a cell, by all of its robots.

    What else a problem says is as ConstructionProblem has it by default.

    Args:
        cell: its objects hold the parts, see ``part_objects``.
        parts: the model.
        offsets: places of pads along the longer edge of a face, see ``face_grips`` [m].
        insertions: directions in which parts reach their places, unit vectors, shape (3,); by
            default that of a pad on the first face.
        approach: see ConstructionProblem.
        touch: parts nearer to each other than this are connected [m].

    Raises:
        ConstructionError: two goal poses overlap, or no pad has a place on a part.
    """
    given = insertions or {}
    out = []
    for part in parts:
        grips = face_grips(part.size, part.faces, offsets)
        if not grips:
            size = " x ".join(f"{edge:.3g}" for edge in part.size)
            raise ConstructionError(
                f"no pad can touch {part.name}: all offsets ({', '.join(map(str, offsets))} m) lie "
                f"beyond the edges of its faces {', '.join(part.faces)}, of a box of {size} m",
                parts=[part.name],
            )
        inwards = part.goal[:3, :3] @ grips[0].touch[:3, 2]
        insertion = readonly(given.get(part.name, inwards))
        out.append(Part(part.name, readonly(part.goal), grips, insertion))
    items = {part.name: (cell.object(part.name), part.goal) for part in parts}
    starts = {o.name: (o, o.start) for o in cell.objects if o.name in items}
    graph = build_part_graph(
        items,
        list(standing(cell).values()),
        touch=touch,
        covers=stacked(starts),
    )
    ways = {part.name: part.insertion for part in out}
    return ConstructionProblem(
        cell=cell,
        parts=tuple(out),
        graph=with_insertions(graph, items, ways, approach),
        approach=approach,
    )


_CLEAR = 1e-4
"""Distance below which two boxes touch [m]."""


def require_buildable(problem: ConstructionProblem) -> ReachBounds:
    """Check what a lower bound can show to be impossible; return who reaches what.

    Goal poses that overlap are found where the part graph is built.

    Raises:
        ConstructionError: a part that nothing connects to the ground, parts that wait for each
            other, parts too near to each other for a part in hand, ways into a place that begin
            in a fixture, parts that overlap in the supply, robots that stand in something, or
            parts that the team cannot bring to their places.
    """
    require_grounded(problem)
    _require_order(problem)
    _require_room(problem)
    require_free_supply(problem)
    bounds = reach_bounds(problem)
    require_reach(bounds)
    _require_way_in(problem)
    return bounds


def require_grounded(problem: ConstructionProblem) -> None:
    """Check that every part stands on the ground, or on parts that do.

    Raises:
        ConstructionError: names the parts that hang in the air.
    """
    floating = problem.graph.floating()
    if floating:
        raise ConstructionError(
            f"nothing connects {listed(floating)} to the ground: every part must touch a fixture, or "
            "a part that is connected to one",
            parts=floating,
        )


def _require_order(problem: ConstructionProblem) -> None:
    """Check that the parts can be placed in some order, each when its turn comes, and all stand."""
    waiting = problem.graph.never_placeable(carried=problem.carried)
    if waiting:
        raise ConstructionError(
            f"{listed(waiting)} cannot be placed in any order: a part must touch the ground or a "
            "part in place, and what it rests on must be in place before; does one hang below "
            "another, or do they rest on each other in a circle?",
            parts=waiting,
        )
    if (falls := problem.balance.never_placeable()) is not None:
        body, why = falls
        raise ConstructionError(why, parts=[body])


def _require_room(problem: ConstructionProblem) -> None:
    """Check that a part in hand can come as near to others as its place is.

    What touches a part in its place is left out, up to NEAR: it may be touched.
    """
    cell, least = problem.cell, problem.cell.clearances.robot_object
    fixed = standing(cell)
    there: dict[str, Lying] = {}
    for part in problem.parts:
        lying = (problem.object(part), part.goal)
        for other, gap in near_to(lying, {**fixed, **there}, least).items():
            if NEAR < gap < least:
                raise ConstructionError(
                    f"{part.name} and {other} lie {gap * 1e3:.1f} mm apart where they belong, and "
                    f"a part in hand keeps {least * 1e3:.1f} mm from all that it does not touch: "
                    "make the joint wider, or the clearance of robots to objects smaller",
                    parts=[part.name],
                )
        there[part.name] = lying


def _require_way_in(problem: ConstructionProblem) -> None:
    """Check that a part is clear of all fixtures where its straight way into its place begins."""
    cell = problem.cell
    least = cell.clearances.robot_object + _CLEAR
    fixed = standing(cell)
    for part in problem.parts:
        before = translation(*(-problem.approach * part.insertion)) @ part.goal
        for other in near_to((problem.object(part), before), fixed, least):
            x, y, z = part.insertion
            raise ConstructionError(
                f"{part.name} goes into its place along ({x:.2f}, {y:.2f}, {z:.2f}), from "
                f"{problem.approach:.3g} m away, where it touches {other}: give it another "
                "insertion, or change approach_m",
                parts=[part.name],
            )


def require_free_supply(problem: ConstructionProblem) -> None:
    """Check that nothing overlaps at the start.

    Raises:
        ConstructionError: names the two things that do.
    """
    cell = problem.cell
    lying: dict[str, Lying] = {
        item.name: (item, item.start) for item in cell.objects if not item.later
    }
    fixed = standing(cell)
    before: dict[str, Lying] = {}
    for name, item in lying.items():
        deep = Overlaps().too_deep(name, item, {**fixed, **before})
        for other, depth in deep.items():
            raise ConstructionError(
                f"{name} and {other} overlap by {depth * 1e3:.3g} mm at the start: change "
                "the supply's layout",
                parts=[name],
                at_start=True,
            )
        before[name] = item
    for robot in cell.robots:
        contact = SceneChecker(
            cell, robot.name, start_state(cell), frozenset()
        ).contact(robot.home)
        if contact is not None:
            raise ConstructionError(
                f"{robot.name} cannot stand at HOME at the start: {contact}",
                parts=[name for name in (contact.obstacle,) if name in lying],
                at_start=True,
            )
