"""Balance of assemblies: what falls is refused with what helps, what props it up comes before."""

import math
import re
from dataclasses import replace

import pytest

from planning.cell.workcell import Workcell
from planning.errors import InfeasibleStepError
from planning.parts.assembly import PartAssembly
from planning.parts.balance import PartBalance
from planning.parts.order import order_steps_by_search
from planning.parts.part_steps import part_steps, wide_joints
from planning.statics.standing_rules import Joint, StandingRules
from planning.transforms import translation
from tests.planning.parts.boxes import Three, built, fixture, part, table

RULES = StandingRules()


AWAY = translation(2.0, 2.0, 5.0)
PARTS = (
    part("post", (0.1, 0.1, 0.1), AWAY),
    part("beam", (0.5, 0.1, 0.02), AWAY),
    part("prop", (0.02, 0.1, 0.1), AWAY),
    part("load", (0.05, 0.05, 0.05), AWAY, 3.0),
)
GOALS = {
    "post": translation(0.0, 0.0, 0.05),
    "beam": translation(0.15, 0.0, 0.11),
    "prop": translation(0.35, 0.0, 0.05),
    "load": translation(0.3, 0.0, 0.145),
}
CELL = Workcell((), (table(),), PARTS)


def assembly(*names: str, rules: StandingRules = RULES) -> PartAssembly:
    return built(GOALS, *names, balance=rules)


def balance(found: PartAssembly) -> PartBalance:
    assert found.balance is not None
    return PartBalance(CELL, part_steps(CELL, found), found.balance)


def test_a_cantilever_is_refused_with_the_step_the_part_and_what_helps() -> None:
    found = balance(assembly("post", "beam", "prop", "load"))
    with pytest.raises(InfeasibleStepError) as caught:
        found.stable_build()
    text = str(caught.value)
    assert text.startswith(
        "step 2 (pick and place beam): beam would not stand after it"
    )
    assert "no forces between it and post keep it in balance" in text
    assert "joined: [[post, beam]]" in text
    assert "place prop before" in text
    assert "let a later step join it" in text


def test_what_is_propped_waits_for_its_prop() -> None:
    waits = balance(assembly("post", "prop", "beam", "load")).stable_build().waits
    # The beam touches the prop and waits for it anyway; nothing more is needed.
    assert waits == frozenset()


def test_a_joint_does_instead_of_a_prop_as_far_as_it_bears() -> None:
    for torque in (5.0, 12.0, math.inf):
        neck = Joint("post", "beam", 1.0, torque)
        rules = replace(RULES, joints=(Joint("table", "post"), neck))
        fall = balance(assembly("post", "beam", "load", rules=rules)).fall
        # 3 kg at 0.25 m and 1 kg at 0.1 m from the edge of the post: 8.3 N m.
        assert (fall is None) == (torque > 8.3)
        assert fall is None or (fall.step, fall.body) == (2, "beam")


def test_what_a_later_step_joins_is_kept_hold_of_until_then() -> None:
    late = replace(
        RULES,
        joints=(Joint("table", "post"), Joint("post", "beam", by="prop")),
    )
    found = balance(assembly("post", "beam", "prop", rules=late))
    assert found.fall is None
    assert found.stable_build().keeps == {1: 2}


def test_an_order_is_found_in_which_everything_stands() -> None:
    listed = assembly("load", "beam", "prop", "post")
    found = order_steps_by_search(CELL, listed)
    assert balance(found).fall is None
    order = list(found.placed)
    assert order.index("prop") < order.index("beam") < order.index("load")
    blind = order_steps_by_search(CELL, replace(listed, balance=None))
    assert set(blind.placed) == set(order)


def test_what_touches_nothing_may_stand_where_it_is_joined() -> None:
    goals = {**GOALS, "beam": translation(0.15, 0.0, 0.13)}
    free = built(goals, "post", "beam", balance=RULES)
    with pytest.raises(InfeasibleStepError, match="in the air"):
        part_steps(CELL, free)
    joints = (Joint("table", "post"), Joint("post", "beam", gap=0.02))
    joined = replace(free, balance=replace(RULES, joints=joints))
    assert balance(joined).stable_build().waits == {(0, 1)}


SIZES = {"post": (0.1, 0.1, 0.1), "bar": (0.4, 0.04, 0.04), "tie": (0.04, 0.04, 0.04)}
# A table whose top is at 0, a wall whose face is at x = 0.5, and parts far away.
GAP_CELL = Workcell(
    (),
    (table(), fixture("wall", (0.1, 1.0, 1.0), (0.55, 0.0, 0.5))),
    tuple(
        part(name, size, translation(3.0, k, 5.0), 1.0)
        for k, (name, size) in enumerate(SIZES.items())
    ),
)


