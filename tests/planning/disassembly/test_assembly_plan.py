"""Order and directions from geometry, against a slow search over all orders."""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.disassembly.assembly_plan import InterlockedError, plan_assembly
from planning.disassembly.body import AssemblyBody
from tests.voxel_bodies import (
    Cells,
    assert_every_order_works,
    grown_bodies,
    locked_groups,
    voxel_body,
)


def box(name: str, size: tuple[float, ...], at: tuple[float, ...]) -> AssemblyBody:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    return AssemblyBody(name, mesh)


def test_a_stack_has_one_order() -> None:
    bodies = [
        box("table", (0.3, 0.3, 0.02), (0.0, 0.0, -0.01)),
        box("top", (0.05, 0.05, 0.05), (0.0, 0.0, 0.075)),
        box("low", (0.05, 0.05, 0.05), (0.0, 0.0, 0.025)),
    ]
    low, top = plan_assembly(bodies, "table").steps
    assert (low.bodies, low.after) == (("low",), ())
    assert (top.bodies, top.after) == (("top",), ("low",))
    np.testing.assert_allclose(top.direction, (0.0, 0.0, -1.0), atol=1e-12)
    assert top.distance_m == pytest.approx(0.001, abs=2e-4)


def ring(name: str, along: str, at: tuple[float, float, float]) -> AssemblyBody:
    """Return a closed link of a chain in a plane."""
    outer = np.array([[-3, -2], [3, -2], [3, 2], [-3, 2]]) * 0.01
    inner = outer[::-1] * [[0.7, 0.6]]
    points = [(x, y, z) for z in (-0.004, 0.004) for x, y in [*outer, *inner]]
    faces: list[tuple[int, ...]] = []
    for k in range(4):
        m = (k + 1) % 4
        o, p, i, j = k, m, 4 + (3 - k), 4 + (3 - m)
        quads = [(o + 8, p + 8, j + 8, i + 8), (p, o, i, j)]
        quads += [(o, p, p + 8, o + 8), (j, i, i + 8, j + 8)]
        faces += [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    mesh = trimesh.Trimesh(points, faces)
    assert mesh.is_watertight
    assert mesh.volume > 0.0
    if along == "y":
        mesh.apply_transform(
            trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
        )
    mesh.apply_translation(at)
    return AssemblyBody(name, mesh)


def test_links_of_a_chain_are_refused_with_the_pair() -> None:
    bodies = [
        box("plate", (0.3, 0.3, 0.02), (0.0, 0.0, -0.05)),
        ring("one", "z", (-0.02, 0.0, 0.0)),
        ring("two", "y", (0.02, 0.0, 0.0)),
    ]
    with pytest.raises(InterlockedError, match="one blocks two") as caught:
        plan_assembly(bodies, "plate")
    assert caught.value.bodies == ("one", "two")
    assert set(caught.value.blocking) == {("one", "two"), ("two", "one")}


def check(cells: dict[str, Cells]) -> str:
    """Plan bodies of cubes and compare with the slow check; return what came out."""
    bodies = [voxel_body(name, own) for name, own in cells.items()]
    for body in bodies:
        body.mesh.merge_vertices()
    # Where two cubes of a body share no more than an edge, its surface is not closed.
    if not all(body.mesh.is_watertight for body in bodies):
        return "open"
    locked = [set(group) for group in locked_groups(cells)]
    if not locked:
        plan = plan_assembly(bodies, "b0")
        names = sorted(n for step in plan.steps for n in step.bodies)
        assert names == sorted({*cells} - {"b0"})
        assert_every_order_works(cells, plan)
        return "sub" if any(step.inner for step in plan.steps) else "single"
    with pytest.raises(InterlockedError) as caught:
        plan_assembly(bodies, "b0")
    group = set(caught.value.bodies)
    assert group in locked
    assert not any(smaller < group for smaller in locked)
    return "locked"


@settings(max_examples=20, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.integers(2, 5))
def test_plans_of_cut_blocks_hold_in_every_order(seed: int, count: int) -> None:
    check(grown_bodies(seed, (3, 3, 2), count))


@pytest.mark.parametrize(
    ("seed", "shape", "count", "found"),
    [
        (13, (3, 3, 3), 3, "locked"),
        (40, (3, 3, 3), 3, "locked"),
        (22, (4, 3, 3), 4, "locked"),
        (409, (3, 3, 3), 3, "sub"),
        (572, (3, 3, 3), 3, "sub"),
        (626, (3, 3, 3), 3, "sub"),
        (809, (3, 3, 3), 3, "sub"),
    ],
)
def test_locked_blocks_and_sub_assemblies(
    seed: int, shape: tuple[int, int, int], count: int, found: str
) -> None:
    assert check(grown_bodies(seed, shape, count)) == found


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(150))
def test_plans_of_large_cut_blocks_hold_in_every_order(seed: int) -> None:
    check(grown_bodies(seed, (4, 3, 3), 4))


@pytest.mark.nightly
@pytest.mark.parametrize(("columns", "rows", "most_s"), [(6, 5, 20.0), (11, 9, 120.0)])
def test_walls_are_planned_in_time(columns: int, rows: int, most_s: float) -> None:
    """A wall in half bond: every brick waits for the two below it."""
    bodies = [box("floor", (3.0, 3.0, 0.02), (0.0, 0.0, -0.01))]
    for row in range(rows):
        for k in range(columns):
            at = (0.1 * k + 0.05 * (row % 2), 0.0, 0.025 + 0.05 * row)
            bodies.append(box(f"{k} {row}", (0.1, 0.05, 0.05), at))
    before = process_time()
    plan = plan_assembly(bodies, "floor")
    assert process_time() - before < most_s
    after = {step.bodies[0]: set(step.after) for step in plan.steps}
    assert len(after) == columns * rows
    for row in range(1, rows):
        for k in range(1, columns - 1):
            left = k - 1 + row % 2
            assert {f"{left} {row - 1}", f"{left + 1} {row - 1}"} <= after[f"{k} {row}"]
