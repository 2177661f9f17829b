"""Orders that are found: against brute force, against what lies on what, and past what blocks."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.contacts.precedence import StepPrecedence
from planning.errors import InfeasibleStepError
from planning.grips.grip import GripRules
from planning.parts.assembly import (
    PartHandling,
    Process,
    Spot,
    Work,
)
from planning.parts.order import find_ordered_candidates, in_found_order
from planning.transforms import translation
from tests.planning.parts.boxes import built, part, two_arms
from tests.planning.parts.test_part_steps import crossing, two_arms_and_rods


@st.composite
def precedences(draw: st.DrawFn) -> StepPrecedence:
    count = draw(st.integers(1, 6))
    others = st.sets(st.integers(0, count - 1), max_size=3)
    before = tuple(dict.fromkeys(draw(others) - {k}, "so") for k in range(count))
    any_of = tuple(frozenset(draw(others) - {k}) for k in range(count))
    return StepPrecedence(tuple(map(str, range(count))), before, any_of)


def keeps(known: StepPrecedence, order: tuple[int, ...]) -> bool:
    for k, step in enumerate(order):
        done = set(order[:k])
        if not known.before[step].keys() <= done:
            return False
        if known.any_of[step] and not known.any_of[step] & done:
            return False
    return True


@given(precedences())
@settings(max_examples=300)
def test_the_order_is_the_first_of_all_that_keep_what_is_known(
    known: StepPrecedence,
) -> None:
    every = permutations(range(len(known.before)))
    expected = min((order for order in every if keeps(known, order)), default=None)
    assert known.order() == expected
    if expected is None:
        assert known.explained()


SIDE = 0.04


@given(st.permutations(range(6)), st.sets(st.integers(0, 5), max_size=6))
@settings(max_examples=60, deadline=None)
def test_blocks_are_stacked_from_below_whatever_the_list(
    listed: list[int], reversed_: set[int]
) -> None:
    """Two columns of three, whose stock lies in columns too: who is on top is taken first."""
    names = [f"{column}{level}" for column in "ab" for level in range(3)]
    goals, starts = {}, {}
    for k, name in enumerate(names):
        column, level = divmod(k, 3)
        goals[name] = translation(0.2 * column, 0.0, SIDE * (level + 0.5))
        turned = k in reversed_
        starts[name] = (
            translation(0.2 * column, 0.5, SIDE * (2.5 - level))
            if {3 * column, 3 * column + 1, 3 * column + 2} <= reversed_
            else translation(0.2 * column, -0.3 - 0.1 * level - 0.02 * turned, 0.02)
        )
    blocks = (part(n, (SIDE, SIDE, SIDE), starts[n], 0.05) for n in names)
    cell = replace(two_arms(), objects=tuple(blocks))
    order = in_found_order(cell, built(goals, *(names[k] for k in listed))).placed
    assert sorted(order) == names
    for column in "ab":
        assert [n for n in order if n[0] == column] == [
            f"{column}{k}" for k in range(3)
        ]


def test_what_cannot_follow_is_explained() -> None:
    cell, assembly = two_arms_and_rods(), crossing("south", "north", "across")
    south, north, across = assembly.steps
    circle = replace(assembly, steps=(replace(south, after=("across",)), north, across))
    with pytest.raises(InfeasibleStepError, match="across rests on south"):
        in_found_order(cell, circle)
    hanging = replace(assembly, steps=(across, replace(south, part="aside", name="b")))
    with pytest.raises(InfeasibleStepError, match="in the air"):
        find_ordered_candidates(cell, hanging)


def test_a_process_comes_after_its_part_and_before_what_covers_it() -> None:
    cell, assembly = two_arms_and_rods(), crossing("across", "north", "south")
    hole = Work(
        process=Process("screw"),
        spot=Spot("south/hole", "south", None, translation(0.0, 0.0, 0.012)),
    )
    order = in_found_order(cell, replace(assembly, steps=(*assembly.steps, hole)))
    words = [step.words for step in order.steps]
    assert words == [
        "pick and place north",
        "pick and place south",
        "screw south/hole",
        "pick and place across",
    ]


def test_a_part_goes_in_before_walls_between_which_no_hand_fits() -> None:
    """Nothing but a hand in the way tells that the low block comes before the walls."""
    wall = (0.1, 0.024, 0.12)
    goals = {
        "left": translation(0.0, -0.03, 0.0605),
        "right": translation(0.0, 0.03, 0.0605),
        "low": translation(0.0, 0.0, 0.0125),
    }
    objects = (
        part("left", wall, translation(-0.1, -0.4, 0.0605), 0.05),
        part("right", wall, translation(0.1, 0.4, 0.0605), 0.05),
        part("low", (0.1, 0.024, 0.024), translation(-0.1, 0.4, 0.0125), 0.05),
    )
    cell = replace(two_arms(), objects=objects)
    assembly = built(goals, *goals, usual=PartHandling(GripRules(positions=1)))
    assert in_found_order(cell, assembly).placed == ("left", "right", "low")
    found = find_ordered_candidates(cell, assembly)
    assert found.problem.impossible == ()
    assert found.problem.steps[0] == "pick and place low"
