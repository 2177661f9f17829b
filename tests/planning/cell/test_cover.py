"""Capsule covers contain the hull that they bound, and not much more."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from planning.cell import cover
from planning.cell.body import Capsules
from planning.cell.cover import box_body, capsule_cover, cut_along_axis, hull_vertices
from planning.transforms import Array


def protrusion(vertices: Array, capsules: Capsules) -> float:
    """How far a cover stands out of its hull at most [m].

    For convex sets the largest distance of a point of A from B is the largest difference of
    their support functions over all directions; evaluated on some thousand random ones.
    """
    normals = np.random.default_rng(0).normal(size=(4000, 3))
    normals = np.vstack([normals, np.eye(3), -np.eye(3)])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    support = (np.asarray(vertices) @ normals.T).max(axis=0)
    ends = np.maximum(capsules.start @ normals.T, capsules.end @ normals.T)
    return float((ends + capsules.radius[:, None] - support).max())


def distance_outside(points: Array, capsules: Capsules) -> Array:
    """Distance of each point from the union of the capsules, negative inside."""
    best = np.full(len(points), np.inf)
    for start, end, radius in zip(
        capsules.start, capsules.end, capsules.radius, strict=True
    ):
        axis = end - start
        length2 = axis @ axis
        share = np.zeros(len(points))
        if length2 > 0.0:
            share = np.clip((points - start) @ axis / length2, 0.0, 1.0)
        foot = start + share[:, None] * axis
        best = np.minimum(best, np.linalg.norm(points - foot, axis=1) - radius)
    return best


def sample_hull(vertices: Array, rng: np.random.Generator, count: int) -> Array:
    """Points of a hull: corners, edges and sparse and dense mixtures of its corners."""
    n = len(vertices)
    sparse = rng.dirichlet(np.full(n, 0.08), size=count) @ vertices
    dense = rng.dirichlet(np.ones(n), size=count) @ vertices
    pairs = rng.integers(0, n, size=(count, 2))
    share = rng.random((count, 1))
    edges = vertices[pairs[:, 0]] * share + vertices[pairs[:, 1]] * (1.0 - share)
    return np.vstack([vertices, sparse, dense, edges])


clouds = st.tuples(
    hnp.arrays(
        np.float64,
        st.tuples(st.integers(1, 14), st.just(3)),
        elements=st.floats(-1.0, 1.0, width=32),
    ),
    st.tuples(*[st.sampled_from([0.0, 0.01, 0.1, 0.5])] * 3),
)


@settings(max_examples=60, deadline=None)
@given(cloud=clouds, most=st.integers(1, 6), seed=st.integers(0, 1000))
def test_cover_contains_random_hulls(
    cloud: tuple[Array, tuple[float, ...]], most: int, seed: int
) -> None:
    vertices = cloud[0] * np.array(cloud[1])
    capsules = capsule_cover(vertices, most=most)
    samples = sample_hull(vertices, np.random.default_rng(seed), 1500)
    assert len(capsules.radius) <= most
    assert distance_outside(samples, capsules).max() <= 0.0


@pytest.mark.parametrize(
    "size",
    [
        (0.0158, 0.0318, 0.0096),
        (0.0318, 0.0158, 0.0096),
        (0.0078, 0.0078, 0.0096),
        (0.0078, 0.0638, 0.0096),
        (0.384, 0.384, 0.02),
        (0.02, 0.6985, 1.219),
    ],
)
def test_box_is_contained_and_tight(size: tuple[float, float, float]) -> None:
    body = box_body("box", size)
    grid = np.stack(
        np.meshgrid(*[np.linspace(-s / 2, s / 2, 41) for s in size]), axis=-1
    ).reshape(-1, 3)
    assert distance_outside(grid, body.capsules).max() <= 0.0
    assert protrusion(body.vertices, body.capsules) <= 0.45 * min(size)


def test_box_body_is_the_centred_box() -> None:
    body = box_body("brick", (0.016, 0.032, 0.0096))
    assert body.name == "brick"
    assert body.vertices.shape == (8, 3)
    assert np.allclose(np.ptp(body.vertices, axis=0), (0.016, 0.032, 0.0096))
    assert np.allclose(body.vertices.mean(axis=0), 0.0)
    assert len(body.capsules.radius) == 2


@pytest.mark.parametrize("size", [(0.0, 1.0, 1.0), (1.0, np.nan, 1.0), (1.0, 1.0)])
def test_box_body_rejects_bad_sizes(size: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="'lid'"):
        box_body("lid", size)


def test_more_capsules_are_tighter() -> None:
    slab = box_body("slab", (0.3, 0.2, 0.04)).vertices
    loose = [
        protrusion(slab, capsule_cover(slab, most=m, tolerance=0.0)) for m in (1, 2, 4)
    ]
    assert loose[0] > loose[1] > loose[2]
    assert len(capsule_cover(slab, most=6, tolerance=1.0).radius) == 1


def test_taper_is_followed() -> None:
    """A cone cut across its axis has a thin capsule at its thin end."""
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(24)])
    cone = np.vstack([0.08 * ring, 0.01 * ring + [0.0, 0.0, 0.3]])
    capsules = capsule_cover(cone, tolerance=0.0, thrift=0.0, most=4)
    assert capsules.radius.min() < 0.6 * capsules.radius.max()


def test_protrusion_of_a_capsule_over_its_axis_is_its_radius() -> None:
    start, end = np.zeros((1, 3)), np.array([[0.0, 0.0, 0.4]])
    capsules = Capsules(start, end, np.array([0.05]))
    assert protrusion(np.vstack([start, end]), capsules) == pytest.approx(0.05)


def test_hull_vertices_drops_inner_points() -> None:
    corners = box_body("b", (1.0, 1.0, 1.0)).vertices
    kept = hull_vertices(np.vstack([corners, 0.3 * corners]))
    assert len(kept) == 8


def test_hull_vertices_of_a_plane_and_a_line() -> None:
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    square = np.array([[x, y, 0.0] for x in (0.0, 1.0) for y in (0.0, 2.0)])
    inner = np.column_stack([rng.uniform(0.1, 0.9, (40, 2)), np.zeros(40)])
    kept = hull_vertices(np.vstack([square, inner]) @ turn.T)
    assert {tuple(p) for p in np.round(kept @ turn, 9) + 0.0} == set(map(tuple, square))
    line = np.linspace(0.0, 1.0, 30)[:, None] * np.array([1.0, 2.0, 3.0])
    assert hull_vertices(line).tolist() == [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]


@pytest.mark.parametrize("seed", range(3))
def test_edges_of_a_hull_cut_it_as_all_segments_do(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the segments between all corners on both sides; round bodies have very many."""
    ball = np.random.default_rng(seed).normal(size=(250, 3))
    ball *= np.array([0.9, 0.5, 0.2]) / np.linalg.norm(ball, axis=1)[:, None]
    points = hull_vertices(ball)
    for axis in range(3):
        found = cut_along_axis(points, axis, 2)
        with monkeypatch.context() as patched:
            patched.setattr(cover, "_MANY", 10**9)
            wanted = cut_along_axis(points, axis, 2)
        for a, b in zip(found, wanted, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-12)


def test_a_large_round_link_is_covered_soon() -> None:
    """A link of 3000 corners took minutes when every two of them were joined."""
    angle = np.linspace(0.0, 2.0 * np.pi, 1500, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    link = np.vstack([0.3 * ring, 0.2 * ring + [0.0, 0.0, 1.2]])
    start = time.process_time()
    capsules = capsule_cover(link)
    assert time.process_time() - start < 10.0
    samples = sample_hull(link, np.random.default_rng(0), 3000)
    assert distance_outside(samples, capsules).max() <= 0.0
