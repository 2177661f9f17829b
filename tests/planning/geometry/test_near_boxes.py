"""What is left out of a scene is too far away to matter, and checkers share their memory rightly.

A thing of several pieces is in the way exactly as its pieces would be, one by one.
"""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.shape import Box, Capsule, Cylinder, Element, box_shape, shape_of
from planning.cell.workcell import (
    Attachment,
    CellObject,
    Clearances,
    Fixture,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.robot_bodies import robot_bodies
from planning.geometry.scene_checker import SceneChecker
from planning.geometry.standing import stand_boxes
from planning.geometry.swept import boxes_in_reach, make_swept
from planning.robots.registry import robot_model
from planning.transforms import Array, Transform, from_rpy, read_only_copy, translation

MODEL = robot_model("gp4")
ROBOT = PlacedRobot("arm", MODEL, read_only_copy(np.eye(4)), MODEL.home)
OTHER = PlacedRobot("other", MODEL, read_only_copy(translation(0.8, 0, 0)), MODEL.home)


def brick(name: str, x: float, y: float, z: float) -> CellObject:
    size = read_only_copy([0.016, 0.032, 0.0096])
    return CellObject(
        name, "2x4", box_shape(name, size), read_only_copy(translation(x, y, z))
    )


def checker(
    items: Sequence[CellObject],
    allowed: frozenset[frozenset[str]] = frozenset(),
    held: str | None = None,
) -> SceneChecker:
    state = WorldState(
        {"arm": MODEL.home, "other": MODEL.home},
        {
            item.name: Attachment("arm" if item.name == held else None, item.start)
            for item in items
        },
    )
    cell = Workcell((ROBOT, OTHER), (), tuple(items), Clearances(0.001, 0.0))
    return SceneChecker(cell, "arm", state, allowed, margin=0.0005)


turns = st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6)
places = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0, 0.7))


@settings(max_examples=40, deadline=None)
@given(turns, turns, st.lists(places, min_size=1, max_size=40, unique=True))
def test_whoever_touches_is_in_reach(
    first: list[float], last: list[float], where: list[tuple[float, float, float]]
) -> None:
    """Bricks left out one and all do not change what a checker finds."""
    path = np.array([MODEL.home + first, MODEL.home + last])
    items = [brick(f"b{k}", *p) for k, p in enumerate(where)]
    boxes = stand_boxes((), [p for i in items for p in i.shape.placed(i.name, i.start)])
    near = np.zeros(len(boxes.pose), dtype=np.bool_)
    boxes_in_reach(
        make_swept(robot_bodies(ROBOT).hulls),
        path,
        boxes.pose,
        boxes.half,
        boxes.bounds,
        0.0005,
        near,
    )
    kept = [item for item, close in zip(items, near, strict=True) if close]
    assert checker(items).motion_free(*path) == checker(kept).motion_free(*path)
    left_out = [item for item, close in zip(items, near, strict=True) if not close]
    alone = checker([]).motion_free(*path)
    assert checker(left_out).motion_free(*path) == alone


@settings(max_examples=25, deadline=None)
@given(turns, st.booleans())
def test_other_allowed_contacts_make_the_same_checker_as_a_new_one(
    turn: list[float], held: bool
) -> None:
    """A brick right at the tool's tip: in the way, unless the two may touch."""
    q = MODEL.home + np.array(turn)
    tip = robot_tip(MODEL.home)
    items = [brick("near", *tip), brick("far", 0.0, 0.4, 0.1)]
    allowed = frozenset({frozenset({"arm/tool", "near"})})
    holder = "far" if held else None
    strict, free = checker(items, held=holder), checker(items, allowed, held=holder)
    derived, back = strict.with_allowed(allowed), free.with_allowed(frozenset())
    for a, b in ((derived, free), (back, strict)):
        for end in (q, MODEL.home):
            assert a.configuration_free(end) == b.configuration_free(end)
            assert str(a.contact(end)) == str(b.contact(end))
    assert not strict.configuration_free(MODEL.home)


@settings(max_examples=40, deadline=None)
@given(turns, st.lists(places, min_size=17, max_size=60, unique=True))
def test_many_boxes_are_each_looked_at(
    turn: list[float], where: list[tuple[float, float, float]]
) -> None:
    """Boxes are passed by in groups: what is found among many is what is found of each alone."""
    path = np.array([MODEL.home, MODEL.home + np.array(turn)])
    items = [brick(f"b{k}", *p) for k, p in enumerate(where)]
    alone = [checker([item]).motion_free(*path) for item in items]
    assert checker(items).motion_free(*path) == all(alone)
    hit = [str(checker([item]).contact(path[1])) for item in items]
    found = str(checker(items).contact(path[1]))
    assert found in hit


