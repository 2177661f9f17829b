"""Shapes contain what they are made of, and by no more than they say."""

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.body import ConvexBody
from planning.cell.cover import box_body
from planning.cell.shape import (
    Box,
    Capsule,
    Cylinder,
    Element,
    box_shape,
    round_body,
    shape_of,
)
from planning.geometry.exact import hull_shape
from planning.transforms import Array, Transform, from_rpy
from tests.planning.cell.round_forms import stands_out
from twin.planning.shapes import build_shape
from twin.scenario.sections.shapes import ShapeSection

lengths = st.floats(1e-3, 1.0)
forms = st.one_of(
    st.builds(lambda x, y, z: Box((x, y, z)), lengths, lengths, lengths),
    st.builds(Cylinder, lengths, lengths),
    st.builds(Capsule, lengths, st.one_of(st.just(0.0), lengths)),
)
turns = st.floats(-3.0, 3.0)
poses = st.builds(
    lambda *v: from_rpy(v[:3], v[3:]), turns, turns, turns, turns, turns, turns
)


def surface(
    form: Box | Cylinder | Capsule, rng: np.random.Generator, count: int = 400
) -> Array:
    """Return points of the surface of a form, by its definition."""
    to = rng.normal(size=(count, 3))
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    if isinstance(form, Box):
        half = 0.5 * np.array(form.size)
        to /= np.max(np.abs(to) / half, axis=1, keepdims=True)
        return to
    around = to[:, :2] / np.linalg.norm(to[:, :2], axis=1, keepdims=True)
    high = rng.uniform(-0.5, 0.5, count) * form.length
    side = np.column_stack([form.radius * around, high])
    if isinstance(form, Capsule):
        ends = form.radius * to
        ends[:, 2] += np.sign(to[:, 2]) * 0.5 * form.length
        return np.vstack([side, ends])
    inner = np.sqrt(rng.uniform(0, 1, count))[:, None] * form.radius * around
    return np.vstack([side, np.column_stack([inner, np.sign(high) * form.length / 2])])


def beyond(body: ConvexBody, points: Array) -> float:
    """Return how far points are outside of a body at most."""
    gaps = (
        coal.distance(
            hull_shape(body),
            coal.Transform3s(),
            coal.Sphere(1e-9),
            coal.Transform3s(np.eye(3), point),
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
        for point in points
    )
    return float(max(gaps))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(forms, poses), min_size=1, max_size=4), st.integers(0, 99))
def test_pieces_contain_their_elements_and_stand_out_as_little_as_they_say(
    parts: list[tuple[Box | Cylinder | Capsule, Transform]], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    shape = shape_of("part", [Element(form, pose) for form, pose in parts])
    assert len(shape.pieces) == len(parts)
    volume = 0.0
    for piece, (form, pose) in zip(shape.pieces, parts, strict=True):
        points = surface(form, rng, 60) @ pose[:3, :3].T + pose[:3, 3]
        assert beyond(piece, points) <= 1e-7
        assert np.all(points >= shape.low - 1e-9)
        assert np.all(points <= shape.high + 1e-9)
        volume += form.volume
        if not isinstance(form, Box):
            local = (piece.vertices - pose[:3, 3]) @ pose[:3, :3]
            exact = (
                coal.Cylinder(form.radius, form.length)
                if isinstance(form, Cylinder)
                else coal.Capsule(form.radius, form.length)
            )
            out = [
                coal.distance(
                    exact,
                    coal.Transform3s(),
                    coal.Sphere(1e-9),
                    coal.Transform3s(np.eye(3), corner),
                    coal.DistanceRequest(),
                    coal.DistanceResult(),
                )
                for corner in local
            ]
            assert max(out) <= stands_out(form) + 1e-6
        # Capsules contain the corners: they bound the piece.
        covers = piece.capsules
        way = covers.end - covers.start
        length = np.maximum((way**2).sum(1), 1e-30)
        for corner in piece.vertices:
            along = np.clip(((corner - covers.start) * way).sum(1) / length, 0, 1)
            gap = np.linalg.norm(corner - covers.start - along[:, None] * way, axis=1)
            assert np.any(gap <= covers.radius + 1e-9)
    assert shape.volume == pytest.approx(volume)


@pytest.mark.parametrize(
    ("radius", "most"), [(0.001, 1e-4), (0.005, 1e-4), (0.015, 1e-4), (0.3, 7e-4)]
)
def test_round_sides_stand_out_by_a_tenth_of_a_millimetre(
    radius: float, most: float
) -> None:
    bar = Cylinder(radius, 0.2)
    assert 0.0 < stands_out(bar) <= most
    # Its faces touch the round side: a bar lies on one of them as high as it should.
    assert round_body(bar).low[0] == pytest.approx(-radius, abs=1.1e-4 + 0.003 * radius)
    assert stands_out(Capsule(radius, 0.1)) <= 0.042 * radius


def test_a_box_is_as_it_was() -> None:
    edges = np.array([0.0157, 0.0319, 0.0097])  # of no other test, so that both are new
    shape, body = box_shape("b", edges), box_body("b", edges)
    assert shape.is_box
    assert shape.pieces[0].vertices is body.vertices
    np.testing.assert_array_equal(shape.size, edges)
    np.testing.assert_array_equal(shape.middle, 0.0)
    assert shape.volume == pytest.approx(edges.prod())


def test_the_mass_of_a_compound_is_where_its_elements_are() -> None:
    section = ShapeSection.model_validate_json(
        '{"compound": [{"box": [0.1, 0.1, 0.1]},'
        ' {"cylinder": {"radius_m": 0.05, "length_m": 0.1}, "pose": {"xyz_m": [1, 0, 0]}},'
        ' {"compound": [{"capsule": {"radius_m": 0.01, "length_m": 0}}],'
        '  "pose": {"xyz_m": [0, 1, 0], "rpy_deg": [90, 0, 0]}}]}'
    )
    shape = build_shape("part", section)
    assert [type(e.form).__name__ for e in shape.elements] == [
        "Box",
        "Cylinder",
        "Capsule",
    ]
    box, rod, ball = 1e-3, np.pi * 0.05**2 * 0.1, 4 / 3 * np.pi * 1e-6
    assert shape.volume == pytest.approx(box + rod + ball)
    np.testing.assert_allclose(
        shape.centre_of_mass, np.array([rod, ball, 0]) / (box + rod + ball), atol=1e-12
    )
    assert not shape.is_box


@pytest.mark.parametrize(
    "text",
    ["{}", '{"box": [1, 1, 1], "mesh": "a.stl"}', '{"box": [1, 1, 1], "scale": 2.0}'],
)
def test_a_shape_is_one_thing(text: str) -> None:
    with pytest.raises(ValueError, match=r"give one of|belong to a mesh"):
        ShapeSection.model_validate_json(text)
