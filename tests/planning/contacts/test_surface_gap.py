"""Play of meshes in meshes: against polygons in polygons, where each corner meets each edge along a line."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.shape import Element, Mesh, shape_of
from planning.cell.workcell import CellObject
from planning.contacts.interference import forms_overlap_depth, overlap_depth
from planning.contacts.play import _across, _free_of_surface, play_in_place
from planning.contacts.surface_gap import free_distance, surface_gap
from planning.meshes.mesh_loading import load_mesh
from planning.transforms import Array, Indices, Transform, from_rpy, translation

DOWN = np.array([0.0, 0.0, -1.0])


def polygon(radii: list[float], turn: float = 0.0) -> Array:
    """Return a polygon around the origin with corners at some distances, shape (n, 2)."""
    angles = turn + 2.0 * math.pi * np.arange(len(radii)) / len(radii)
    out: Array = np.column_stack([np.cos(angles), np.sin(angles)])
    out *= np.array(radii)[:, None]
    return out


def raised(
    outline: Array, low: float, high: float, hole: Array | None = None
) -> tuple[Array, Indices]:
    """Return vertices and faces of a prism over a polygon around the origin, or over what is around a hole."""
    n = len(outline)
    loops = [outline] if hole is None else [outline, hole]
    points = [
        np.column_stack([loop, np.full(n, z)]) for loop in loops for z in (low, high)
    ]
    faces = []
    for k in range(n):
        m = (k + 1) % n
        for at, flip in ((0, False), (2 * n, True))[: len(loops)]:
            wall = [(at + k, at + m, at + n + m), (at + k, at + n + m, at + n + k)]
            faces += [(a, c, b) if flip else (a, b, c) for a, b, c in wall]
        if hole is None:
            faces += [(2 * n, m, k), (2 * n + 1, n + k, n + m)]
        else:
            low_ring = [(k, 2 * n + k, m), (m, 2 * n + k, 2 * n + m)]
            faces += low_ring
            faces += [(a + n, c + n, b + n) for a, b, c in low_ring]
    if hole is None:
        points.append(np.array([(0.0, 0.0, low), (0.0, 0.0, high)]))
    return np.vstack(points), np.array(faces)


def surface(vertices: Array, faces: Indices) -> Mesh:
    return Mesh(vertices, faces, (vertices,), 1.0, np.zeros(3))


def ray_play(peg: Array, hole: Array, way: Array) -> float:
    """Return how far a polygon goes along a direction in a hole: each corner to each edge, and back."""
    best = math.inf
    for corners, edges, along in ((peg, hole, way), (hole, peg, -way)):
        ends = np.roll(edges, -1, axis=0)
        for a, side in zip(edges, edges - ends, strict=True):
            across = along[0] * side[1] - along[1] * side[0]
            if abs(across) > 1e-15:
                off = a - corners
                far = (off[:, 0] * side[1] - off[:, 1] * side[0]) / across
                share = (along[0] * off[:, 1] - along[1] * off[:, 0]) / across
                met = (far >= 0.0) & (share >= -1e-9) & (share <= 1.0 + 1e-9)
                best = min(best, float(far[met].min(initial=math.inf)))
    return best


radii = st.lists(st.floats(0.006, 0.0075), min_size=7, max_size=7)
holes = st.lists(st.floats(0.0092, 0.011), min_size=7, max_size=7)


@settings(max_examples=12, deadline=None)
@given(
    radii,
    holes,
    st.floats(0, 3),
    st.floats(-0.5, 0.5),
    st.tuples(*[st.floats(-3, 3)] * 3),
)
def test_play_is_that_of_polygons(
    inner: list[float],
    outer: list[float],
    turn: float,
    off: float,
    rpy: tuple[float, ...],
) -> None:
    """Of prisms that are not convex, wherever both are in the world."""
    peg, hole = polygon(inner, turn) + np.array((off * 1e-3, 0.0)), polygon(outer)
    world = translation(0.3, -0.2, 0.1) @ from_rpy((0.0, 0.0, 0.0), rpy)
    one = Element(surface(*raised(peg, 0.0, 0.02)), world)
    other = Element(surface(*raised(polygon([0.02] * 7), 0.004, 0.03, hole)), world)
    insertion = world[:3, :3] @ DOWN
    found = _free_of_surface(one, other, insertion)
    assert found is not None
    for way, free in zip(_across(insertion), found, strict=True):
        true = ray_play(peg, hole, (world[:3, :3].T @ way)[:2])
        if math.isfinite(free):
            assert free == pytest.approx(true, abs=5e-6)
        else:
            assert true >= 0.003 - 5e-6


def test_what_is_inside_or_meets_has_no_gap() -> None:
    ball = surface(*raised(polygon([0.01] * 8), 0.0, 0.02))
    large = surface(*raised(polygon([0.05] * 8), -0.05, 0.07))
    here = np.eye(4)
    assert surface_gap(Element(ball, here), Element(large, here)) == 0.0
    assert surface_gap(Element(large, here), Element(ball, here)) == 0.0
    assert (
        surface_gap(Element(ball, here), Element(ball, translation(0.019, 0, 0))) == 0.0
    )
    away = Element(ball, translation(0.0, 0.0, 0.025))
    assert surface_gap(Element(ball, here), away) == pytest.approx(0.005)
    assert forms_overlap_depth(Element(ball, here), Element(large, here)) > 0.0
    assert free_distance(Element(ball, here), away, -DOWN, 0.1) == pytest.approx(
        0.005, abs=2e-6
    )
    assert free_distance(Element(ball, here), away, DOWN, 0.1) == math.inf


def written(path: Path, vertices: Array, faces: Indices) -> Mesh:
    lines = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces.tolist()]
    path.write_text("\n".join(lines))
    return load_mesh(path)


@pytest.mark.parametrize("sides", [24, 160])
def test_a_round_peg_of_many_sides_has_the_play_of_its_corners(
    sides: int, tmp_path: Path
) -> None:
    """Whatever hollows the convex pieces of the socket fill."""
    peg, hole = polygon([0.0060] * sides), polygon([0.0062] * sides)
    ring = raised(polygon([0.018] * sides), 0.0, 0.012, hole)
    shape = {
        "peg": written(tmp_path / "peg.obj", *raised(peg, 0.0, 0.03)),
        "socket": written(tmp_path / "socket.obj", *ring),
    }

    def thing(name: str, at: Transform) -> tuple[CellObject, Transform]:
        own = shape_of(name, [Element(shape[name], np.eye(4))])
        return CellObject(name, name, own, np.eye(4)), at

    inside, around = thing("peg", translation(0, 0, 0.002)), thing("socket", np.eye(4))
    assert overlap_depth(inside, around) <= 0.0
    found = play_in_place(inside, {"socket": around}, DOWN)
    assert found is not None
    true = min(ray_play(peg, hole, way[:2]) for way in _across(DOWN))
    assert found.least == pytest.approx(true, abs=5e-6)
    assert found.words == f"{1e3 * found.least:.2f} mm on all sides"