def robot_tip(q: Array) -> Array:
    from planning.kinematics.kinematics import frame_pose

    return frame_pose(ROBOT, q, "tool")[:3, 3]


@settings(max_examples=25, deadline=None)
@given(turns, st.lists(places, min_size=3, max_size=12, unique=True), st.booleans())
def test_a_checker_without_some_bricks_is_the_one_that_never_had_them(
    turn: list[float], where: list[tuple[float, float, float]], allow: bool
) -> None:
    path = np.array([MODEL.home, MODEL.home + np.array(turn)])
    tip = robot_tip(MODEL.home)
    items = [brick(f"b{k}", *p) for k, p in enumerate(where)]
    items += [brick("tip", *tip), brick("aside", tip[0] + 0.004, tip[1], tip[2])]
    pairs = frozenset({frozenset({"arm/tool", "aside"})} if allow else ())
    full = checker(items, pairs)
    gone = {"tip", "b0", "b2"}
    fewer = checker([item for item in items if item.name not in gone], pairs)
    derived = full.without(["tip", "b0"]).without(["b2"])
    swapped = derived.with_allowed(frozenset()).with_allowed(pairs)
    for again in (derived, swapped):
        assert again.motion_free(*path) == fewer.motion_free(*path)
        for q in path:
            assert str(again.contact(q)) == str(fewer.contact(q))
    assert not full.configuration_free(MODEL.home)


def test_objects_that_move_are_seen_where_they_are_now() -> None:
    """The same mapping with another place in it is another scene."""
    item = brick("near", *robot_tip(MODEL.home))
    cell = Workcell((ROBOT, OTHER), (), (item,), Clearances(0.001, 0.0))
    places_now = {"near": Attachment(None, item.start)}
    state = WorldState({"arm": MODEL.home, "other": MODEL.home}, places_now)
    assert not SceneChecker(cell, "arm", state).configuration_free(MODEL.home)
    places_now["near"] = Attachment(None, read_only_copy(translation(0.0, 0.4, 0.1)))
    assert SceneChecker(cell, "arm", state).configuration_free(MODEL.home)
    del places_now["near"]
    assert SceneChecker(cell, "arm", state).configuration_free(MODEL.home)


SECOND = PlacedRobot("other", MODEL, from_rpy((1.0, 0, 0), (0, 0, np.pi)), MODEL.home)

lengths = st.floats(0.02, 0.1)
forms = st.one_of(
    st.builds(lambda x, y, z: Box((x, y, z)), lengths, lengths, lengths),
    st.builds(Cylinder, lengths, lengths),
    st.builds(Capsule, lengths, lengths),
)
angles, near = st.floats(-3.0, 3.0), st.floats(-0.2, 0.2)
poses = st.builds(
    lambda *v: read_only_copy(from_rpy(v[:3], v[3:])),
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
    lambda x, y, z, a: read_only_copy(from_rpy((x, y, z), (0, 0, a))),
    st.floats(0.2, 0.6), st.floats(-0.4, 0.4), st.floats(0.0, 0.6), angles,
)  # fmt: skip


def answers(
    things: tuple[CellObject, ...],
    fixtures: tuple[Fixture, ...],
    start: Array,
    end: Array,
    held: str | None = None,
    allowed: frozenset[frozenset[str]] = frozenset(),
) -> tuple[tuple[bool, bool], float | None]:
    cell = Workcell((ROBOT, SECOND), fixtures, things)
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


def whole_and_apart(
    name: str, items: Sequence[Element], pose: Transform
) -> tuple[CellObject, tuple[CellObject, ...]]:
    """The thing as one, and its pieces as things of their own."""
    one = CellObject(name, "thing", shape_of(name, items), pose)
    apart = tuple(
        CellObject(f"{name}{k}", "thing", shape_of(name, [item]), pose)
        for k, item in enumerate(items)
    )
    return one, apart


@settings(max_examples=40, deadline=None)
@given(elements, spots, steps, steps)
def test_at_rest(
    items: list[Element], pose: Transform, first: Array, second: Array
) -> None:
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
def test_in_a_hand(
    holder: str,
    items: list[Element],
    grip: Transform,
    pose: Transform,
    around: list[Element],
    first: Array,
    second: Array,
) -> None:
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
