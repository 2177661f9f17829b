"""Structures of bars that meet in nodes, by name: cube with a jib, towers, girder."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planning.transforms import Array


@dataclass(frozen=True, eq=False)
class Structure:
    """Bars between nodes, in an order in which each meets what is there before.

    Braces come before what would lie above them.

    Attributes:
        nodes: their places, shape (n, 3) [m].
        bars: pairs of node numbers.
        ground: nodes that stand on posts.
    """

    nodes: Array
    bars: tuple[tuple[int, int], ...]
    ground: frozenset[int]


def cube(edge: float = 0.24, jib: float = 0.16) -> Structure:
    """Return a cube on four posts, its faces braced, with two bars that carry a jib: 14 bars."""
    corners = _ring(4, edge / math.sqrt(2.0), 45.0)
    low = [(x, y, 0.0) for x, y in corners]
    high = [(x, y, edge) for x, y in corners]
    nodes = [*low, *high, (0.0, -0.5 * edge - jib, edge)]
    bars = [(k, k + 4) for k in range(4)]
    bars += [(k, 4 + (k + 1) % 4) for k in range(4)]
    bars += [(4 + k, 4 + (k + 1) % 4) for k in range(4)]
    bars += [(6, 8), (7, 8)]
    return Structure(np.array(nodes), tuple(bars), frozenset(range(4)))


def tower(
    sides: int, levels: int, radius: float = 0.13, height: float = 0.15
) -> Structure:
    """Return a braced tower that tapers: three bars for each side of each level.

    Args:
        sides: of its plan.
        levels: how many.
        radius: of its foot [m].
        height: of one level [m].
    """
    nodes = []
    # No corner is in the middle between the arms to the left and right.
    turned = 45.0 if sides == 4 else 0.0
    for level in range(levels + 1):
        shrunk = radius * (1.0 - 0.35 * level / levels)
        nodes += [(x, y, level * height) for x, y in _ring(sides, shrunk, turned)]
    bars = []
    for level in range(levels):
        low, high = level * sides, (level + 1) * sides
        bars += [(low + k, high + k) for k in range(sides)]
        bars += [(low + k, high + (k + 1) % sides) for k in range(sides)]
        bars += [(high + k, high + (k + 1) % sides) for k in range(sides)]
    return Structure(np.array(nodes), tuple(bars), frozenset(range(sides)))


def girder(bays: int = 3, bay: float = 0.2, depth: float = 0.2) -> Structure:
    """Return a girder with a triangle as its section, on posts at its lower nodes: 30 bars of three bays."""
    half = 0.5 * bays * bay
    nodes = []
    for k in range(bays + 1):
        x = k * bay - half
        nodes += [(x, -0.5 * depth, 0.0), (x, 0.5 * depth, 0.0), (x, 0.0, depth)]
    # What lies low is put there before anything stands above it; then from both ends inwards, so
    # that arms at either end work at the same time.
    frames = [(3 * k, 3 * k + 1, 3 * k + 2) for k in range(bays + 1)]
    inwards = sorted(range(bays + 1), key=lambda k: (min(k, bays - k), k))
    between = sorted(range(bays), key=lambda k: (min(k, bays - 1 - k), k))
    bars = [(frames[k][0], frames[k][1]) for k in inwards]
    for k in between:
        (a, b, _), (c, d, _) = frames[k : k + 2]
        bars += [(a, c), (b, d), (a, d)]
    for k in inwards:
        a, b, top = frames[k]
        bars += [(a, top), (b, top)]
    for k in between:
        (a, b, top), (_, _, other) = frames[k : k + 2]
        bars += [(top, other), (a, other), (b, other)]
    ground = frozenset(n for n in range(len(nodes)) if n % 3 != 2)
    return Structure(np.array(nodes), tuple(bars), ground)


STRUCTURES: dict[str, Callable[[], Structure]] = {
    "cube-14": cube,
    "tower-24": lambda: tower(4, 2),
    "girder-30": girder,
    "tower-45": lambda: tower(3, 5, height=0.13),
}


def _ring(count: int, radius: float, turned_deg: float) -> list[tuple[float, float]]:
    angles = np.radians(turned_deg + 360.0 * np.arange(count) / count)
    return [(radius * math.cos(a), radius * math.sin(a)) for a in angles]
