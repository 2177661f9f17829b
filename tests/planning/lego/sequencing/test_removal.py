"""Helpers that can be taken out of a structure again, against all orders and boxes in motion.

Sequences and blocking sets against all permutations, and remedies of blocked structures.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, combinations, permutations, product
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planning.errors import InfeasibleStepError
from planning.lego.bricks.assembly import Cell, PlacedBrick
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.insertion.rules import SequencingRules
from planning.lego.insertion.tool_room import (
    PLATE,
    BrickBoxes,
    blocking_bricks,
    tool_room,
)
from planning.lego.sequencing.blocking import blocked_parts, smallest_blocking_set
from planning.lego.sequencing.disassembly_search import Removal, find_assembly_sequence
from planning.lego.sequencing.remedies import raise_on_plinth, supporting_columns
from planning.lego.sequencing.removal import find_unremovable_bricks
from planning.lego.sequencing.sequencing import sequence_structure
from tests.planning.lego.structures import brick, scattered

Part = TypeVar("Part", str, int)

_STUD = 0.53
"""Height of a stud, in levels of 3.2 mm."""

_EPS = 0.01


def _boxes(item: PlacedBrick, studs: bool) -> np.ndarray:
    """Return the body of a brick as a box, and its studs as boxes, shape (n, 2, 3) [studs, levels]."""
    s = item.span
    out: list[tuple[tuple[float, ...], tuple[float, ...]]]
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
def test_those_that_stay_are_those_of_the_best_order(
    bricks: list[PlacedBrick], chosen: set[int]
) -> None:
    helpers = [item.name for k, item in enumerate(bricks) if k in chosen]
    found = find_unremovable_bricks(bricks, frozenset(helpers))
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


def test_a_helper_between_a_floor_and_what_hangs_is_shut_in() -> None:
    enclosed = [
        brick("floor", "2x6", 20, 20, 1, True),
        brick("post1", "2x2", 20, 20, 2),
        brick("post2", "2x2", 24, 20, 2),
        brick("helper", "2x2", 22, 20, 2),
        brick("lamp", "2x2", 22, 20, 3),
        brick("roof", "2x6", 20, 20, 4, True),
    ]
    (found,) = find_unremovable_bricks(enclosed, frozenset(["helper"]))
    assert found.words.startswith("'helper' (2x2 at [22, 20, 2]) is shut in behind")
    assert [item.name for item in found.behind[:2]] == ["floor", "lamp"]
    # Without the floor it comes off from below.
    assert not find_unremovable_bricks(enclosed[1:], frozenset(["helper"]))


def test_rules_may_ask_for_helpers_that_come_out_again() -> None:
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


def test_a_column_that_comes_out_again_is_preferred() -> None:
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


def test_helpers_that_are_chosen_already_stay_helpers() -> None:
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
    ground = frozenset(product(range(18, 28), range(18, 28)))
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


_PARTS = "abcde"
_TABLES = st.dictionaries(
    st.sampled_from(_PARTS),
    st.lists(st.frozensets(st.sampled_from(_PARTS), max_size=3), max_size=2),
)


@settings(max_examples=150, deadline=None)
@given(_TABLES)
def test_parts_remain_exactly_when_no_permutation_works(
    table: Mapping[str, Sequence[frozenset[str]]],
) -> None:
    """Part p goes in beside some others unless one of its sets of blockers is among them."""

    def perhaps(parts: frozenset[str], part: str) -> bool:
        others = parts - {part}
        return not any(blockers <= others for blockers in table.get(part, ()))

    def possible(order: tuple[str, ...]) -> bool:
        return all(perhaps(frozenset(order[: k + 1]), p) for k, p in enumerate(order))

    some = any(map(possible, permutations(_PARTS)))
    assert (not blocked_parts(_PARTS, perhaps)) == some
    core = smallest_blocking_set(_PARTS, perhaps)
    assert (not core) == some
    assert not any(perhaps(core, part) for part in core)
    fewer = chain.from_iterable(combinations(sorted(core), k) for k in range(len(core)))
    for parts in fewer:
        assert not blocked_parts(parts, perhaps)


def _hanging() -> list[PlacedBrick]:
    """A brick that hangs one layer above the plate, carried from above."""
    return [
        brick("post1", "2x2", 20, 20, 1),
        brick("post2", "2x2", 20, 20, 2),
        brick("lamp", "1x2", 20, 23, 2, True),
        brick("beam", "2x4", 20, 20, 3),
    ]


def test_what_hangs_above_the_plate_is_refused_with_the_remedy_that_helps() -> None:
    with pytest.raises(InfeasibleStepError) as caught:
        sequence_structure(_hanging())
    words = str(caught.value)
    assert "this brick cannot go in" in words
    assert "'lamp' (1x2 at [20, 23, 2])" in words
    assert "nothing below it" in words
    assert "the plate is in its way" in words
    assert "'scaffold' (1 temporary bricks)" in words


def test_scaffolding_carries_it() -> None:
    found = sequence_structure(_hanging(), rules=SequencingRules(scaffold=True))
    names = [item.name for item in found.sequence]
    (helper,) = (item for item in found.sequence if item.step.temporary)
    assert helper.step.cell == Cell(20, 23, 1, True)
    assert names.index(helper.name) < names.index("lamp") < names.index("beam")
    assert not any(step.up for step in found.steps)


def test_a_plinth_makes_room_below() -> None:
    with pytest.raises(InfeasibleStepError):
        sequence_structure(_hanging(), rules=SequencingRules(plinth=1))
    tall = SequencingRules(plinth=14)
    found = sequence_structure(_hanging(), rules=tall)
    lamp = next(item for item in found.sequence if item.name == "lamp")
    assert lamp.step.up
    assert lamp.step.cell.z == 16
    raised, plinth = raise_on_plinth(_hanging(), 14)
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
def test_columns_reach_from_a_brick_to_what_is_below(
    kind: str, level: int, taken: set[tuple[int, int, int]]
) -> None:
    item = PlacedBrick("x", BRICKS[kind], Cell.at_level(0, 0, level))
    own = item.places
    filled = {place: "y" for place in taken if place[2] < level} | dict.fromkeys(
        own, "x"
    )
    types = [b for b in BRICKS.values() if b.height in (1, 3)]
    for column in supporting_columns(item, filled, types):
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


def _rule(
    table: Mapping[Part, Sequence[frozenset[Part]]],
) -> Callable[[frozenset[Part]], Iterator[Removal[Part, int]]]:
    """Return a removal rule: part p may leave a set unless the set holds a blocker of p."""

    def removals(parts: frozenset[Part]) -> Iterator[Removal[Part, int]]:
        for part in sorted(parts):
            if not any(blockers <= parts for blockers in table.get(part, ())):
                yield Removal(part, len(parts))

    return removals


@settings(max_examples=150, deadline=None)
@given(_TABLES)
def test_finds_a_sequence_exactly_when_some_permutation_is_one(
    table: Mapping[str, Sequence[frozenset[str]]],
) -> None:
    removals = _rule(table)

    def possible(order: tuple[str, ...]) -> bool:
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


def test_prefers_what_comes_first() -> None:
    found = find_assembly_sequence("abc", _rule({}))
    assert found.steps is not None
    assert "".join(r.part for r in found.steps) == "cba"
    assert found.visited == 4


def test_no_parts_need_no_steps() -> None:
    found = find_assembly_sequence((), _rule({}))
    assert found.steps == ()


def test_never_tries_a_set_twice() -> None:
    asked = []

    def removals(parts: frozenset[str]) -> Iterator[Removal[str, None]]:
        asked.append(parts)
        for part in sorted(parts):
            if part != "a":  # never comes off
                yield Removal(part, None)

    found = find_assembly_sequence("abcdefgh", removals)
    assert found.steps is None
    assert found.complete
    assert found.dead_end == frozenset("a")
    assert len(asked) == len(set(asked)) == 2**7


def test_gives_up_at_its_limit() -> None:
    found = find_assembly_sequence(range(30), _rule({}), limit=10)
    assert found.steps is None
    assert not found.complete
    assert found.visited == 10


def test_is_lazy() -> None:
    def removals(parts: frozenset[str]) -> Iterator[Removal[str, None]]:
        yield Removal(min(parts), None)
        raise AssertionError("asked for more than needed")

    assert find_assembly_sequence("abc", removals).steps is not None


@given(st.integers(0, 10**6), st.integers(1, 5), st.sampled_from([0.0, 0.0006]))
def test_boxes_and_what_they_meet(seed: int, count: int, clearance: float) -> None:
    rng, room, poses = np.random.default_rng(seed), tool_room("gp4"), []
    for turn in Rotation.random(count, random_state=seed).as_matrix():
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, rng.uniform(0.0, 0.3, 3)
        poses.append(pose)
    boxes = room.boxes_at(*poses)
    corners = np.concatenate([room.pieces @ p[:3, :3].T + p[:3, 3] for p in poses])
    assert np.array_equal(boxes[:, 0], corners.min(axis=1))
    assert np.array_equal(boxes[:, 1], corners.max(axis=1))
    them = np.sort(rng.uniform(0.0, 0.3, (30, 2, 3)), axis=1)
    shrink = -clearance if clearance else 0.0005
    low, high = boxes[:, 0] + shrink, boxes[:, 1] - shrink
    meets = np.array([np.all((low < b[1]) & (high > b[0]), axis=1).any() for b in them])
    names = tuple(f"b{k}" for k in range(30))
    found = blocking_bricks(boxes, BrickBoxes(names, them), clearance=clearance)
    want = [PLATE] if low[:, 2].min() < 0.0 else []
    assert found == [*want, *(names[k] for k in np.flatnonzero(meets))]
