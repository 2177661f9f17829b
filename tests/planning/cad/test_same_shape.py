"""Bodies of the same shape are found in any pose; mirror images and other sizes are not the same."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from planning.cad.exact_forms import BallForm, BoxForm, RodForm, exact_form
from planning.cad.glb_bodies import CadBody
from planning.cad.layout import resting_sides
from planning.cad.same_shape import ALIKE, pose_of
from planning.cell.shape import box_shape
from planning.transforms import Array

seeds = st.integers(0, 10_000)


def corners(points: Array) -> CadBody:
    """Return a convex body with some corners."""
    hull = ConvexHull(points)
    inside = points.mean(axis=0)
    faces = hull.simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - inside) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    none = np.full(len(faces), -1)
    return CadBody(("body",), points, faces, none, (), np.eye(4), None)


def moved(points: Array, generator: np.random.Generator) -> Array:
    turn = Rotation.random(random_state=generator).as_matrix()
    order = generator.permutation(len(points))
    return np.asarray((points @ turn.T + generator.uniform(-1, 1, 3))[order])


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_a_body_is_found_in_any_pose(seed: int) -> None:
    generator = np.random.default_rng(seed)
    points = generator.normal(0.0, 0.03, (int(generator.integers(4, 14)), 3))
    points = points[ConvexHull(points).vertices]
    one, other = corners(points), corners(moved(points, generator))
    pose = pose_of(one, other)
    assert pose is not None
    assert np.isclose(np.linalg.det(pose[:3, :3]), 1.0)
    where = points @ pose[:3, :3].T + pose[:3, 3]
    gaps = np.linalg.norm(where[:, None] - other.vertices, axis=2).min(axis=1)
    assert gaps.max() <= ALIKE
    # Neither a mirror image nor a body with one corner elsewhere is the same.
    mirrored = corners(moved(points * [1.0, 1.0, -1.0], generator))
    assert pose_of(one, mirrored) is None
    dented = points.copy()
    dented[0] *= 1.0 + 5.0 * ALIKE / np.linalg.norm(dented[0])
    assert pose_of(one, corners(moved(dented, generator))) is None


def test_a_body_with_many_symmetries_is_found() -> None:
    """A prism over a polygon of 60 corners, as a gear is."""
    angles = 2.0 * np.pi * np.arange(60) / 60
    ring = np.column_stack([0.02 * np.cos(angles), 0.02 * np.sin(angles)])
    points = np.vstack([np.column_stack([ring, np.full(60, z)]) for z in (0.0, 0.01)])
    other = moved(points, np.random.default_rng(3))
    assert pose_of(corners(points), corners(other)) is not None


def box_body(size: Array, turn: Array) -> CadBody:
    signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    return corners((signs * size) @ turn.T)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_boxes_are_recognised_in_any_pose(seed: int) -> None:
    generator = np.random.default_rng(seed)
    size = generator.uniform(0.005, 0.1, 3)
    found = exact_form(
        box_body(size, Rotation.random(random_state=generator).as_matrix())
    )
    assert found is not None
    form, pose = found
    assert isinstance(form, BoxForm)
    np.testing.assert_allclose(sorted(form.size), sorted(size), atol=1e-6)
    small, _ = form.aligned(pose)
    assert small.match(form, ALIKE) is not None
    assert small.match(BoxForm((*small.size[:2], small.size[2] + 1e-3)), ALIKE) is None


def test_a_box_without_a_corner_is_none() -> None:
    body = box_body(np.array([0.02, 0.03, 0.04]), np.eye(3))
    body.vertices[3] *= 0.9
    assert exact_form(body) is None


@pytest.mark.parametrize(
    ("rows", "alike"),
    [
        ([(0.003, 0.02), (0.005, 0.01)], True),
        ([(0.005, 0.01), (0.003, 0.02)], True),
        ([(0.003, 0.01), (0.005, 0.02)], False),
        ([(0.003, 0.03)], False),
    ],
)
def test_rods_are_alike_from_either_end(
    rows: list[tuple[float, float]], alike: bool
) -> None:
    screw = RodForm(((0.003, 0.02), (0.005, 0.01)))
    assert (screw.match(RodForm(tuple(rows)), ALIKE) is not None) == alike
    assert screw.match(BallForm(0.003), ALIKE) is None


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_a_box_lies_on_each_side_that_is_wide_enough(seed: int) -> None:
    """It falls over an edge when tilted by more than the angle of half the width to half the height."""
    generator = np.random.default_rng(seed)
    size = generator.uniform(0.002, 0.1, 3)
    turn = Rotation.from_euler("z", generator.uniform(0, 6)).as_matrix()
    found = list(resting_sides(box_shape("box", size), turn))
    expected = {
        k
        for k in range(3)
        if np.arctan2(np.delete(size, k).min(), size[k]) > np.radians(1.5)
    }
    sides = {int(np.abs(own[2]).argmax()) for own, _ in found}
    assert sides == expected
    first, height = found[0]
    if 2 in expected:
        np.testing.assert_allclose(first, turn, atol=1e-9)
        assert height == pytest.approx(0.5 * size[2], abs=1e-6)
