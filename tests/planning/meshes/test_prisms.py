"""Plates and milled bodies, cut into convex pieces slice by slice."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from planning.meshes.prisms import prism_pieces
from planning.transforms import Array, Indices, from_rpy


@given(st.integers(0, 2**20), st.integers(1, 5), st.integers(1, 5))
@example(66, 2, 5)  # cut along a line, a triangle without area is left
@settings(max_examples=40, deadline=None)
def test_milled_bodies_are_covered_exactly(seed: int, wide: int, deep: int) -> None:
    """A point is in a piece if and only if it is in a cell that is not milled away."""
    rng = np.random.default_rng(seed)
    solid = np.zeros((wide + 2, deep + 2, 4 + 2), dtype=bool)
    height = rng.integers(0, 4, (wide, deep))
    floor = rng.integers(0, 2, (wide, deep))
    level = np.arange(4)
    solid[1:-1, 1:-1, 1:-1] = (level < height[..., None]) & (level >= floor[..., None])
    assume(solid.any() and not _touch_in_an_edge(solid))
    sides = np.array([0.03, 0.02, 0.005])
    turn = from_rpy((0.1, -0.2, 0.3), tuple(rng.uniform(-3.0, 3.0, 3)))
    vertices, faces = _surface(solid, sides)
    vertices = vertices @ turn[:3, :3].T + turn[:3, 3]
    pieces = prism_pieces(vertices, faces, 1e-9, 1000)
    assert pieces is not None
    points = rng.uniform(0.0, 1.0, (400, 3)) * sides * solid.shape
    cell = tuple((points // sides).astype(int).T)
    away = points @ turn[:3, :3].T + turn[:3, 3]
    within = np.array([_inside(piece, away) for piece in pieces])
    assert np.array_equal(within.any(axis=0), solid[cell])
    assert within.sum(axis=0).max() <= 1
    volume = sum(ConvexHull(piece).volume for piece in pieces)
    assert volume == pytest.approx(np.count_nonzero(solid) * np.prod(sides))


@pytest.mark.parametrize("within", [1e-3, 3e-4, 1e-5])
def test_holes_stay_open_but_for_what_may_be_filled(within: float) -> None:
    vertices, faces = _ring(inner=0.01, outer=0.02, height=0.004, count=48)
    pieces = prism_pieces(vertices, faces, 64 * within, 1000)
    assert pieces is not None
    rng = np.random.default_rng(0)
    points = np.column_stack(
        [rng.uniform(-0.02, 0.02, (4000, 2)), rng.uniform(0.0, 0.004, 4000)]
    )
    radius = np.hypot(points[:, 0], points[:, 1])
    covered = np.any([_inside(piece, points) for piece in pieces], axis=0)
    chord = np.cos(np.pi / 48)
    assert covered[(radius > 0.01) & (radius < 0.02 * chord)].all()
    assert not covered[radius < 0.01 * chord - within].any()


def test_finer_pieces_are_made_where_there_may_be_more() -> None:
    vertices, faces = _ring(inner=0.01, outer=0.02, height=0.004, count=24)
    counts = [
        len(prism_pieces(vertices, faces, 2e-3, most) or []) for most in (12, 20, 100)
    ]
    assert 0 < counts[0] <= 12 < counts[1] <= 20 < counts[2]
    assert prism_pieces(vertices, faces, 1e-6, 10) is None


def test_leaning_faces_are_for_others() -> None:
    vertices, faces = _ring(inner=0.01, outer=0.02, height=0.004, count=12)
    cone = vertices.copy()
    cone[vertices[:, 2] > 0.0, :2] *= 0.98
    assert prism_pieces(vertices, faces, 1e-4, 100) is not None
    assert prism_pieces(cone, faces, 1e-4, 100) is None


def test_open_bodies_are_for_others() -> None:
    vertices, faces = _ring(inner=0.01, outer=0.02, height=0.004, count=12)
    wall = np.ptp(vertices[faces][:, :, 2], axis=1) > 0.0
    assert (
        prism_pieces(vertices, np.delete(faces, np.argmax(wall), 0), 1e-4, 99) is None
    )


def _inside(piece: Array, points: Array) -> Array:
    planes = ConvexHull(piece).equations
    return np.asarray((points @ planes[:, :3].T + planes[:, 3]).max(axis=1) < 0.0)


def _touch_in_an_edge(solid: Array) -> bool:
    """Tell whether two cells have an edge in common and no face: four faces meet in it."""
    for one, other in ((0, 1), (0, 2), (1, 2)):
        moved = np.moveaxis(solid, (one, other), (0, 1))
        a, b, c, d = moved[:-1, :-1], moved[1:, 1:], moved[:-1, 1:], moved[1:, :-1]
        if np.any((a & b & ~c & ~d) | (c & d & ~a & ~b)):
            return True
    return False


def _surface(solid: Array, sides: Array) -> tuple[Array, Indices]:
    """Return the surface of cells, two triangles a face, whose corners are shared."""
    quads = []
    for axis in range(3):
        for side in (0, 1):
            beyond = np.roll(solid, 1 if side == 0 else -1, axis=axis)
            u, v = np.eye(3, dtype=int)[[k for k in range(3) if k != axis]]
            for cell in np.argwhere(solid & ~beyond):
                at = cell + side * np.eye(3, dtype=int)[axis]
                quads.append([at, at + u, at + u + v, at + v])
    corners = np.array(quads).reshape(-1, 3)
    vertices, number = np.unique(corners, axis=0, return_inverse=True)
    four = number.reshape(-1, 4)
    return vertices * sides, np.vstack([four[:, [0, 1, 2]], four[:, [0, 2, 3]]])


def _ring(
    inner: float, outer: float, height: float, count: int
) -> tuple[Array, Indices]:
    """Return a washer."""
    angle = 2.0 * np.pi * np.arange(count) / count
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    up = np.array([0.0, 0.0, height])
    rows = [inner * circle, outer * circle, outer * circle + up, inner * circle + up]
    k = np.arange(count)
    after = (k + 1) % count
    faces = []
    for row in range(4):
        a, b = count * row, count * ((row + 1) % 4)
        faces.append(np.column_stack([a + k, a + after, b + k]))
        faces.append(np.column_stack([a + after, b + after, b + k]))
    return np.vstack(rows), np.vstack(faces)
