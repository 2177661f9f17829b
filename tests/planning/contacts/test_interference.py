"""How deep things are in each other, against formulas, and against points spread over surfaces.

Play of parts across their ways in, and the chance to fit, against formulas and drawn positions.
"""

import math

import numpy as np
import pytest
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
from planning.cell.workcell import CellObject, Fixture
from planning.contacts.interference import (
    ROUNDING,
    Overlaps,
    bore_around,
    mesh_bodies,
    overlap_depth,
    round_solid,
)
from planning.contacts.play import ISO_9283, Play, play_in_place
from planning.contacts.surface_depth import ConvexSolid, deepest_point, winding_number
from planning.contacts.touching import PlacedObject, nearby_entities
from planning.transforms import Array, Indices, Transform, from_rpy, translation

edges = st.tuples(*[st.floats(0.02, 0.3)] * 3)
places = st.tuples(*[st.floats(-0.4, 0.4)] * 3)


def box(size: tuple[float, float, float]) -> CellObject:
    edges = np.array(size)
    return CellObject("part", "box", box_shape("part", edges), np.eye(4))


def gap_of_upright(
    size_a: tuple[float, ...],
    at_a: tuple[float, ...],
    size_b: tuple[float, ...],
    at_b: tuple[float, ...],
) -> float:
    """Distance of two boxes parallel to the axes; negative inside each other."""
    apart = np.abs(np.subtract(at_a, at_b)) - np.add(size_a, size_b) / 2
    if apart.max() < 0:
        return float(apart.max())
    return float(np.linalg.norm(np.maximum(apart, 0)))


@given(edges, places, edges, places)
def test_it_is_the_distance_of_the_boxes(
    size_a: tuple[float, float, float],
    at_a: tuple[float, float, float],
    size_b: tuple[float, float, float],
    at_b: tuple[float, float, float],
) -> None:
    expected = gap_of_upright(size_a, at_a, size_b, at_b)
    found = nearby_entities(
        (box(size_a), translation(*at_a)),
        {"b": (box(size_b), translation(*at_b))},
        0.05,
    )
    if expected > 0.0501:
        assert found == {}
    elif expected < 0.0499:
        assert found["b"] == pytest.approx(expected, abs=1e-5)


def test_a_rod_leaning_on_an_edge_touches_it_and_one_beside_does_not() -> None:
    rod = box((0.2, 0.02, 0.02))
    leaning = from_rpy((0, 0, 0), (0, -np.pi / 4, 0))
    # The lower face passes 10 mm from the axis: on the line z = x - 0.01 * sqrt(2).
    edge = 0.05 - 0.01 * np.sqrt(2)
    post = box((0.02, 0.02, 0.1))
    touching = translation(0.06, 0, edge - 0.05 - 0.0005)
    found = nearby_entities(
        (rod, leaning),
        {"post": (post, touching), "other": (post, translation(0.06, 0.1, 0))},
        0.002,
    )
    assert list(found) == ["post"]
    assert found["post"] == pytest.approx(0.0005 / np.sqrt(2), abs=1e-6)


UPRIGHT = np.eye(4)


def thing(form: Form | Shape, pose: Transform = UPRIGHT) -> PlacedObject:
    if isinstance(form, Mesh):
        own = Shape((Element(form, UPRIGHT),), mesh_bodies(form))
    else:
        own = (
            form
            if isinstance(form, Shape)
            else shape_of("own", [Element(form, UPRIGHT)])
        )
    return Fixture("own", own, pose), pose


def mesh_of(pieces: list[Array], faces: Indices, vertices: Array) -> Mesh:
    return Mesh(vertices, faces, tuple(pieces), 1e-6, np.zeros(3))


def bored(radius: float, sides: int, width: float, height: float) -> Mesh:
    """Return a round block with a bore through it, its polygon inside of the circle of the bore."""
    turn = 2.0 * math.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    rings = [
        np.column_stack([scale * ring, np.full(sides, high)])
        for scale in (radius, width)
        for high in (-0.5 * height, 0.5 * height)
    ]
    vertices = np.vstack(rings)
    low, top, outer_low, outer_top = (k * sides + np.arange(sides) for k in range(4))
    faces = []
    for a, b in (
        (top, low),
        (outer_low, outer_top),
        (outer_top, top),
        (low, outer_low),
    ):
        after_a, after_b = np.roll(a, -1), np.roll(b, -1)
        faces += [
            np.column_stack([a, b, after_a]),
            np.column_stack([after_a, b, after_b]),
        ]
    around = [np.stack([r, np.roll(r, -1, axis=0)]) for r in rings]
    pieces = [
        np.vstack([r[:, k] for r in around]) for k in range(sides)
    ]  # one sector a side
    return mesh_of(pieces, np.vstack(faces)[:, ::-1], vertices)


