"""Joints across air: refused with what is nearest, unless the joint says its room; and what bears there."""

from __future__ import annotations

import math
import re

import pytest

from planning.cell.workcell import Workcell
from planning.errors import InfeasibleStepError
from planning.parts.assembly import PartAssembly
from planning.parts.balance import PartBalance
from planning.parts.order import in_found_order
from planning.parts.part_steps import part_steps, wide_joints
from planning.statics.standing import Joint, StandingRules
from planning.transforms import translation
from tests.planning.parts.boxes import Three, built, fixture, part, table

SIZES = {"post": (0.1, 0.1, 0.1), "bar": (0.4, 0.04, 0.04), "tie": (0.04, 0.04, 0.04)}
# A table whose top is at 0, a wall whose face is at x = 0.5, and parts far away.
CELL = Workcell(
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
    ((_, words),) = wide_joints(CELL, joined((BASE, joint), bar=goal))
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
    assert not list(wide_joints(CELL, joined((BASE, joint), bar=goal)))


def test_a_part_that_touches_nothing_is_refused_with_what_is_nearest() -> None:
    with pytest.raises(
        InfeasibleStepError, match=r"in the air.*nearest to bar is post, 50.0 mm away"
    ):
        part_steps(CELL, joined((), bar=(0.2, 0.0, 0.08)))


def test_parts_that_need_each_other_are_told_how_far_they_are_from_what_stands() -> (
    None
):
    """Bar and tie touch each other, 30 mm above the table: joined to it over that room, they stand."""
    goals = {"bar": (0.0, 0.0, 0.05), "tie": (0.0, 0.0, 0.09)}
    loose = joined((), ("tie", "bar"), **goals)
    with pytest.raises(InfeasibleStepError) as caught:
        in_found_order(CELL, loose)
    text = str(caught.value)
    assert "needs one of these before it" in text
    assert "nearest is bar, 30.0 mm from table (touch_m 0.002)" in text
    assert "(joined: {parts: [bar, table], gap_m: 0.03})" in text
    held = joined((Joint("bar", "table", gap=0.03),), ("tie", "bar"), **goals)
    found = in_found_order(CELL, held)
    assert found.placed == ("bar", "tie")
    assert not list(wide_joints(CELL, found))


@pytest.mark.parametrize(("torque", "stands"), [(2.7, True), (2.1, False)])
def test_a_joint_across_a_gap_bears_where_the_gap_is(
    torque: float, stands: bool
) -> None:
    """1 kg whose middle is 0.24 m from the middle of a gap of 40 mm at the wall bends it with 2.4 N m."""
    joint = Joint("bar", "wall", math.inf, torque, gap=0.04)
    assembly = joined((joint,), ("bar",), bar=(0.26, 0.0, 0.3))
    assert assembly.balance is not None
    steps = part_steps(CELL, assembly)
    fall = PartBalance(CELL, steps, assembly.balance).fall
    assert (fall is None) == stands
