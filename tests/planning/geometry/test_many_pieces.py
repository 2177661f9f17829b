"""A thing of several pieces is in the way exactly as its pieces would be, one by one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.shape import Box, Capsule, Cylinder, Element, shape_of
from planning.cell.workcell import (
    Attachment,
    CellObject,
    Fixture,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.scene_checker import SceneChecker
from planning.robots.registry import robot_model
from planning.transforms import from_rpy, readonly

MODEL = robot_model("gp4")
ROBOT = PlacedRobot("arm", MODEL, readonly(np.eye(4)), MODEL.home)
OTHER = PlacedRobot("other", MODEL, from_rpy((1.0, 0, 0), (0, 0, np.pi)), MODEL.home)

lengths = st.floats(0.02, 0.1)
forms = st.one_of(
    st.builds(lambda x, y, z: Box((x, y, z)), lengths, lengths, lengths),
    st.builds(Cylinder, lengths, lengths),
    st.builds(Capsule, lengths, lengths),
)
angles, near = st.floats(-3.0, 3.0), st.floats(-0.2, 0.2)
poses = st.builds(
    lambda *v: readonly(from_rpy(v[:3], v[3:])),
    near,
    near,
    near,
    angles,
    angles,
    angles,
)
elements = st.lists(st.builds(Element, forms, poses), min_size=2, max_size=4)
steps = st.tuples(*[st.floats(-0.6, 0.6)] * 6).map(np.array)
spots = st.builds(
    lambda x, y, z, a: readonly(from_rpy((x, y, z), (0, 0, a))),
    st.floats(0.2, 0.6), st.floats(-0.4, 0.4), st.floats(0.0, 0.6), angles,
)  # fmt: skip


def answers(things, fixtures, start, end, held=None, allowed=frozenset()):
    cell = Workcell((ROBOT, OTHER), fixtures, things)
    state = WorldState(
        {"arm": MODEL.home, "other": MODEL.home},
        {
            item.name: Attachment(
                held if item.name.startswith("held") else None, item.start
            )
            for item in things
        },
    )
    checker = SceneChecker(cell, "arm", state, allowed)
    free = checker.configuration_free(start), checker.motion_free(start, end)
    contact = checker.contact(start)
    return free, None if contact is None else contact.distance - contact.limit


def whole_and_apart(name, items, pose):
    """The thing as one, and its pieces as things of their own."""
    one = CellObject(name, "thing", shape_of(name, items), pose)
    apart = tuple(
        CellObject(f"{name}{k}", "thing", shape_of(name, [item]), pose)
        for k, item in enumerate(items)
    )
    return one, apart


@settings(max_examples=40, deadline=None)
@given(elements, spots, steps, steps)
def test_at_rest(items, pose, first, second):
    one, apart = whole_and_apart("thing", items, pose)
    start, end = MODEL.home + first, MODEL.home + second
    assert answers((one,), (), start, end) == answers(apart, (), start, end)
    # As fixtures, and allowed to touch one and all.
    fixed = (Fixture("thing", one.shape, pose),)
    several = tuple(Fixture(item.name, item.shape, pose) for item in apart)
    assert answers((), fixed, start, end) == answers((), several, start, end)
    whole = frozenset({frozenset(("arm/tool", "thing"))})
    each = frozenset(frozenset(("arm/tool", item.name)) for item in apart)
    assert answers((one,), (), start, end, allowed=whole) == answers(
        apart, (), start, end, allowed=each
    )


@pytest.mark.nightly
@settings(max_examples=30, deadline=None)
@given(elements, poses, spots, elements, steps, steps)
@pytest.mark.parametrize("holder", ["arm", "other"])
def test_in_a_hand(holder, items, grip, pose, around, first, second):
    one, apart = whole_and_apart("held", items, grip)
    rest, rests = whole_and_apart("thing", around, pose)
    start, end = MODEL.home + first, MODEL.home + second
    whole = frozenset({frozenset(("arm/tool", "held")), frozenset(("arm/arm", "held"))})
    each = frozenset(
        frozenset((own, item.name)) for item in apart for own in ("arm/tool", "arm/arm")
    )
    assert answers((one, rest), (), start, end, holder, whole) == answers(
        (*apart, *rests), (), start, end, holder, each
    )
