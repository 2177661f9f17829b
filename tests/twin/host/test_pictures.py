"""Names in pictures fit the room that they are given."""

from __future__ import annotations

import pytest

from twin.host.pictures import fitted


@pytest.mark.parametrize(
    ("name", "width", "lines", "shown"),
    [
        ("housing", 60.0, 1, "housing"),
        ("housing", 20.0, 1, ""),
        ("left_2x4_c", 40.0, 3, "left_2x4_c"),
        ("left_2x4_c", 24.0, 3, "left_\n2x4_c"),
        ("beam13", 20.0, 3, "beam\n13"),
        ("connector", 20.0, 3, "conne\nctor"),
        ("connector", 20.0, 1, ""),
        ("connector", 3.0, 9, ""),
        ("lower left bolt", 20.0, 3, "lower\nleft\nbolt"),
    ],
)
def test_a_name_is_broken_where_its_words_end(
    name: str, width: float, lines: int, shown: str
) -> None:
    assert fitted(name, width, 6.0, lines=lines) == shown
    found = fitted(name, width, 6.0, lines=lines)
    assert all(len(line) * 0.6 * 6.0 <= width for line in found.split("\n"))
