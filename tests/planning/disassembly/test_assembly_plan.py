"""Order and directions from geometry, against a slow search over all orders."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from planning.disassembly.assembly_plan import InterlockedError, plan_assembly
from planning.disassembly.body import AssemblyBody


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
