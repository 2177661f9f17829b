"""Segment distances against dense sampling."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.geometry.distance import segment_box, segment_segment
from planning.transforms import from_rpy
from tests.kernels import outer

_segment_box = outer(segment_box)
_segment_segment = outer(segment_segment)

numbers = st.integers(0, 2**32 - 1)
_T = np.linspace(0.0, 1.0, 2001)


@given(numbers)
@settings(max_examples=150, deadline=None)
def test_segment_segment_is_the_least_over_all_pairs_of_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a0, a1, b0, b1 = rng.uniform(-1, 1, (4, 3))
    if seed % 5 == 0:
        a1 = a0 + (b1 - b0)  # parallel
    if seed % 7 == 0:
        b1 = b0.copy()  # a point
    found = np.sqrt(_segment_segment(a0, a1, b0, b1))
    grid_a = a0 + _T[::10, None] * (a1 - a0)
    grid_b = b0 + _T[::10, None] * (b1 - b0)
    sampled = np.min(np.linalg.norm(grid_a[:, None] - grid_b[None], axis=2))
    spacing = (np.linalg.norm(a1 - a0) + np.linalg.norm(b1 - b0)) / 400
    assert found <= sampled + 1e-12
    assert found >= sampled - spacing - 1e-12


@given(numbers)
@settings(max_examples=150, deadline=None)
def test_segment_box_is_the_least_over_the_segment(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p0, p1 = rng.uniform(-1, 1, (2, 3))
    half = rng.uniform(0.01, 0.5, 3)
    pose = from_rpy(rng.uniform(-0.5, 0.5, 3), rng.uniform(-3, 3, 3))
    if seed % 5 == 0:
        p1 = p0 + pose[:3, 0] * 0.7  # along a face
    found = np.sqrt(_segment_box(p0, p1, pose, half))
    local = (p0 + _T[:, None] * (p1 - p0) - pose[:3, 3]) @ pose[:3, :3]
    outside = np.maximum(np.abs(local) - half, 0.0)
    sampled = np.min(np.linalg.norm(outside, axis=1))
    assert found <= sampled + 1e-12
    assert found >= sampled - np.linalg.norm(p1 - p0) / 4000 - 1e-12