def joined(
    joints: tuple[Joint, ...], steps: tuple[str, ...] = ("post", "bar"), **goals: Three
) -> PartAssembly:
    """A post on the table, and a bar beside it whose end is 0.1 m from the wall at x = 0."""
    where = {"post": (-0.1, 0.0, 0.05), "bar": (0.2, 0.0, 0.12), **goals}
    at = {name: translation(*where[name]) for name in steps}
    return built(at, *steps, balance=StandingRules(joints=joints))


BASE = Joint("table", "post")


@pytest.mark.parametrize(
    ("joint", "goal", "said"),
    [
        (
            Joint("post", "bar"),
            (0.2, 0.0, 0.08),
            r"post and bar are joined across 50.0 mm of air, and may be 2 mm apart.*gap_m: 0.05}\); of all else nearest to bar is table, 60.0 mm away",
        ),
        (
            Joint("bar", "wall"),
            (0.26, 0.0, 0.3),
            r"bar and wall are joined across 40.0 mm of air.*gap_m: 0.04}\)",
        ),
        (
            Joint("table", "bar"),
            (0.0, 0.0, 0.32),
            r"table and bar are joined across 300.0 mm of air.*nearest to bar is",
        ),
        (
            Joint("post", "bar", gap=0.03),
            (0.2, 0.0, 0.08),
            r"across 50.0 mm of air, and may be 32 mm apart \(touch_m 0.002, gap_m 0.03\)",
        ),
    ],
)
def test_what_is_joined_across_air_is_refused_with_how_far_it_is(
    joint: Joint, goal: Three, said: str
) -> None:
    ((_, words),) = wide_joints(GAP_CELL, joined((BASE, joint), bar=goal))
    assert re.search(said, words)


@pytest.mark.parametrize(
    ("joint", "goal"),
    [
        (Joint("post", "bar"), (0.1515, 0.0, 0.05)),
        (Joint("post", "bar"), (0.14, 0.0, 0.05)),
        (Joint("post", "bar", gap=0.05), (0.2, 0.0, 0.08)),
        (Joint("bar", "wall", gap=0.04), (0.26, 0.0, 0.3)),
    ],
)
def test_what_is_as_near_as_its_joint_says_is_joined(joint: Joint, goal: Three) -> None:
    assert not list(wide_joints(GAP_CELL, joined((BASE, joint), bar=goal)))


def test_a_part_that_touches_nothing_is_refused_with_what_is_nearest() -> None:
    with pytest.raises(
        InfeasibleStepError, match=r"in the air.*nearest to bar is post, 50.0 mm away"
    ):
        part_steps(GAP_CELL, joined((), bar=(0.2, 0.0, 0.08)))


def test_parts_that_need_each_other_are_told_how_far_they_are_from_what_stands() -> (
    None
):
    """Bar and tie touch each other, 30 mm above the table: joined to it over that room, they stand."""
    goals = {"bar": (0.0, 0.0, 0.05), "tie": (0.0, 0.0, 0.09)}
    loose = joined((), ("tie", "bar"), **goals)
    with pytest.raises(InfeasibleStepError) as caught:
        order_steps_by_search(GAP_CELL, loose)
    text = str(caught.value)
    assert "needs one of these before it" in text
    assert "nearest is bar, 30.0 mm from table (touch_m 0.002)" in text
    assert "(joined: {parts: [bar, table], gap_m: 0.03})" in text
    held = joined((Joint("bar", "table", gap=0.03),), ("tie", "bar"), **goals)
    found = order_steps_by_search(GAP_CELL, held)
    assert found.placed == ("bar", "tie")
    assert not list(wide_joints(GAP_CELL, found))


@pytest.mark.parametrize(("torque", "stands"), [(2.7, True), (2.1, False)])
def test_a_joint_across_a_gap_bears_where_the_gap_is(
    torque: float, stands: bool
) -> None:
    """1 kg whose middle is 0.24 m from the middle of a gap of 40 mm at the wall bends it with 2.4 N m."""
    joint = Joint("bar", "wall", math.inf, torque, gap=0.04)
    assembly = joined((joint,), ("bar",), bar=(0.26, 0.0, 0.3))
    assert assembly.balance is not None
    steps = part_steps(GAP_CELL, assembly)
    fall = PartBalance(GAP_CELL, steps, assembly.balance).fall
    assert (fall is None) == stands
