"""Helpers that can be taken out of a structure again, against all orders and boxes in motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import InfeasibleStepError
from planning.lego.bricks.assembly import BRICKS, PlacedBrick
from planning.lego.insertion.rules import SequencingRules
from planning.lego.sequencing.remedies import shut_in
from planning.lego.sequencing.sequencing import sequence_structure
from tests.planning.lego.structures import brick, scattered

_STUD = 0.53
"""Height of a stud, in levels of 3.2 mm."""

_EPS = 0.01


def _boxes(item: PlacedBrick, studs: bool) -> np.ndarray:
    """Return the body of a brick as a box, and its studs as boxes, shape (n, 2, 3) [studs, levels]."""
    s = item.span
    out = [((s.x0, s.y0, s.bottom), (s.x1, s.y1, s.top))]
    if studs:
        out += [
            ((x + 0.2, y + 0.2, s.top), (x + 0.8, y + 0.8, s.top + _STUD))
            for x, y in item.studs
        ]
    return np.array(out, dtype=float)


def _meet(a: np.ndarray, b: np.ndarray) -> bool:
    low = np.maximum(a[:, None, 0], b[None, :, 0])
    high = np.minimum(a[:, None, 1], b[None, :, 1])
    return bool(np.any(np.all(high - low > _EPS, axis=2)))


def _gets_out(item: PlacedBrick, others: Sequence[PlacedBrick]) -> bool:
    """Tell whether boxes get out, moving along one axis at a time; each move is a box of its own."""
    seen, todo = {(0, 0, 0)}, [(0, 0, 0)]
    while todo:
        at = todo.pop()
        if max(map(abs, at[:2])) > 12 or abs(at[2]) > 30:
            return True
        for way in np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)]):
            upright = way[2] != 0
            # Knobs slide up and down in what they go into, and nowhere else.
            own = _boxes(item, not upright) + np.array(at)
            moved = own + way
            swept = np.stack(
                [
                    np.minimum(own[:, 0], moved[:, 0]),
                    np.maximum(own[:, 1], moved[:, 1]),
                ],
                axis=1,
            )
            after = tuple((np.array(at) + way).tolist())
            if after in seen or any(
                _meet(swept, _boxes(other, not upright)) for other in others
            ):
                continue
            seen.add(after)
            todo.append(after)
    return False


def _most_taken(bricks: Sequence[PlacedBrick], helpers: Sequence[str]) -> set[str]:
    """Return the helpers that remain in the best order of all."""
    best = set(helpers)
    for order in permutations(helpers):
        there, left = {item.name: item for item in bricks}, set(helpers)
        for name in order:
            item = there.pop(name)
            if not _gets_out(item, list(there.values())):
                break
            left.discard(name)
        if len(left) < len(best):
            best = left
    return best


@settings(max_examples=40, deadline=None)
@given(
    scattered(
        {k: BRICKS[k] for k in ("1x1", "1x2", "2x2")}, 9, (0, 2), st.integers(0, 7)
    ),
    st.sets(st.integers(0, 8), min_size=1, max_size=3),
)
def test_those_that_stay_are_those_of_the_best_order(bricks, chosen):
    helpers = [item.name for k, item in enumerate(bricks) if k in chosen]
    found = shut_in(bricks, frozenset(helpers))
    assert {item.brick.name for item in found} == _most_taken(bricks, helpers)
    for item in found:
        assert item.behind
        assert item.brick not in item.behind


def _bridge(lift: int) -> list[PlacedBrick]:
    """Two posts with a roof, and a brick that hangs from it over the floor or over the plate."""
    floor = [brick("floor", "2x6", 20, 20, 1, True)] if lift else []
    z = 1 + lift
    return [
        *floor,
        brick("post1", "2x2", 20, 20, z),
        brick("post2", "2x2", 24, 20, z),
        brick("post3", "2x2", 20, 20, z + 1),
        brick("post4", "2x2", 24, 20, z + 1),
        brick("lamp", "2x2", 22, 20, z + 1),
        brick("roof", "2x6", 20, 20, z + 2, True),
    ]


def test_a_helper_between_a_floor_and_what_hangs_is_shut_in():
    enclosed = [
        brick("floor", "2x6", 20, 20, 1, True),
        brick("post1", "2x2", 20, 20, 2),
        brick("post2", "2x2", 24, 20, 2),
        brick("helper", "2x2", 22, 20, 2),
        brick("lamp", "2x2", 22, 20, 3),
        brick("roof", "2x6", 20, 20, 4, True),
    ]
    (found,) = shut_in(enclosed, frozenset(["helper"]))
    assert found.words.startswith("'helper' (2x2 at [22, 20, 2]) is shut in behind")
    assert [item.name for item in found.behind[:2]] == ["floor", "lamp"]
    # Without the floor it comes off from below.
    assert not shut_in(enclosed[1:], frozenset(["helper"]))


def test_rules_may_ask_for_helpers_that_come_out_again():
    rules = SequencingRules(scaffold=True, place_up=False, support=False)
    asked = SequencingRules(
        scaffold=True, removable=True, place_up=False, support=False
    )
    over_plate = sequence_structure(_bridge(0), rules=asked)
    assert sum(item.step.temporary for item in over_plate.sequence) == 1
    assert over_plate.shut_in == ()
    over_floor = sequence_structure(_bridge(1), rules=rules)
    (found,) = over_floor.shut_in
    assert {"floor", "lamp"} <= {item.name for item in found.behind}
    with pytest.raises(InfeasibleStepError) as caught:
        sequence_structure(_bridge(1), rules=asked)
    assert "'lamp'" in str(caught.value)
    assert "with bricks that stay shut in (1 of them)" in str(caught.value)


def test_a_column_that_comes_out_again_is_preferred():
    """Of two places below a beam the wider one is over a floor, the other over the plate."""
    structure = [
        brick("floor", "2x4", 20, 20, 1),
        brick("post1", "2x2", 20, 20, 2),
        brick("post2", "2x2", 20, 20, 3),
        brick("arm", "2x4", 20, 22, 3),
        brick("roof", "2x6", 20, 20, 4),
    ]
    found = sequence_structure(
        structure,
        rules=SequencingRules(scaffold=True, place_up=False, support=False),
    )
    helpers = [item for item in found.sequence if item.step.temporary]
    assert helpers
    assert found.shut_in == ()
    assert all(item.step.cell.y >= 24 for item in helpers)


def test_helpers_that_are_chosen_already_stay_helpers():
    structure = _bridge(0)
    first = sequence_structure(structure, rules=SequencingRules(scaffold=True))
    chosen = [
        PlacedBrick(item.name, item.step.brick, item.step.cell)
        for item in first.sequence
        if item.step.temporary
    ]
    again = sequence_structure(structure, helpers=chosen)
    assert [item.name for item in again.sequence if item.step.temporary] == [
        item.name for item in chosen
    ]


@pytest.mark.parametrize("aside", [0, 1])
def test_a_leaning_tower_is_carried_from_beside_it(aside: int) -> None:
    """Bricks of its own type do not fit below what sticks out: they stick out themselves."""
    tower = [brick(f"b{k}", "2x2", 20 + k, 20 + aside * k, 1 + k) for k in range(4)]
    rules = SequencingRules(
        scaffold=True, place_up=False, support=False, types=(BRICKS["2x2"],)
    )
    with pytest.raises(InfeasibleStepError, match="no order of assembly exists"):
        sequence_structure(tower, rules=rules)
    ground = frozenset(product(range(18, 28), repeat=2))
    found = sequence_structure(tower, rules=replace(rules, ground=ground))
    own = {stud for item in tower for stud in item.studs}
    filled: set[tuple[int, int, int]] = set()
    for item in found.sequence:
        placed = PlacedBrick(item.name, item.step.brick, item.step.cell)
        assert placed.studs <= ground | own
        assert filled.isdisjoint(placed.places)
        filled |= placed.places
    assert any(item.step.temporary for item in found.sequence)
    assert found.shut_in == ()
