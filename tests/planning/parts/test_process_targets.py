"""Processes as poses: the tool meets the place, comes and goes along its z axis, never far at once."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from planning.parts.assembly import Process
from planning.parts.part_skills import SMALL_STRIDE, SMALL_TURN, process_targets
from planning.steps.skill import STRIDE
from planning.transforms import Transform, from_rpy

_METRES = hnp.arrays(np.float64, 3, elements=st.floats(-0.3, 0.3))
_ANGLES = hnp.arrays(np.float64, 3, elements=st.floats(-3.1, 3.1))
POSES = st.builds(lambda xyz, rpy: from_rpy(xyz, rpy), _METRES, _ANGLES)
PROCESSES = st.builds(
    Process,
    name=st.just("seal"),
    approach=st.floats(0.01, 0.2),
    path=st.lists(POSES, max_size=3).map(tuple),
)


def tip_of(place: Transform, tool: Transform) -> tuple[np.ndarray, np.ndarray]:
    """Return position and z axis of a tool pose in the frame of a place."""
    seen = np.linalg.inv(place) @ tool
    return seen[:3, 3], seen[:3, 2]


@given(PROCESSES, POSES, st.floats(-3.1, 3.1))
def test_the_tool_meets_every_pose_of_the_path_in_its_order(
    process: Process, place: Transform, turn: float
) -> None:
    found = process_targets(process, place, turn)
    way = found.targets.subgoals[found.first : found.last + 1]
    assert {subgoal.name for subgoal in way} == {"seal"}
    k = 0
    for wanted in process.path or (np.eye(4),):
        while True:
            at, z = tip_of(place, way[k].pose)
            met = np.allclose(at, wanted[:3, 3], atol=1e-9)
            if met and np.allclose(z, -wanted[:3, 2], atol=1e-7):
                break
            k += 1
            assert k < len(way), "the path never comes there"


@given(PROCESSES, POSES, st.floats(-3.1, 3.1))
def test_steps_are_small_and_straight(
    process: Process, place: Transform, turn: float
) -> None:
    found = process_targets(process, place, turn)
    subgoals = found.targets.subgoals
    for k, (a, b) in enumerate(pairwise(subgoals)):
        way = float(np.linalg.norm(b.pose[:3, 3] - a.pose[:3, 3]))
        turned = a.pose[:3, :3].T @ b.pose[:3, :3]
        angle = np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1))
        inside = found.first <= k < found.last
        assert way <= (SMALL_STRIDE if inside else STRIDE) + 1e-9
        assert angle <= (SMALL_TURN if inside else 0.0) + 1e-6
    for near, far in ((found.first, 0), (found.last, len(subgoals) - 1)):
        back = subgoals[far].pose[:3, 3] - subgoals[near].pose[:3, 3]
        out = -process.approach * subgoals[near].pose[:3, 2]
        np.testing.assert_allclose(back, out, atol=1e-9)


@given(POSES, st.floats(-3.1, 3.1), st.floats(-3.1, 3.1))
def test_a_turn_is_about_the_axis_of_the_place(
    place: Transform, one: float, other: float
) -> None:
    process = Process("screw")
    first, second = (
        process_targets(process, place, turn).targets.subgoals[-3].pose
        for turn in (one, other)
    )
    between = np.linalg.inv(place) @ second @ np.linalg.inv(first) @ place
    expected = from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, other - one))
    np.testing.assert_allclose(between[:3, :3], expected[:3, :3], atol=1e-9)
