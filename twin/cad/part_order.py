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
        types: of the bodies.
        base: the body that is there first.
        turn: rotation of the assembly after which z is up.
        densities: by body [kg/m^3].
        file: for messages.
        picture: folder for the picture of bodies that hold each other; None for none.

    Raises:
        RequestError: they cannot be put together one by one, by straight motions.
    """
    import trimesh

    placed = {own.name: (kind, own) for kind in types for own in kind.placed}
    bodies = [
        AssemblyBody(
            name,
            trimesh.Trimesh(
                own.vertices @ turn[:3, :3].T, own.body.faces, process=False
            ),
            densities[name],
        )
        for name, (_, own) in placed.items()
    ]
    try:
        plan = plan_assembly(bodies, base.name)
    except InterlockedError as error:
        shown = (
            "" if picture is None else f" (picture: {_draw(bodies, error, picture)})"
        )
        raise RequestError(f"{file}: {error.message}{shown}") from None
    except ShapeError as error:
        raise RequestError(f"{file}: {error.message}") from None
    for step in plan.steps:
        if len(step.bodies) > 1:
            raise RequestError(
                f"{file}: {', '.join(step.bodies)} can only be put in as one, and parts are"
                " placed one by one: export them as one body"
            )
    low = {b.name: round(float(b.mesh.vertices[:, 2].min()), 4) for b in bodies}
    kinds = {name: kind for name, (kind, _) in placed.items()}
    steps = {step.bodies[0]: step for step in plan.steps}
    return [
        (
            kinds[names[0]],
            tuple(placed[name][1] for name in names),
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
    order = [step.bodies[0] for step in plan.steps]
    before: nx.DiGraph[str] = nx.DiGraph()
    before.add_nodes_from(order)
    level: dict[str, int] = {}
    for step in plan.steps:
        name = step.bodies[0]
        before.add_edges_from((other, name) for other in step.after)
        level[name] = 1 + max((level[other] for other in step.after), default=0)
    common = {
        step.bodies[0]: (
            kinds[step.bodies[0]].name,
            _direction(step),
            densities[step.bodies[0]],
        )
        for step in plan.steps
    }
    group: dict[str, tuple[object, ...]] = dict(common)
    for finer in (lambda n: (*common[n], level[n]), lambda n: (*common[n], n)):
        while (mixed := _in_circle(before, group)) is not None:
            split = [name for name in order if group[name] == mixed]
            changed = {name: finer(name) for name in split}
            if all(changed[name] == group[name] for name in split):
                break
            group |= changed
    contracted = _contracted(before, group)
    rank = {
        own: min((low[n], k) for k, n in enumerate(order) if group[n] == own)
        for own in contracted
    }
    sequence = nx.lexicographical_topological_sort(contracted, key=rank.__getitem__)
    return [tuple(name for name in order if group[name] == own) for own in sequence]


def _contracted(
    before: nx.DiGraph[str], group: Mapping[str, tuple[object, ...]]
) -> nx.DiGraph[tuple[object, ...]]:
    graph: nx.DiGraph[tuple[object, ...]] = nx.DiGraph()
    graph.add_nodes_from(group.values())
    graph.add_edges_from(
        (group[a], group[b]) for a, b in before.edges if group[a] != group[b]
    )
    return graph


def _in_circle(
    before: nx.DiGraph[str], group: Mapping[str, tuple[object, ...]]
) -> tuple[object, ...] | None:
    """Return the largest group that waits for another one which waits for it; None if there is none."""
    graph = _contracted(before, group)
    circles = [
        part for part in nx.strongly_connected_components(graph) if len(part) > 1
    ]
    members = list(group.values())
    found = [own for part in circles for own in part]
    return max(found, key=lambda own: (members.count(own), str(own)), default=None)
