"""What touches what, against the distance of upright boxes worked out axis by axis."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject
from planning.contacts.touching import near_to
from planning.transforms import from_rpy, translation

edges = st.tuples(*[st.floats(0.02, 0.3)] * 3)
places = st.tuples(*[st.floats(-0.4, 0.4)] * 3)


def box(size: tuple[float, float, float]) -> CellObject:
    edges = np.array(size)
    return CellObject("part", "box", box_shape("part", edges), np.eye(4))


def gap_of_upright(
    size_a: tuple[float, ...],
    at_a: tuple[float, ...],
    size_b: tuple[float, ...],
    at_b: tuple[float, ...],
) -> float:
    """Distance of two boxes parallel to the axes; negative inside each other."""
    apart = np.abs(np.subtract(at_a, at_b)) - np.add(size_a, size_b) / 2
    if apart.max() < 0:
        return float(apart.max())
    return float(np.linalg.norm(np.maximum(apart, 0)))


@given(edges, places, edges, places)
def test_it_is_the_distance_of_the_boxes(
    size_a: tuple[float, float, float],
    at_a: tuple[float, float, float],
    size_b: tuple[float, float, float],
    at_b: tuple[float, float, float],
) -> None:
    expected = gap_of_upright(size_a, at_a, size_b, at_b)
    found = near_to(
        (box(size_a), translation(*at_a)),
        {"b": (box(size_b), translation(*at_b))},
        0.05,
    )
    if expected > 0.0501:
        assert found == {}
    elif expected < 0.0499:
        assert found["b"] == pytest.approx(expected, abs=1e-5)


def test_a_rod_leaning_on_an_edge_touches_it_and_one_beside_does_not() -> None:
    rod = box((0.2, 0.02, 0.02))
    leaning = from_rpy((0, 0, 0), (0, -np.pi / 4, 0))
    # The lower face passes 10 mm from the axis: on the line z = x - 0.01 * sqrt(2).
    edge = 0.05 - 0.01 * np.sqrt(2)
    post = box((0.02, 0.02, 0.1))
    touching = translation(0.06, 0, edge - 0.05 - 0.0005)
    found = near_to(
        (rod, leaning),
        {"post": (post, touching), "other": (post, translation(0.06, 0.1, 0))},
        0.002,
    )
    assert list(found) == ["post"]
    assert found["post"] == pytest.approx(0.0005 / np.sqrt(2), abs=1e-6)
