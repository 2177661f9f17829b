"""Classes of gaps between hulls where the right answer is known: boxes above a wide floor."""

from __future__ import annotations

import numpy as np
import pytest

from planning.geometry.distance import BETWEEN, FAR, TOO_CLOSE, gap_class
from planning.transforms import Array, from_rpy
from tests.kernels import outer

_gap_class = outer(gap_class)

_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
FLOOR = _SIGNS * (15.0, 15.0, 0.1) - (0.0, 0.0, 0.1)


def _tilted(rng: np.random.Generator, gap: float) -> Array:
    """Return the corners of a box whose lowest corner is so high above the floor."""
    size = rng.uniform(0.1, 0.8, 3)
    turn = rng.uniform(-0.3, 0.3, 3) * rng.integers(0, 2, 3)
    pose = from_rpy((*rng.uniform(-5.0, 5.0, 2), 0.0), tuple(turn))
    corners = 0.5 * _SIGNS * size @ pose[:3, :3].T + pose[:3, 3]
    corners[:, 2] += gap - corners[:, 2].min()
    return np.ascontiguousarray(corners)


@pytest.mark.parametrize("warm", [False, True])
def test_gaps_above_a_wide_floor_are_told_whatever_the_first_guess(warm: bool) -> None:
    rng = np.random.default_rng(3)
    floor = np.ascontiguousarray(FLOOR)
    for _ in range(3000):
        gap = float(rng.uniform(0.002, 0.02))
        box = _tilted(rng, gap)
        for enough, wanted in ((0.8 * gap, FAR), (1.5 * gap, BETWEEN)):
            guess = rng.normal(size=3) if warm else np.zeros(3)
            guess /= max(float(np.linalg.norm(guess)), 1e-9)
            found = _gap_class(box, 8, floor, 8, 0.0005, enough, guess)
            assert found == wanted, (box.tolist(), gap, enough)


def test_what_reaches_into_the_floor_is_never_apart() -> None:
    rng = np.random.default_rng(4)
    floor = np.ascontiguousarray(FLOOR)
    found = set()
    for _ in range(1000):
        box = _tilted(rng, -float(rng.uniform(0.001, 0.05)))
        guess = rng.normal(size=3)
        guess /= np.linalg.norm(guess)
        found.add(_gap_class(box, 8, floor, 8, 0.0005, 0.01, guess))
    assert not found & {FAR, BETWEEN}
    assert TOO_CLOSE in found
