"""Parts of an assembly in the order of their insertion; those that are alike are placed in one step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import networkx as nx

from planning.cad.part_types import PartType, Placed
from planning.disassembly.assembly_plan import (
    AssemblyPlan,
    InterlockedError,
    StraightInsertion,
    plan_assembly,
)
from planning.disassembly.body import AssemblyBody
from planning.disassembly.group_picture import draw_bodies
from planning.errors import RequestError, ShapeError
from planning.transforms import Transform

_CLEAR = 0.01
"""A part is led straight for so much more than until it is clear of others [m]."""

_SHORTEST, _LONGEST = 0.03, 1.0
"""Bounds of the lengths of straight insertions [m]."""

_DIRECTION_DIGITS = 6

Group = tuple[PartType, tuple[Placed, ...], tuple[float, float, float], float]
"""Parts that are placed in one step: their type, the bodies, the direction and the length of their insertion [m]."""


def ordered_groups(
    types: Sequence[PartType],
    base: Placed,
    turn: Transform,
    densities: Mapping[str, float],
    file: Path,
    picture: Path | None = None,
) -> list[Group]:
    """Return the parts in an order in which they can be put together.

    Args:
        types, base: the bodies, and the one that is there first.
        turn: rotation of the assembly after which z is up.
        densities: by body [kg/m^3].
        file: for messages.
        picture: folder for the picture of bodies that hold each other; None for none.

    Raises:
        RequestError: they cannot be put together one by one, by straight motions.
    """
    from trimesh import Trimesh

    kinds = {own.name: kind for kind in types for own in kind.placed}
    placed = {own.name: own for kind in types for own in kind.placed}
    bodies = [
        AssemblyBody(name, Trimesh(points, own.body.faces, process=False), dense)
        for name, own in placed.items()
        for points, dense in [(own.vertices @ turn[:3, :3].T, densities[name])]
    ]
    try:
        plan = plan_assembly(bodies, base.name)
    except InterlockedError as error:
        words = f"{file}: {error.message}"
        if picture is not None:
            words += f" (picture: {_draw(bodies, error, picture)})"
        raise RequestError(words) from None
    except ShapeError as error:
        raise RequestError(f"{file}: {error.message}") from None
    for step in plan.steps:
        if len(step.bodies) > 1:
            raise RequestError(
                f"{file}: {', '.join(step.bodies)} can only be put in as one, and parts are"
                " placed one by one: export them as one body"
            )
    low = {b.name: round(float(b.mesh.vertices[:, 2].min()), 4) for b in bodies}
    steps = {step.bodies[0]: step for step in plan.steps}
    return [
        (
            kinds[names[0]],
            tuple(placed[name] for name in names),
            _direction(steps[names[0]]),
            max(_insertion_length(steps[name]) for name in names),
        )
        for names in _groups(plan, kinds, densities, low)
    ]


def _draw(
    bodies: Sequence[AssemblyBody], error: InterlockedError, folder: Path
) -> Path:
    """Draw bodies that hold each other, and return the file."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "locked.png"
    file.write_bytes(draw_bodies(bodies, error.bodies))
    return file


def _direction(step: StraightInsertion) -> tuple[float, float, float]:
    x, y, z = (round(value, _DIRECTION_DIGITS) + 0.0 for value in step.direction)
    return x, y, z


def _insertion_length(step: StraightInsertion) -> float:
    """Return the length of the straight insertion of a part, in whole millimetres [m]."""
    length = math.ceil(1e3 * (step.distance_m + _CLEAR)) / 1e3
    return min(max(length, _SHORTEST), _LONGEST)


def _groups(
    plan: AssemblyPlan,
    kinds: Mapping[str, PartType],
    densities: Mapping[str, float],
    low: Mapping[str, float],
) -> list[tuple[str, ...]]:
    """Return the bodies that are placed in one step each, in an order of assembly.

    Bodies of a type are placed in one step, unless others have to be placed in between. Of what may come next, that
    comes which reaches lowest: what comes on top of it leaves less room for a hand.
    """
    before: nx.DiGraph[str] = nx.DiGraph()
    level: dict[str, int] = {}
    common: dict[str, tuple[object, ...]] = {}
    for step in plan.steps:
        (name,) = step.bodies
        before.add_node(name)
        level[name] = 1 + max((level[other] for other in step.after), default=0)
        common[name] = kinds[name].name, _direction(step), densities[name]
    before.add_edges_from((a, s.bodies[0]) for s in plan.steps for a in s.after)
    group = dict(common)
    # What waits for each other is split: by levels of the order first, then into single bodies.
    for finer in (lambda n: (*common[n], level[n]), lambda n: (*common[n], n)):
        while (mixed := _in_circle(before, group)) is not None:
            changed = {n: finer(n) for n, own in group.items() if own == mixed}
            if set(changed.values()) == {mixed}:
                break
            group |= changed
    members: dict[tuple[object, ...], list[str]] = {}
    for name, own in group.items():
        members.setdefault(own, []).append(name)
    number = {name: k for k, name in enumerate(group)}
    rank = {o: min((low[n], number[n]) for n in names) for o, names in members.items()}
    sequence = nx.lexicographical_topological_sort(
        _contracted(before, group), key=rank.__getitem__
    )
    return [tuple(members[own]) for own in sequence]


def _contracted(
    before: nx.DiGraph[str], group: Mapping[str, tuple[object, ...]]
) -> nx.DiGraph[tuple[object, ...]]:
    graph: nx.DiGraph[tuple[object, ...]] = nx.DiGraph()
    graph.add_nodes_from(group.values())
    pairs = ((group[a], group[b]) for a, b in before.edges)
    graph.add_edges_from((a, b) for a, b in pairs if a != b)
    return graph


def _in_circle(
    before: nx.DiGraph[str], group: Mapping[str, tuple[object, ...]]
) -> tuple[object, ...] | None:
    """Return the largest group that waits for another one which waits for it; None if there is none."""
    parts = nx.strongly_connected_components(_contracted(before, group))
    found = [own for part in parts if len(part) > 1 for own in part]
    members = list(group.values())
    return max(found, key=lambda own: (members.count(own), str(own)), default=None)
