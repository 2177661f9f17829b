"""The queue of motions over a roadmap against heapq."""

from __future__ import annotations

import heapq

from hypothesis import given, settings
from hypothesis import strategies as st

from planning.construction.paths import roadmap
from planning.construction.paths.roadmap import MOST
from tests.kernels import outer

no_motions = roadmap.no_motions
pop = outer(roadmap.pop)
push = outer(roadmap.push)


@settings(deadline=None)
@given(st.lists(st.one_of(st.none(), st.integers(0, 30)), max_size=80))
def test_the_least_key_comes_first(steps: list[int | None]) -> None:
    heap, known = no_motions(), []
    for number, key in enumerate(steps):
        if key is not None:
            push(heap, float(key), 0.5 * number, number, number + 1, number % 3)
            heapq.heappush(known, key)
        elif known:
            first = int(heap.edge[0, 0])
            assert heap.key[0] == heapq.heappop(known) == steps[first]
            assert heap.depart[0] == 0.5 * first
            assert heap.edge[0].tolist() == [first, first + 1, first % 3]
            pop(heap)
        assert heap.size[0] == len(known)


def test_what_does_not_fit_is_left_out() -> None:
    heap = no_motions()
    for number in range(MOST + 2):
        push(heap, float(-number), 0.0, number, 0, 0)
    assert heap.size[0] == MOST
    assert heap.edge[0, 0] == MOST - 1
