"""Construction sites: the workcell, and the problem of building a model of a structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.construction.problem.models import ModelPart
from planning.construction.problem.problem import ConstructionProblem, Part, face_grips
from planning.construction.problem.supply_layout import SupplyLayout, supply_poses
from planning.contacts.precedence import (
    build_part_graph,
    parts_stacked_on,
    with_insertions,
)
from planning.contacts.touching import TOUCH, standing_fixtures
from planning.errors import ConstructionError
from planning.transforms import Array, Transform, read_only_copy, translation

GROUND = "ground"
"""Name of the floor."""

_DEPTH = 0.2
"""Thickness of the ground [m]."""


def ground_fixture(edge: float = 30.0) -> Fixture:
    """Return a square floor whose top is at height zero.

    Args:
        edge: its length [m].
    """
    pose = read_only_copy(translation(0.0, 0.0, -_DEPTH / 2.0))
    return Fixture(GROUND, box_shape(GROUND, (edge, edge, _DEPTH)), pose)


def part_objects(
    parts: Sequence[ModelPart],
    layout: SupplyLayout,
    starts: Mapping[str, Transform] | None = None,
    *,
    near: bool = False,
) -> tuple[CellObject, ...]:
    """Return the parts of a model as objects in the supply.

    Args:
        parts: the model.
        layout: where parts lie.
        starts: poses of parts that lie elsewhere; the layout keeps no places for them.
        near: whether parts lie near their goals, see ``supply_poses``.
    """
    poses = dict(starts or {})
    others = [part for part in parts if part.name not in poses]
    poses |= supply_poses(others, layout, near=near)
    return tuple(
        CellObject(
            name=part.name,
            kind=" x ".join(f"{edge:.4g}" for edge in part.size),
            shape=box_shape(part.name, part.size),
            start=read_only_copy(poses[part.name]),
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

    All other values of the problem are the defaults of ConstructionProblem.

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
        insertion = read_only_copy(given.get(part.name, inwards))
        out.append(Part(part.name, read_only_copy(part.goal), grips, insertion))
    items = {part.name: (cell.object(part.name), part.goal) for part in parts}
    starts = {o.name: (o, o.start) for o in cell.objects if o.name in items}
    graph = build_part_graph(
        items,
        list(standing_fixtures(cell).values()),
        touch=touch,
        covers=parts_stacked_on(starts),
    )
    directions_by_part = {part.name: part.insertion for part in out}
    return ConstructionProblem(
        cell=cell,
        parts=tuple(out),
        graph=with_insertions(graph, items, directions_by_part, approach),
        approach=approach,
    )
