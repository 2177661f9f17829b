"""Views of an arena are the arrays that were packed, and write through to its memory."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.construction.checks.arena import (
    column,
    counting,
    pack,
    row,
    table,
    truths,
)

SHAPES = st.lists(st.tuples(st.integers(0, 4), st.integers(1, 5)), max_size=4)


@settings(deadline=None)  # the first example compiles
@given(shapes=SHAPES, counts=st.integers(1, 9), seed=st.integers(0, 100))
def test_views_are_what_was_packed(
    shapes: list[tuple[int, int]], counts: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    tables = {2 * k: rng.normal(size=shape) for k, shape in enumerate(shapes)}
    rows = {
        2 * k + 1: rng.integers(-9, 9, size=a * b) for k, (a, b) in enumerate(shapes)
    }
    flags = rng.random(counts) < 0.5
    memory = pack(2 * len(shapes), tables, rows, flags, counts)
    arena = memory.arena
    for key, content in tables.items():
        assert np.array_equal(table(arena, key), content)
        assert np.array_equal(column(arena, key), content.ravel())
    for key, line in rows.items():
        assert np.array_equal(row(arena, key), line)
    assert np.array_equal(truths(arena), flags)
    assert np.array_equal(counting(arena), np.arange(counts)[None])


def test_what_is_written_to_a_view_is_seen_by_all() -> None:
    memory = pack(2, {0: np.zeros((2, 3))}, {1: np.arange(4)}, np.zeros(1, bool), 1)
    table(memory.arena, 0)[1, 2] = 7.0
    row(memory.arena, 1)[3] = 5
    assert column(memory.arena, 0).tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 7.0]
    assert memory.floats[5] == 7.0
    assert memory.integers.tolist() == [0, 1, 2, 5]