def box_mesh(x: float, y: float, z: float) -> Mesh:
    import trimesh

    body = trimesh.creation.box((x, y, z))
    vertices = np.asarray(body.vertices)
    return mesh_of([vertices], np.asarray(body.faces), vertices)


@settings(deadline=None, max_examples=30)
@given(
    st.floats(0.002, 0.02),
    st.integers(12, 40),
    st.floats(-0.0015, 0.0015),
    st.floats(0.0, 0.0015),
    st.floats(0.0, 2.0 * math.pi),
)
def test_a_round_peg_is_in_a_bore_of_a_mesh_as_deep_as_radii_and_axes_say(
    radius: float, sides: int, play: float, off: float, turn: float
) -> None:
    block = thing(bored(radius, sides, radius + 0.02, 0.01))
    peg = Cylinder(max(radius - play, 3e-4), 0.03)
    pose = translation(off * math.cos(turn), off * math.sin(turn), 0.0)
    expected = peg.radius + off - radius
    found = (
        overlap_depth(thing(peg, pose), block),
        overlap_depth(block, thing(peg, pose)),
    )
    # What is within rounding may be told as rounding or as nothing, whichever is named first.
    if max(expected, *found) > ROUNDING + 2e-6:
        assert found == pytest.approx((expected, expected), abs=2e-6)


def test_a_bore_has_an_end_and_a_hexagon_is_none() -> None:
    """A peg in a blind hole goes into its ground; one in a hexagon meets the flats."""
    peg = Cylinder(0.00495, 0.02)
    whole = Element(bored(0.005, 32, 0.02, 0.01), UPRIGHT)
    floor = Element(Box((0.04, 0.04, 0.01)), translation(0.0, 0.0, -0.01))
    blind = shape_of("blind", [whole, floor])
    for sunk in (-1e-5, 4e-5, 1e-4):  # less than the polygon is inside of its circle
        found = overlap_depth(thing(peg, translation(0, 0, 0.005 - sunk)), thing(blind))
        assert found == pytest.approx(sunk if sunk > 0 else 0.0, abs=1.1e-5)
    nut = Element(bored(0.005, 6, 0.02, 0.01), UPRIGHT)
    assert bore_around(peg, UPRIGHT, nut) is None
    assert bore_around(peg, UPRIGHT, whole) is not None
    flats = 0.005 * math.cos(math.pi / 6)
    assert overlap_depth(thing(peg), thing(nut.form)) == pytest.approx(
        peg.radius - flats, abs=2e-6
    )


@settings(deadline=None, max_examples=30)
@given(st.floats(-0.03, 0.03), st.integers(0, 2), st.booleans())
def test_boxes_and_meshes_of_boxes_are_alike(
    shift: float, axis: int, both: bool
) -> None:
    size = np.array([0.03, 0.04, 0.05])
    at = translation(*(shift * np.eye(3)[axis]))
    other: Form = box_mesh(*size) if both else Box((0.03, 0.04, 0.05))
    found = overlap_depth(thing(box_mesh(*size)), thing(other, at))
    deep = size[axis] - abs(shift)
    if deep <= ROUNDING:
        assert found <= ROUNDING + 1e-6
    elif deep < 0.45 * size.min():
        assert found == pytest.approx(deep, abs=2e-6)
    else:
        assert found >= 0.4 * size.min()


def test_what_goes_through_a_surface_is_as_deep_as_it_goes() -> None:
    block = thing(box_mesh(0.04, 0.04, 0.04))
    pin = Cylinder(0.0005, 0.02)
    ahead = thing(pin, translation(0, 0, 0.025))
    assert overlap_depth(ahead, block) == pytest.approx(0.005, abs=1e-5)
    assert overlap_depth(thing(pin), block) > 0.02  # wholly inside: no surface is in it
    ball = Capsule(0.005, 0.0)
    assert overlap_depth(thing(ball, translation(0.024, 0, 0)), block) == pytest.approx(
        0.001, abs=2e-6
    )


def test_a_hollow_that_a_piece_fills_is_still_hollow() -> None:
    """A channel that one convex piece stands for: what lies in it is in nothing."""
    import trimesh

    parts = [
        trimesh.creation.box((0.04, 0.04, 0.01)),
        trimesh.creation.box(
            (0.01, 0.04, 0.02), transform=translation(0.015, 0, 0.015)
        ),
        trimesh.creation.box(
            (0.01, 0.04, 0.02), transform=translation(-0.015, 0, 0.015)
        ),
    ]
    body = trimesh.util.concatenate(parts)
    assert isinstance(body, trimesh.Trimesh)
    vertices = np.asarray(body.vertices)
    channel = thing(mesh_of([vertices], np.asarray(body.faces), vertices))
    key = Box((0.0198, 0.02, 0.02))
    for x, deep in ((0.0, 0.0), (1e-4, 0.0), (2e-4, 1e-4), (0.0015, 0.0014)):
        found = overlap_depth(thing(key, translation(x, 0, 0.0151)), channel)
        assert max(found, 0.0) == pytest.approx(deep, abs=2e-6)


