"""Bases are drawn by name, within their errors, and over all of them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.cell.machine import machine_robot
from planning.cell.workcell import PoseError
from planning.transforms import Array, from_rpy, inverse
from twin.studies.pose_errors import drawn_base
from twin.uncertainty.disturbances import Disturbances

ERROR = PoseError(0.002, 0.01)
LEFT, RIGHT = (
    replace(machine_robot(name), base=from_rpy([x, 0.1, 0.2], [0.1, 0.2, 0.3]))
    for name, x in (("left", 0.0), ("right", 0.9))
)


def difference(seed: int, replication: int) -> tuple[Array, float]:
    """How far the origin is off [m], and by what angle the base is turned [rad]."""
    at = drawn_base(LEFT, ERROR, seed=seed, replication=replication)
    turned = at[:3, :3] @ LEFT.base[:3, :3].T
    assert np.allclose(turned @ turned.T, np.eye(3))
    # Of small turns the trace is too coarse.
    sine = 0.5 * np.linalg.norm(turned - turned.T) / np.sqrt(2.0)
    return at[:3, 3] - LEFT.base[:3, 3], float(np.arcsin(sine))


@given(st.integers(0, 2**32), st.integers(0, 10**6))
def test_a_base_is_within_its_error(seed: int, replication: int) -> None:
    way, angle = difference(seed, replication)
    assert np.linalg.norm(way) <= ERROR.m
    assert angle <= ERROR.rad * (1.0 + 1e-9)


def test_all_of_the_ball_is_drawn_from_alike() -> None:
    drawn = [difference(3, k) for k in range(2000)]
    ways = np.array([way for way, _ in drawn]) / ERROR.m
    assert np.abs(ways.mean(axis=0)).max() < 0.04
    # A uniform point of a ball has an eighth of its chance within half the radius.
    for radii in (
        np.linalg.norm(ways, axis=1),
        np.array([angle for _, angle in drawn]) / ERROR.rad,
    ):
        assert np.mean(radii < 0.5) == pytest.approx(0.125, abs=0.03)
        assert radii.max() > 0.99


def test_a_draw_depends_on_its_name_alone() -> None:
    first = drawn_base(LEFT, ERROR, seed=1, replication=5)
    assert np.array_equal(first, drawn_base(LEFT, ERROR, seed=1, replication=5))
    others = [
        drawn_base(LEFT, ERROR, seed=2, replication=5),
        drawn_base(LEFT, ERROR, seed=1, replication=6),
        LEFT.base
        @ inverse(RIGHT.base)
        @ drawn_base(RIGHT, ERROR, seed=1, replication=5),
    ]
    assert not any(np.allclose(first, other, atol=1e-7) for other in others)
    still = drawn_base(LEFT, PoseError(), seed=1, replication=5)
    assert np.array_equal(still, LEFT.base)


def test_what_the_cell_says_counts_where_nothing_else_is_said() -> None:
    placed = replace(LEFT, base_error=ERROR)
    assert Disturbances().base_error_of(placed) == ERROR
    given_here = Disturbances.model_validate({"base_error": {"m": 0.001}})
    assert given_here.base_error_of(placed) == PoseError(0.001, 0.0)
