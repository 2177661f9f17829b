"""Bodies of unit cubes, and a slow check of their straight motions that shares no code with the planner."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain, combinations, permutations

import numpy as np
import trimesh

from planning.disassembly.assembly_plan import AssemblyPlan
from planning.disassembly.body import AssemblyBody

Cell = tuple[int, int, int]
Cells = frozenset[Cell]

SIDE = 0.01
"""Side of a cube [m]."""

SLACK = 1.2e-3
"""By how much cubes are smaller than that on each side, as a share: 12 micrometres."""

AXES = [tuple(s * (k == n) for k in range(3)) for n in range(3) for s in (1.0, -1.0)]


def voxel_body(name: str, cells: Iterable[Cell]) -> AssemblyBody:
    """Return a body of cubes: the squares between it and what is outside of it."""
    own = set(cells)
    corners: list[list[int]] = []
    faces: list[tuple[int, int, int]] = []
    for cell in sorted(own):
        for axis in range(3):
            for sign in (1, -1):
                other = list(cell)
                other[axis] += sign
                if tuple(other) in own:
                    continue
                u, v = (axis + 1) % 3, (axis + 2) % 3
                square = []
                for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    corner = list(cell)
                    corner[axis] += sign > 0
                    corner[u] += a
                    corner[v] += b
                    square.append(corner)
                k = len(corners)
                corners += square if sign > 0 else square[::-1]
                faces += [(k, k + 1, k + 2), (k, k + 2, k + 3)]
    return AssemblyBody(name, trimesh.Trimesh(SIDE * np.array(corners), faces))


def grown_bodies(seed: int, shape: Cell, count: int) -> dict[str, Cells]:
    """Return a block of cubes, cut at random into bodies that wind around each other like snakes."""
    rng = np.random.default_rng(seed)
    cells = [(int(x), int(y), int(z)) for x, y, z in np.ndindex(*shape)]
    seeds = rng.choice(len(cells), count, replace=False).tolist()
    owner = {cells[k]: n for n, k in enumerate(seeds)}
    tips = {n: cell for cell, n in owner.items()}

    def around(cell: Cell) -> list[Cell]:
        near = (tuple(int(c + x) for c, x in zip(cell, a, strict=True)) for a in AXES)
        return [c for c in near if c in cells and c not in owner]

    while len(owner) < len(cells):
        free = [(cell, n) for cell, n in owner.items() if around(cell)]
        ahead = [(cell, n) for cell, n in free if cell == tips[n]]
        pool = ahead if ahead and rng.random() < 0.9 else free
        cell, n = pool[rng.integers(len(pool))]
        room = around(cell)
        tips[n] = room[rng.integers(len(room))]
        owner[tips[n]] = n
    return {
        f"b{k}": frozenset(c for c, own in owner.items() if own == k)
        for k in range(count)
    }


def meets(moved: Cells, others: Cells, direction: Sequence[float]) -> bool:
    """Return whether cubes meet others on their straight motion, however far: slabs of time for each axis."""
    size = 1.0 - 2.0 * SLACK
    for a in moved:
        for b in others:
            first, last = 0.0, np.inf
            for x in range(3):
                gap, speed = b[x] - a[x], direction[x]
                if abs(speed) < 1e-12:
                    if abs(gap) >= size:
                        last = -1.0
                    continue
                times = sorted(((gap - size) / speed, (gap + size) / speed))
                first, last = max(first, times[0]), min(last, times[1])
            if first < last:
                return True
    return False


def splits(cells: Mapping[str, Cells], names: Collection[str]) -> bool:
    """Return whether some bodies of a group can be moved out of the others along an axis."""
    ordered = sorted(names)
    for count in range(1, len(ordered)):
        for group in combinations(ordered, count):
            moved = frozenset(chain.from_iterable(cells[n] for n in group))
            rest = frozenset(
                chain.from_iterable(cells[n] for n in set(names) - {*group})
            )
            if any(not meets(moved, rest, axis) for axis in AXES):
                return True
    return False


def locked_groups(cells: Mapping[str, Cells]) -> Iterator[tuple[str, ...]]:
    """Yield all groups of bodies that motions along axes do not take apart."""
    for count in range(2, len(cells) + 1):
        for group in combinations(sorted(cells), count):
            if not splits(cells, group):
                yield group


def assert_every_order_works(cells: Mapping[str, Cells], plan: AssemblyPlan) -> int:
    """Check every order of the steps that has what a step needs before it; return how many there are."""
    tried = 0
    for order in permutations(plan.steps):
        there = {plan.base}
        for step in order:
            if not set(step.after) <= there:
                break
            there |= set(step.bodies)
        else:
            tried += 1
            there = {plan.base}
            for step in order:
                moved = frozenset(chain.from_iterable(cells[n] for n in step.bodies))
                rest = frozenset(chain.from_iterable(cells[n] for n in there))
                back = [-x for x in step.direction]
                assert not meets(moved, rest, back), (step, there)
                far = step.distance_m / SIDE
                away = frozenset(
                    tuple(c + far * x for c, x in zip(cell, back, strict=True))
                    for cell in moved
                )
                assert not meets(away, rest, back)  # type: ignore[arg-type]
                there |= set(step.bodies)
    assert tried > 0
    for step in plan.steps:
        if step.inner is not None:
            assert_every_order_works(cells, step.inner)
    return tried