corners = st.lists(st.tuples(*[st.floats(-0.02, 0.02)] * 3), min_size=3, max_size=3)
forms = st.one_of(
    st.builds(Cylinder, st.floats(0.003, 0.012), st.floats(0.004, 0.02)),
    st.builds(Capsule, st.floats(0.003, 0.012), st.floats(0.0, 0.02)),
    st.builds(Box, st.tuples(*[st.floats(0.006, 0.03)] * 3)),
)


@settings(deadline=None, max_examples=30)
@given(forms, st.lists(corners, min_size=1, max_size=3))
def test_the_deepest_point_is_that_of_points_spread_over_the_triangles(
    form: Form, surface: list[list[tuple[float, float, float]]]
) -> None:
    triangles = np.array(surface)
    solid = _solid(form)
    k, j = np.meshgrid(np.arange(41), np.arange(41), indexing="ij")
    inside = k + j <= 40
    shares = np.column_stack([k[inside], j[inside], 40 - k[inside] - j[inside]]) / 40.0
    spread = np.einsum("sk,tkx->tsx", shares, triangles).reshape(-1, 3)
    expected = float(_plain_depth(form, spread).max())
    edges = triangles - np.roll(triangles, 1, axis=1)
    step = float(np.linalg.norm(edges, axis=2).max()) / 40.0
    found = deepest_point(solid, triangles)
    if found == -math.inf:
        assert expected <= 1e-9
    else:
        assert expected - 2e-6 <= found <= max(expected, 0.0) + step + 2e-6


def _solid(form: Form) -> ConvexSolid:
    if isinstance(form, Cylinder | Capsule):
        return round_solid(form)
    assert isinstance(form, Box)
    half = 0.5 * np.array(form.size)
    planes = np.vstack([np.eye(3), -np.eye(3)])
    zero = np.zeros(3)
    return ConvexSolid(planes, np.tile(half, 2), float(half.min()), zero, -half, half)


def _plain_depth(form: Form, points: Array) -> Array:
    """Depth of points, one form after another, as a school book has it."""
    if isinstance(form, Box):
        return np.asarray((0.5 * np.array(form.size) - np.abs(points)).min(axis=1))
    assert isinstance(form, Cylinder | Capsule)
    half = 0.5 * form.length
    if isinstance(form, Cylinder):
        around = form.radius - np.hypot(points[:, 0], points[:, 1])
        return np.asarray(np.minimum(around, half - np.abs(points[:, 2])))
    beyond = points[:, 2] - np.clip(points[:, 2], -half, half)
    return np.asarray(
        form.radius - np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + beyond**2)
    )


@settings(deadline=None, max_examples=30)
@given(st.tuples(*[st.floats(-0.03, 0.03)] * 3))
def test_a_surface_goes_around_what_is_inside(point: tuple[float, ...]) -> None:
    body = box_mesh(0.03, 0.04, 0.05)
    triangles = body.vertices[body.faces]
    beyond = np.abs(point) - np.array([0.015, 0.02, 0.025])
    if np.abs(beyond).min() > 1e-6:
        inside = bool(np.all(beyond < 0.0))
        assert winding_number(np.array(point), triangles) == pytest.approx(
            float(inside), abs=1e-6
        )


def test_a_turned_peg_is_measured_in_its_own_frame() -> None:
    block = bored(0.005, 48, 0.02, 0.01)
    turned = from_rpy((0.2, -0.1, 0.3), (0.4, 0.5, 0.6))
    peg = thing(Cylinder(0.0051, 0.03), turned)
    assert overlap_depth(peg, thing(block, turned)) == pytest.approx(1e-4, abs=2e-6)


def test_what_may_be_is_what_was_said_and_rounding() -> None:
    pair = frozenset({"pin", "plate"})
    overlaps = Overlaps({pair: 2e-5})
    pin, plate = Cylinder(0.005, 0.03), thing(bored(0.004975, 32, 0.02, 0.01))
    for name, deep in (
        ("pin", {}),
        ("other", {"plate": pytest.approx(2.5e-5, abs=2e-6)}),
    ):
        assert overlaps.is_too_deep(name, thing(pin), {"plate": plate}) == deep
    words = Overlaps().words("pin", "plate", 3e-5)
    assert "0.03 mm" in words
    assert "fits: [{parts: [pin, plate], press_m: 3e-05}]" in words


