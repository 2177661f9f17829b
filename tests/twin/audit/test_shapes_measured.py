"""Shapes that are no boxes: two engines agree on them, and planning sees no more room than they do."""

import coal
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.shape import Box, Capsule, Cylinder, Element, Mesh, shape_of
from planning.cell.workcell import CellObject, Workcell
from planning.contacts.touching import near_to
from planning.transforms import from_rpy
from scheduling.verification.reference import measure, resting_parts
from tests.planning.cell.round_forms import stands_out
from twin.audit.worlds.engines import engine_named, open_world
from twin.audit.worlds.world import shapes_by_entity

needs_pybullet = pytest.mark.skipif(
    engine_named(None) != "pybullet", reason="PyBullet is not installed"
)
NEAR = 0.3
_WEDGE = trimesh.creation.icosphere(1, 0.06).apply_scale((1.0, 0.6, 0.4))


def wedge():
    corners = np.array(_WEDGE.vertices) + np.array([0.02, 0.0, 0.01])
    return Mesh(corners, np.array(_WEDGE.faces), (corners,), 1e-4, np.zeros(3))


lengths = st.floats(0.01, 0.15)
forms = st.one_of(
    st.builds(lambda x, y, z: Box((x, y, z)), lengths, lengths, lengths),
    st.builds(Cylinder, lengths, lengths),
    st.builds(Capsule, lengths, st.one_of(st.just(0.0), lengths)),
    st.builds(wedge),
)
turns, shifts = st.floats(-3.0, 3.0), st.floats(-0.1, 0.1)
poses = st.builds(
    lambda *v: from_rpy(v[:3], v[3:]), shifts, shifts, shifts, turns, turns, turns
)
compounds = st.lists(st.builds(Element, forms, poses), min_size=1, max_size=3)
places = st.builds(
    lambda x, y, z, *turn: from_rpy((2.5 * x, 2.5 * y, 2.5 * z), turn),
    *(shifts,) * 3,
    *(turns,) * 3,
)


def exact(one, other):
    """Return coal's distance of the forms themselves, one pair after another."""
    eye = np.eye(4)
    return min(
        measure(a, eye, b, eye)
        for a in resting_parts("a", one.shape, one.start)
        for b in resting_parts("b", other.shape, other.start)
    )


def engine_distance(world):
    by_name = shapes_by_entity(world.objects)
    return min(
        world.distance(a, b, NEAR) for a in by_name["one"] for b in by_name["other"]
    )


@needs_pybullet
@settings(max_examples=60, deadline=None)
@given(compounds, compounds, places, places)
def test_engines_and_planning_agree_on_compounds(first, second, at, there):
    one = CellObject("one", "part", shape_of("one", first), at)
    other = CellObject("other", "part", shape_of("other", second), there)
    cell = Workcell((), (), (one, other))
    found = []
    for engine in ("pybullet", "coal"):
        world = open_world(cell, engine)
        found.append(engine_distance(world))
        world.close()
    bullet, by_coal = found
    true = exact(one, other)
    assert by_coal == pytest.approx(min(true, NEAR), abs=1e-5)
    if true > 0.0:
        assert bullet == pytest.approx(by_coal, abs=2e-4)
    else:
        assert bullet <= 2e-4
    seen = near_to((one, at), {"other": (other, there)}, NEAR).get("other", NEAR)
    out = max(
        [0.0]
        + [
            stands_out(item.form)
            for item in (*first, *second)
            if isinstance(item.form, Cylinder | Capsule)
        ]
    )
    if true > 0.0:
        # Planning never sees more room than there is, and no less than it says.
        assert seen <= min(true, NEAR) + 1e-5
        assert seen >= min(true, NEAR) - 2.0 * out - 1e-5


@pytest.mark.parametrize(
    ("radius", "length", "ball"), [(0.125, 0.125, 0.125), (0.15, 0.01, 0.1)]
)
def test_a_ball_in_the_middle_of_a_disc_leaves_it_through_an_end(radius, length, ball):
    eye = np.eye(4)
    shapes = [
        shape_of(name, [Element(form, eye)])
        for name, form in (
            ("disc", Cylinder(radius, length)),
            ("ball", Capsule(ball, 0.0)),
        )
    ]
    disc, inside = (
        CellObject(s, "part", shape, eye)
        for s, shape in zip(("one", "other"), shapes, strict=True)
    )
    depth = pytest.approx(-(0.5 * length + ball), abs=1e-5)
    assert exact(disc, inside) == depth
    world = open_world(Workcell((), (), (disc, inside)), "coal")
    assert engine_distance(world) == depth
    world.close()


def test_a_pin_fits_a_hole_that_is_a_little_wider():
    """Round against flat: exact forms keep apart what polyhedra would let touch."""
    pin = CellObject(
        "one",
        "pin",
        shape_of("pin", [Element(Cylinder(0.01, 0.05), np.eye(4))]),
        np.eye(4),
    )
    wall = Box((0.02, 0.1, 0.1))
    gap = 5e-5
    for angle in np.linspace(0.0, np.pi, 7):
        at = from_rpy((0, 0, 0), (0, 0, angle)) @ from_rpy(
            (0.02 + gap, 0, 0), (0, 0, 0)
        )
        other = CellObject(
            "other", "wall", shape_of("w", [Element(wall, np.eye(4))]), at
        )
        assert exact(pin, other) == pytest.approx(gap, abs=1e-6)
        world = open_world(Workcell((), (), (pin, other)), "coal")
        assert engine_distance(world) == pytest.approx(gap, abs=1e-6)
        world.close()
    assert isinstance(resting_parts("p", pin.shape, np.eye(4))[0].shape, coal.Cylinder)
