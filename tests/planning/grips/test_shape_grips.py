"""Grips on parts that are no boxes: fingers meet opposite faces, cups find flat spots."""

import re

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.shape import (
    Box,
    Capsule,
    Cylinder,
    Element,
    Form,
    Mesh,
    Shape,
    box_shape,
    shape_of,
)
from planning.grips.grip import GripRules, box_grips
from planning.grips.shape_grips import part_grips
from planning.meshes.convex_pieces import cut_convex
from planning.meshes.mesh_file import MeshTriangles
from planning.transforms import Array, from_rpy, identity, translation

Point = tuple[float, float, float]

EYE = identity()
ANY = GripRules(
    positions=3, steepest=np.pi, opening=0.04, depth=0.03, around=np.radians(45)
)


def of(*forms: Form) -> Shape:
    return shape_of("part", [Element(form, EYE) for form in forms])


def of_mesh(mesh: trimesh.Trimesh) -> Shape:
    triangles = MeshTriangles(np.array(mesh.vertices), np.array(mesh.faces))
    cut = cut_convex(triangles, 0.002)
    form = Mesh(triangles.vertices, triangles.faces, cut.hulls, cut.volume, cut.centre)
    return of(form)


def tube(inner: float, outer: float, height: float) -> trimesh.Trimesh:
    made: trimesh.Trimesh
    made = trimesh.creation.annulus(inner, outer, height, sections=24)
    return made


@given(*[st.floats(0.01, 0.3)] * 3)
def test_boxes_keep_their_grips(x: float, y: float, z: float) -> None:
    shape, rules = box_shape("b", (x, y, z)), GripRules(tilts=(0.0, 0.3))
    found = part_grips(shape, EYE, EYE, rules)
    for one, other in zip(found, box_grips(shape.size, EYE, EYE, rules), strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)
        assert one.words == other.words


@settings(max_examples=30, deadline=None)
@given(st.floats(0.005, 0.03), st.floats(0.03, 0.3), st.booleans())
def test_fingers_close_on_a_bar_across_its_axis_or_on_its_ends(
    radius: float, length: float, ends: bool
) -> None:
    shape = of(Capsule(radius, length) if ends else Cylinder(radius, length))
    found = part_grips(shape, EYE, EYE, ANY)
    full = length + 2 * radius * ends
    if 2 * radius > 0.04 and full > 0.04:
        assert not found
    for grip in found:
        pose = grip.pose
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        closing, at = pose[:3, 1], pose[:3, 3]
        assert abs(closing[2]) < 1e-9 or abs(closing[2]) > 1 - 1e-9
        if abs(closing[2]) < 0.5:
            # Across the axis: the line on which fingers close goes through it.
            assert 2 * radius <= 0.04 + 1e-6
            assert abs(at[0] * closing[1] - at[1] * closing[0]) < 2e-3 + 0.3 * radius
            assert abs(at[2]) <= 0.5 * full + 1e-9
        else:
            assert full <= 0.04 + 2e-3
    if 2 * radius <= 0.0395:
        assert found


@pytest.mark.parametrize("positions", [1, 2, 3, 4])
def test_an_upright_peg_is_gripped_however_many_places_are_tried(
    positions: int,
) -> None:
    rules = GripRules(positions=positions, end_margin=0.001, opening=0.02, depth=0.008)
    assert part_grips(of(Cylinder(0.004, 0.03)), EYE, EYE, rules)


@pytest.mark.parametrize(("around", "tools"), [(90, 2 * 4), (45, 2 * 8), (30, 2 * 12)])
def test_a_finer_angle_gives_more_sides_of_a_bar(around: float, tools: int) -> None:
    rules = GripRules(steepest=np.pi, positions=1, around=np.radians(around))
    found = part_grips(of(Cylinder(0.01, 0.2)), EYE, EYE, rules)
    aside = [g for g in found if abs(g.pose[2, 2]) < 0.5]
    assert len(aside) == tools
    from_above = GripRules(positions=1, around=np.radians(around))
    lying = from_rpy((0, 0, 0), (0, np.pi / 2, 0))
    for grip in part_grips(of(Cylinder(0.01, 0.2)), lying, lying, from_above):
        assert (lying[:3, :3] @ grip.pose[:3, 2])[2] <= -0.5 + 1e-9


@settings(max_examples=10, deadline=None)
@given(
    st.lists(
        st.tuples(
            *[st.tuples(*[st.floats(-1, 1)] * 3)] * 2,
            *[st.tuples(*[st.sampled_from([0.0, 0.4, 1.5])] * 3)] * 2,
        ),
        min_size=2,
        max_size=4,
    )
)
def test_what_is_known_of_one_pose_makes_no_difference_for_another(
    ways: list[tuple[Point, Point, Point, Point]],
) -> None:
    bar = Cylinder(0.01, 0.2)
    rules = GripRules(positions=2, steepest=np.radians(60), opening=0.04)
    shape = of(bar)
    for at, to, turned, then in ways:
        poses = from_rpy(at, turned), from_rpy(to, then)
        found, fresh = (part_grips(s, *poses, rules) for s in (shape, of(bar)))
        assert [g.words for g in found] == [g.words for g in fresh]
        for one, other in zip(found, fresh, strict=True):
            assert np.array_equal(one.pose, other.pose)