DOWN = np.array([0.0, 0.0, -1.0])


def slot(width: float, walls: tuple[str, ...] = ("left", "right")) -> PlacedObject:
    """Return walls of 20 mm beside a slot around the origin."""
    places = {
        "left": (-1.0, 0.0),
        "right": (1.0, 0.0),
        "front": (0.0, -1.0),
        "back": (0.0, 1.0),
    }
    away = 0.5 * width + 0.01
    elements = []
    for name in walls:
        x, y = places[name]
        size = (0.02, 0.06, 0.02) if x else (0.06, 0.02, 0.02)
        elements.append(Element(Box(size), translation(away * x, away * y, 0.0)))
    return thing(shape_of("slot", elements))


@settings(deadline=None, max_examples=20)
@given(
    st.floats(0.0001, 0.001), st.floats(0.0, 0.9), st.floats(0.0, 6.3), st.booleans()
)
def test_a_peg_in_a_bore_can_go_as_far_as_the_circle_of_its_axis_reaches(
    room: float, share: float, turn: float, turned: bool
) -> None:
    at = from_rpy((0.1, 0.2, 0.3), (0.5, 0.4, 0.3)) if turned else np.eye(4)
    block = thing(bored(0.005, 48, 0.02, 0.02), at)
    off = share * room * np.array([math.cos(turn), math.sin(turn), 0.0])
    peg = thing(Cylinder(0.005 - room, 0.03), at @ translation(*off))
    found = play_in_place(peg, {"block": block}, at[:3, :3] @ DOWN)
    assert found is not None
    assert found.guides == ("block",)
    assert found.free.max() <= room * (1.0 + share) + 1e-6
    assert found.least == pytest.approx(room * (1.0 - share), abs=0.03 * room + 1e-6)
    # All around together they are the diameter, whichever way through the centre.
    chord = found.free + np.roll(found.free, 16)
    assert chord.max() <= 2.0 * room + 1e-6
    assert chord.min() >= 2.0 * room * math.sqrt(1.0 - share * share) - 1e-6


def test_play_is_that_between_walls_and_words_say_which() -> None:
    key = thing(Box((0.02, 0.02, 0.02)))
    for walls, words in (
        (("left", "right"), "0.40 mm from side to side"),
        (("left", "right", "front", "back"), "0.20 mm on all sides"),
    ):
        found = play_in_place(key, {"slot": slot(0.0204, walls)}, DOWN)
        assert found is not None
        assert found.words == words
    for few in (("left",), ("left", "front")):
        assert play_in_place(key, {"slot": slot(0.0204, few)}, DOWN) is None
    assert play_in_place(key, {"slot": slot(0.0304)}, DOWN) is None


def test_what_it_rests_on_does_not_hold_it_and_a_press_has_no_play() -> None:
    key = thing(Box((0.02, 0.02, 0.02)))
    table = thing(Box((1.0, 1.0, 0.02)), translation(0.0, 0.0, -0.02))
    assert play_in_place(key, {"table": table}, DOWN) is None
    found = play_in_place(key, {"table": table, "slot": slot(0.01996)}, DOWN)
    assert found is not None
    assert found.words == "pressed in by 0.02 mm"
    assert found.guides == ("slot",)
    assert found.chance(0.0001) is None


@pytest.mark.parametrize("repeatability", [0.0002, 0.0005, 0.002])
def test_the_chance_is_the_share_of_drawn_positions_that_fit(
    repeatability: float,
) -> None:
    """Positions are drawn in space; what is off along the way in does not matter."""
    spread = repeatability / ISO_9283
    drawn = spread * np.random.default_rng(5).standard_normal((200_000, 3))
    away = np.linalg.norm(drawn, axis=1)
    stated = away.mean() + 3.0 * away.std()
    assert stated == pytest.approx(repeatability, rel=0.01)
    room, off = 0.0003, np.array([0.0001, 0.00005])
    peg = thing(Cylinder(0.005 - room, 0.03), translation(off[0], off[1], 0.0))
    found = play_in_place(peg, {"block": thing(bored(0.005, 48, 0.02, 0.02))}, DOWN)
    assert found is not None
    fits = np.linalg.norm(drawn[:, :2] + off, axis=1) <= room
    assert found.chance(repeatability) == pytest.approx(fits.mean(), abs=0.006)


def test_who_repeats_exactly_always_fits() -> None:
    even = Play(np.full(32, 1e-4), ("block",))
    assert even.chance(0.0) == 1.0
    closer = [even.chance(r) for r in (1e-3, 1e-4, 1e-5)]
    assert closer == sorted(closer)  # type: ignore[type-var]
    assert closer[-1] == pytest.approx(1.0, abs=1e-9)
