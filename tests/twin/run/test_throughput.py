"""Figures of a line, against lines that are reckoned by hand."""

from __future__ import annotations

import numpy as np
import pytest

from twin.run.throughput import line_figures, start_up_of, takts_s

SECOND = 1_000_000_000


def test_a_regular_line_is_known_by_hand() -> None:
    begin = np.arange(10)[:, None] * 5 * SECOND
    end = begin + 12 * SECOND
    found = line_figures(begin, end, [20.0 + 5 * k for k in range(10)], 2)
    assert found.takt_s == pytest.approx([5.0])
    assert found.cycle_s == pytest.approx([12.0])
    assert found.per_hour == pytest.approx([720.0])
    assert found.late == pytest.approx([0.0])
    assert found.lateness_s == pytest.approx([-8.0])
    # From 22 s to 57 s; what would begin after the tenth product never does.
    steps = np.arange(22, 57)
    inside = [np.sum((begin <= t * SECOND) & (end > t * SECOND)) for t in steps]
    assert found.in_progress == pytest.approx([np.mean(inside)])


def test_products_overtake_and_are_late() -> None:
    begin = np.zeros((4, 2), dtype=np.int64)
    end = np.array([[4, 1], [2, 2], [6, 3], [8, 4]]) * SECOND
    assert takts_s(end, 0).T.tolist() == [[2.0, 2.0, 2.0], [1.0, 1.0, 1.0]]
    found = line_figures(begin, end, [3.0] * 4, 0)
    assert found.late.tolist() == [0.75, 0.25]
    assert found.lateness_s.tolist() == [2.0, -0.5]


@pytest.mark.parametrize(
    ("products", "asked", "skipped"),
    [(1, None, 0), (2, None, 0), (200, None, 20), (5, 9, 3)],
)
def test_two_products_are_left_after_the_start_up(
    products: int, asked: int | None, skipped: int
) -> None:
    assert start_up_of(products, asked) == skipped
