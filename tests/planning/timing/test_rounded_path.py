"""Rounded polylines: smooth, close to the polyline, and not less rounded than that allows."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.timing.rounded_path import RoundedPath, rounded_path


def drawn(seed: int) -> tuple[np.ndarray, float]:
    """Return a polyline, and how far a curve may stray from it."""
    rng = np.random.default_rng(seed)
    n, w = int(rng.integers(2, 7)), int(rng.integers(3, 12))
    bend = 10.0 ** rng.uniform(-3, 0.5)
    steps = (rng.normal(size=n) + bend * rng.normal(size=(w, n))) * 10.0 ** rng.uniform(
        -2, 0, (w, 1)
    )
    return np.cumsum(steps, axis=0), 10.0 ** rng.uniform(-5, -2)


def sampled(path: RoundedPath) -> np.ndarray:
    return np.unique(np.concatenate([np.linspace(0.0, path.at[-1], 3000), path.at]))


@settings(deadline=None)
@given(st.integers(0, 10**6))
def test_it_is_within_the_allowance_and_has_the_same_ends(seed: int) -> None:
    corners, stray = drawn(seed)
    path = rounded_path(corners, stray)
    ways = sampled(path)
    points = path.points(ways)
    assert np.allclose(points[[0, -1]], corners[[0, -1]], atol=1e-12)
    beside = np.array([np.interp(ways, path.at, joint) for joint in corners.T]).T
    far = np.abs(points - beside).sum(axis=1)
    for a, b in zip(corners, corners[1:], strict=False):
        share = np.clip((points - a) @ (b - a) / float((b - a) @ (b - a)), 0.0, 1.0)
        off = np.abs(points - a - share[:, None] * (b - a)).sum(axis=1)
        far = np.minimum(far, off)
    assert far.max() <= stray * (1.0 + 1e-9) + 1e-12


@settings(deadline=None)
@given(st.integers(0, 10**6))
def test_curvature_is_continuous_and_as_said(seed: int) -> None:
    corners, stray = drawn(seed)
    path = rounded_path(corners, stray)
    bends = path.curvature()
    for k in range(1, len(corners) - 1):
        if path.reach[k] <= 0.0:
            continue
        step = path.reach[k] * 1e-3
        around = path.at[k] + step * np.arange(-3, 4)
        points = path.points(around)
        second = np.diff(points, 2, axis=0) / step**2
        # It changes along the way by no more than roundings let it: no jump anywhere.
        most = bends[k - 1 : k + 2].max()
        assert np.all(np.abs(np.diff(second, axis=0)).sum(axis=1) <= most * 0.02)
        assert np.abs(second).sum(axis=1).max() <= most * 1.001 + 1e-6


def test_a_corner_by_itself_is_rounded_as_far_as_the_allowance_goes() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.1]])
    path = rounded_path(corners, 1e-3)
    off = np.abs(path.points(path.at[1:2])[0] - corners[1]).sum()
    assert 0.999e-3 <= off <= 1.0001e-3
