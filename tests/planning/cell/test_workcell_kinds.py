"""Kinds of objects by name, copies of stations included."""

import numpy as np
import pytest

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Workcell


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("brick", "2x4"),
        ("brick.2", "2x4"),
        ("brick.2.1", "2x4"),
        ("brick.5", "2x2"),
        ("other", None),
        ("other.2", None),
    ],
)
def test_a_copy_has_the_kind_of_what_it_copies(name: str, kind: str | None) -> None:
    shape = box_shape("brick", (0.1, 0.1, 0.1))
    objects = (
        CellObject("brick", "2x4", shape, np.eye(4)),
        CellObject("brick.5", "2x2", shape, np.eye(4)),
    )
    assert Workcell((), (), objects).kind_of(name) == kind