def interval(mesh: trimesh.Trimesh, at: Array, closing: Array) -> tuple[float, float]:
    """Return how far the triangles of a mesh are from a point, both ways along a line."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        way = np.einsum("fx,fx->f", a - at, normal) / (normal @ closing)
        hit = at + way[:, None] * closing
        inside = np.isfinite(way)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= np.einsum("fx,fx->f", np.cross(q - p, hit - p), normal) >= -1e-18
    return min(-way[inside & (way < 0)]), min(way[inside & (way > 0)])


@pytest.mark.nightly
@pytest.mark.parametrize(
    "mesh",
    [
        tube(0.02, 0.035, 0.03),
        trimesh.creation.cylinder(0.012, 0.08, sections=32),
        trimesh.creation.torus(0.05, 0.012, major_sections=24, minor_sections=16),
    ],
    ids=["tube", "bar", "torus"],
)
def test_fingers_meet_a_mesh_on_both_sides(mesh: trimesh.Trimesh) -> None:
    """Oracle: the triangles themselves tell how wide the mesh is between the fingers."""
    shape = of_mesh(mesh)
    found = part_grips(shape, EYE, EYE, ANY)
    assert found
    for grip in found:
        one, other = interval(mesh, grip.pose[:3, 3], grip.pose[:3, 1])
        assert one + other <= ANY.opening + 2e-3
        assert abs(one - other) <= 4e-3


def test_a_wall_of_a_tube_is_gripped_only_where_a_finger_has_room_inside() -> None:
    down = GripRules(opening=0.02, finger_width=0.01)
    assert part_grips(of_mesh(tube(0.04, 0.05, 0.03)), EYE, EYE, down)
    # 18 mm of wall would fit, but not a finger beside it: the hole is 24 mm wide.
    roomy = GripRules(opening=0.04, finger_width=0.01, finger_depth=0.015)
    assert not part_grips(of_mesh(tube(0.012, 0.03, 0.03)), EYE, EYE, roomy)


@pytest.mark.parametrize(("opening", "held"), [(0.03, True), (0.018, False)])
def test_a_ring_is_gripped_from_outside_across_its_hole(
    opening: float, held: bool
) -> None:
    """A nut 20 mm wide has a hole in which no finger has room; its width must be open."""
    rules = GripRules(opening=opening, depth=0.006, finger_width=0.01)
    found = part_grips(of_mesh(tube(0.006, 0.01, 0.01)), EYE, EYE, rules)
    assert bool(found) == held
    for grip in found:
        assert np.linalg.norm(grip.pose[:2, 3]) < 5e-3
        assert re.match(r"grip (19|20) mm wide", grip.words)


@pytest.mark.parametrize(("gap", "there"), [(0.012, False), (0.02, True)])
def test_nothing_else_of_a_part_is_where_fingers_come_down(
    gap: float, there: bool
) -> None:
    """A post between two others: fingers fit around it only where they are far enough away."""
    post, rules = Box((0.02, 0.02, 0.06)), GripRules(opening=0.03, positions=1)
    beside = (translation(0, k * (0.02 + gap), 0) for k in (-1, 0, 1))
    posts = shape_of("p", [Element(post, at) for at in beside])
    poses = [grip.pose for grip in part_grips(posts, EYE, EYE, rules)]
    middle = [at for at in poses if abs(at[1, 1]) > 0.9 and abs(at[1, 3]) < 1e-3]
    assert bool(middle) == there


@pytest.mark.parametrize(
    ("shape", "there"),
    [
        (box_shape("b", (0.2, 0.1, 0.05)), True),
        (of(Cylinder(0.03, 0.04)), True),
        (of(Cylinder(0.008, 0.04)), False),
        (of(Capsule(0.03, 0.0)), False),
    ],
    ids=["box", "disc", "pin", "ball"],
)
def test_a_cup_needs_a_flat_spot(shape: Shape, there: bool) -> None:
    rules = GripRules(suction=True, cup=0.01)
    found = part_grips(shape, EYE, EYE, rules)
    assert bool(found) == there
    for grip in found:
        np.testing.assert_allclose(grip.pose[:3, 2], (0, 0, -1), atol=1e-12)
        assert grip.pose[2, 3] == pytest.approx(shape.high[2], abs=1e-6)
        assert np.all(np.abs(grip.pose[:2, 3]) <= shape.high[:2] + 1e-9)
