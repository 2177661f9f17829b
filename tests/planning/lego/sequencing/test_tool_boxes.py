"""Boxes around the tool and the bricks that they meet, found by kernels, are those of plain arrays."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planning.lego.insertion.tool_room import PLATE, BrickBoxes, blocking, tool_room


@given(st.integers(0, 10**6), st.integers(1, 5), st.sampled_from([0.0, 0.0006]))
def test_boxes_and_what_they_meet(seed: int, count: int, clearance: float) -> None:
    rng, room, poses = np.random.default_rng(seed), tool_room("gp4"), []
    for turn in Rotation.random(count, random_state=seed).as_matrix():
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, rng.uniform(0.0, 0.3, 3)
        poses.append(pose)
    boxes = room.boxes_at(*poses)
    corners = np.concatenate([room.pieces @ p[:3, :3].T + p[:3, 3] for p in poses])
    assert np.array_equal(boxes[:, 0], corners.min(axis=1))
    assert np.array_equal(boxes[:, 1], corners.max(axis=1))
    them = np.sort(rng.uniform(0.0, 0.3, (30, 2, 3)), axis=1)
    shrink = -clearance if clearance else 0.0005
    low, high = boxes[:, 0] + shrink, boxes[:, 1] - shrink
    meets = np.array([np.all((low < b[1]) & (high > b[0]), axis=1).any() for b in them])
    names = tuple(f"b{k}" for k in range(30))
    found = blocking(boxes, BrickBoxes(names, them), clearance=clearance)
    want = [PLATE] if low[:, 2].min() < 0.0 else []
    assert found == [*want, *(names[k] for k in np.flatnonzero(meets))]
