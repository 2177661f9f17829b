"""Candidates for the next placement: parts by eq. (6), robots by eq. (7) of Hartmann et al., Sec. IV-D.

Every robot of a group holds the part exactly once (same paper, IV-D3 and V-A3). The order of the robots therefore
determines the skeleton, the sequence of actions: the first robot picks the part, each robot hands it over to the
next, and the last one places it and retracts.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from itertools import combinations, permutations

import numpy as np

from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.world.fixed_world import BuildState
from planning.kinematics.kinematics import frame_pose
from planning.transforms import Array

Skeleton = tuple[str, ...]
"""Robots in the order in which they have a part in hand."""

_ROOM = 1.0
"""Robots that place parts nearer to each other than this block each other [m]."""

_PACE = 0.8
"""Rough speed of fetching and bringing a part [m/s]."""

_ALIKE = 1.0
"""Parts that can be in place within this time of each other are equally good [s]."""

_FIRST = 3.0
"""Bonus of a part for every part stacked on it, as a delay [s]."""


def robot_groups(
    building: BuildState, team: tuple[str, ...], size: int
) -> list[tuple[str, ...]]:
    """Return the groups of robots of a given size, the earliest free first (eq. 7).

    Of groups whose last robot is free at the same time, such as a crane to which either of two arms
    hands a part, those come first whose others are free earlier.
    """
    free = {name: building.world.free_from(name) for name in team}
    return sorted(
        set(combinations(team, size)),
        key=lambda g: (
            sorted((free[r] for r in g), reverse=True),
            [team.index(r) for r in g],
        ),
    )


def skeletons(
    bounds: ReachBounds, building: BuildState, part: Part, most: int | None = None
) -> Iterator[Skeleton]:
    """Yield the skeletons that no lower bound rules out, in order of preference.

    More than two robots have a part in hand only where its place cannot be reached with fewer.

    Args:
        bounds: reachability of the parts.
        building: the state before.
        part: what is placed.
        most: robots that work on it together, one after another; as many as it takes, and at least
            two, where not given.
    """
    if most is None:
        most = max(2, len(bounds.chain(part) or ()))
    for size in range(1, most + 1):
        for group in robot_groups(building, bounds.problem.team, size):
            for robots in permutations(group):
                if bounds.may_bring(part, robots):
                    yield robots


def earliest_placement_time(
    problem: ConstructionProblem, part: str, placed: Mapping[str, float]
) -> float:
    """Return the earliest time at which a part may be placed [s].

    Args:
        problem: with the part graph.
        part: placeable.
        placed: end of the skill that placed each part, in the order of planning [s].
    """
    needed = problem.balance.ready(part, placed)
    return max((placed[p] for p in needed), default=0.0)


def rank_parts(
    problem: ConstructionProblem,
    placed: Mapping[str, float],
    closed: Mapping[str, Collection[frozenset[str]]],
    rng: np.random.Generator,
    free: float = np.inf,
    tool: Array | None = None,
) -> list[str]:
    """Return the parts that may be placed next, best first.

    Parts with most placed neighbours come first (eq. 6), of these the ones that can be in place earliest:
    supports placed late delay the parts on them, and distant parts take longer to fetch. Ties are broken at
    random. Where other robots are still at work when the next one becomes free, the earliest come before
    those with most neighbours, a part under a high stack before one under a low stack; and first of all
    parts away from working robots, since neighbours wait for each other. A single robot keeps to eq. (6).

    Args:
        problem: with the part graph.
        placed: end of the skill that placed each part [s].
        closed: part to sets of placed parts that keep it from its place for good. A part that
            would complete such a set before the other one is placed is left out.
        rng: what ties are drawn from.
        free: when the next robot becomes free [s].
        tool: where its tool is then, shape (3,); all parts lie as near where not given [m].
    """
    graph, there = problem.graph, frozenset(placed)
    candidates = [
        part
        for part in problem.balance.placeable(placed)
        if not any(
            wall <= there | {part}
            for other, walls in closed.items()
            if other not in there and other != part
            for wall in walls
        )
    ]
    drawn = dict(
        zip(candidates, rng.permutation(len(candidates)).tolist(), strict=True)
    )

    where = {part.name: part.goal[:3, 3] for part in problem.parts}
    busy = [where[part] for part, end in placed.items() if end > free]

    def rank(part: str) -> tuple[float, ...]:
        near = graph.placed_neighbours(part, there)
        away = (float(np.linalg.norm((where[part] - at)[:2])) for at in busy)
        crowd = sum(distance < _ROOM for distance in away)
        ready = earliest_placement_time(problem, part, placed)
        soon = ready
        if tool is not None:
            start = problem.object(problem.part(part)).start[:3, 3]
            distance = np.linalg.norm((start - tool)[:2])
            distance += np.linalg.norm((where[part] - start)[:2])
            soon = max(ready, free + float(distance) / _PACE)
        if busy and problem.carried:
            soon -= _FIRST * graph.piled_on[part]
        soon = np.floor(soon / _ALIKE)
        first = (soon, -near) if busy else (-near, soon)
        return (crowd, *first, ready, drawn[part])

    return sorted(candidates, key=rank)


def rank_next(
    problem: ConstructionProblem,
    building: BuildState,
    closed: Mapping[str, Collection[frozenset[str]]],
    rng: np.random.Generator,
) -> list[str]:
    """Return the parts that the earliest free robot may place next, see ``rank_parts``."""
    world = building.world
    robot = min(problem.team, key=world.free_from)
    free = world.free_from(robot)
    at = frame_pose(
        problem.cell.robot(robot), world.robots[robot].at(free), problem.frame
    )
    return rank_parts(problem, building.placed, closed, rng, free, at[:3, 3])
