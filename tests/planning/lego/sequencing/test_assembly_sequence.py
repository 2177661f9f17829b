"""Assembly by disassembly against all permutations."""

from __future__ import annotations

from itertools import permutations

from hypothesis import given, settings
from hypothesis import strategies as st

from planning.lego.sequencing.search import Removal, find_assembly_sequence

_PARTS = "abcde"


def _rule(table):
    """Return a removal rule: part p may leave a set unless the set holds a blocker of p."""

    def removals(parts):
        for part in sorted(parts):
            if not any(blockers <= parts for blockers in table.get(part, ())):
                yield Removal(part, len(parts))

    return removals


_TABLES = st.dictionaries(
    st.sampled_from(_PARTS),
    st.lists(
        st.frozensets(st.sampled_from(_PARTS), min_size=0, max_size=3), max_size=2
    ),
)


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
