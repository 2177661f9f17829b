"""Sequences and blocking sets against all permutations, and remedies of blocked structures."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, combinations, permutations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import InfeasibleStepError
from planning.lego.bricks.assembly import BRICKS, Cell, PlacedBrick
from planning.lego.insertion.rules import SequencingRules
from planning.lego.sequencing.blocking import remaining, smallest_blocking_set
from planning.lego.sequencing.remedies import columns_below, on_plinth
from planning.lego.sequencing.sequencing import (
    Removal,
    find_assembly_sequence,
    sequence_structure,
)
from tests.planning.lego.structures import brick

_PARTS = "abcde"
_TABLES = st.dictionaries(
    st.sampled_from(_PARTS),
    st.lists(st.frozensets(st.sampled_from(_PARTS), max_size=3), max_size=2),
)


@settings(max_examples=150, deadline=None)
@given(_TABLES)
def test_parts_remain_exactly_when_no_permutation_works(table):
    """Part p goes in beside some others unless one of its sets of blockers is among them."""

    def perhaps(parts, part):
        others = parts - {part}
        return not any(blockers <= others for blockers in table.get(part, ()))

    def possible(order):
        return all(perhaps(frozenset(order[: k + 1]), p) for k, p in enumerate(order))

    some = any(map(possible, permutations(_PARTS)))
    assert (not remaining(_PARTS, perhaps)) == some
    core = smallest_blocking_set(_PARTS, perhaps)
    assert (not core) == some
    assert not any(perhaps(core, part) for part in core)
    fewer = chain.from_iterable(combinations(sorted(core), k) for k in range(len(core)))
    for parts in fewer:
        assert not remaining(parts, perhaps)


def _hanging():
    """A brick that hangs one layer above the plate, carried from above."""
    return [
        brick("post1", "2x2", 20, 20, 1),
        brick("post2", "2x2", 20, 20, 2),
        brick("lamp", "1x2", 20, 23, 2, True),
        brick("beam", "2x4", 20, 20, 3),
    ]


def test_what_hangs_above_the_plate_is_refused_with_the_remedy_that_helps():
    with pytest.raises(InfeasibleStepError) as caught:
        sequence_structure(_hanging())
    words = str(caught.value)
    assert "this brick cannot go in" in words
    assert "'lamp' (1x2 at [20, 23, 2])" in words
    assert "nothing below it" in words
    assert "the plate is in its way" in words
    assert "'scaffold' (1 temporary bricks)" in words


def test_scaffolding_carries_it():
    found = sequence_structure(_hanging(), rules=SequencingRules(scaffold=True))
    names = [item.name for item in found.sequence]
    (helper,) = (item for item in found.sequence if item.step.temporary)
    assert helper.step.cell == Cell(20, 23, 1, True)
    assert names.index(helper.name) < names.index("lamp") < names.index("beam")
    assert not any(step.up for step in found.steps)


def test_a_plinth_makes_room_below():
    with pytest.raises(InfeasibleStepError):
        sequence_structure(_hanging(), rules=SequencingRules(plinth=1))
    tall = SequencingRules(plinth=14)
    found = sequence_structure(_hanging(), rules=tall)
    lamp = next(item for item in found.sequence if item.name == "lamp")
    assert lamp.step.up
    assert lamp.step.cell.z == 16
    raised, plinth = on_plinth(_hanging(), 14)
    assert len(plinth) == sum(step.temporary for step in found.steps) == 14
    assert {item.name: item.cell.z for item in raised}["beam"] == 17
    with pytest.raises(InfeasibleStepError, match="from below is not allowed"):
        sequence_structure(_hanging(), rules=replace(tall, place_up=False))


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(["1x1", "1x4", "2x2", "2x6"]),
    st.integers(0, 9),
    st.sets(st.tuples(st.integers(0, 1), st.integers(0, 5), st.integers(0, 8))),
)
def test_columns_reach_from_a_brick_to_what_is_below(kind, level, taken):
    item = PlacedBrick("x", BRICKS[kind], Cell.at_level(0, 0, level))
    own = item.places
    filled = {place: "y" for place in taken if place[2] < level} | dict.fromkeys(
        own, "x"
    )
    types = [b for b in BRICKS.values() if b.height in (1, 3)]
    for column in columns_below(item, filled, types):
        seen, top = set(filled), level
        for part in column:
            places = part.places
            assert not places & seen
            seen |= places
            assert part.cell.level + part.brick.height == top
            top = part.cell.level
        below = {(x, y, top - 1) for x, y, z in places if z == top}
        assert top == 0 or below & filled.keys()
        assert {(x, y) for x, y, _ in places} <= {(x, y) for x, y, _ in own}


def _rule(table):
    """Return a removal rule: part p may leave a set unless the set holds a blocker of p."""

    def removals(parts):
        for part in sorted(parts):
            if not any(blockers <= parts for blockers in table.get(part, ())):
                yield Removal(part, len(parts))

    return removals


@settings(max_examples=150, deadline=None)
@given(_TABLES)
def test_finds_a_sequence_exactly_when_some_permutation_is_one(table):
    removals = _rule(table)

    def possible(order):
        parts = frozenset(order)
        for part in reversed(order):
            if part not in {r.part for r in removals(parts)}:
                return False
            parts -= {part}
        return True

    found = find_assembly_sequence(_PARTS, removals)
    assert found.complete
    assert (found.steps is not None) == any(map(possible, permutations(_PARTS)))
    if found.steps is not None:
        assert possible(tuple(r.part for r in found.steps))
        assert [r.how for r in found.steps] == [1, 2, 3, 4, 5]
    else:
        assert found.dead_end
        assert not any(
            possible(order) for order in permutations(sorted(found.dead_end))
        )


def test_prefers_what_comes_first():
    found = find_assembly_sequence("abc", _rule({}))
    assert found.steps is not None
    assert "".join(r.part for r in found.steps) == "cba"
    assert found.visited == 4


def test_no_parts_need_no_steps():
    found = find_assembly_sequence((), _rule({}))
    assert found.steps == ()


def test_never_tries_a_set_twice():
    asked = []

    def removals(parts):
        asked.append(parts)
        for part in sorted(parts):
            if part != "a":  # never comes off
                yield Removal(part, None)

    found = find_assembly_sequence("abcdefgh", removals)
    assert found.steps is None
    assert found.complete
    assert found.dead_end == frozenset("a")
    assert len(asked) == len(set(asked)) == 2**7


def test_gives_up_at_its_limit():
    found = find_assembly_sequence(range(30), _rule({}), limit=10)
    assert found.steps is None
    assert not found.complete
    assert found.visited == 10


def test_is_lazy():
    def removals(parts):
        yield Removal(min(parts), None)
        raise AssertionError("asked for more than needed")

    assert find_assembly_sequence("abc", removals).steps is not None
