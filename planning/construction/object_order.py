"""Which part is placed next (Hartmann et al. IV-D1, V-A1, eq. 6)."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from planning.construction.problem import ConstructionProblem


def ready_at(
    problem: ConstructionProblem, part: str, placed: Mapping[str, float]
) -> float:
    """Return the time before which a part must not be placed [s].

    Args:
        problem: with the part graph.
        part: placeable.
        placed: end of the skill that placed each part [s].
    """
    graph = problem.graph
    carriers = [placed[p] for p in graph.carriers[part] if problem.carried]
    if carriers or part in graph.ground:
        return max(carriers, default=0.0)
    return min(placed[p] for p in graph.neighbours[part] if p in placed)


def rank_parts(
    problem: ConstructionProblem,
    placed: Mapping[str, float],
    closed: Mapping[str, Collection[frozenset[str]]],
    rng: np.random.Generator,
) -> list[str]:
    """Return the parts that may be placed next, the best first.

    Those with most placed neighbours come first (eq. 6), of these the ones that may be placed
    earliest; ties are drawn.

    Args:
        problem: with the part graph.
        placed: end of the skill that placed each part [s].
        closed: part to sets of placed parts that keep it from its place for good. A part that
            would complete such a set before the other one is placed is left out.
        rng: what ties are drawn from.
    """
    graph, there = problem.graph, frozenset(placed)
    candidates = [
        part
        for part in graph.placeable(there, carried=problem.carried)
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

    def rank(part: str) -> tuple[float, ...]:
        near = graph.placed_neighbours(part, there)
        return (-near, ready_at(problem, part, placed), drawn[part])

    return sorted(candidates, key=rank)
