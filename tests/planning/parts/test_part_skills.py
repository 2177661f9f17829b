"""Skills on parts as poses: straight ways as long as asked for, and processes along their paths."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from planning.parts.assembly import Process
from planning.parts.part_skills import (
    SMALL_STRIDE,
    SMALL_TURN,
    _with_remedy,
    pick_targets,
    place_targets,
    process_targets,
)
from planning.parts.step_paths import _nobody
from planning.steps.handovers import CandidateCollector
from planning.steps.skill import STRIDE, Obstruction, Phase, SkillTargets
from planning.tasks.assignment import PrimaryCandidate
from planning.transforms import Array, Transform, from_rpy

GRIP = from_rpy((0.4, 0.1, 0.2), (np.pi, 0.5, 0.3))


def ways(skill: SkillTargets) -> tuple[Array, Array, Array]:
    at = skill.change_at
    assert at is not None
    points = np.array([item.pose[:3, 3] for item in skill.subgoals])
    return points[: at + 1], points[at], points[at:]


@pytest.mark.parametrize("length", [0.01, 0.03, 0.075])
def test_a_pick_comes_along_the_tool_and_lifts_straight_up(length: float) -> None:
    skill = pick_targets("tool", GRIP, length, 0.05)
    before, attach, after = ways(skill)
    assert (skill.skill, skill.lead) == ("pick", 1)
    np.testing.assert_allclose(attach, GRIP[:3, 3])
    np.testing.assert_allclose(attach - before[0], length * GRIP[:3, 2], atol=1e-12)
    np.testing.assert_allclose(after[-1] - attach, [0, 0, 0.05], atol=1e-12)


def test_a_place_comes_straight_down_and_leaves_along_the_tool() -> None:
    skill = place_targets("tool", GRIP, 0.08, 0.05)
    before, attach, after = ways(skill)
    assert (skill.skill, skill.lead) == ("place-down", 1)
    np.testing.assert_allclose(before[0] - attach, [0, 0, 0.08], atol=1e-12)
    np.testing.assert_allclose(attach - after[-1], 0.05 * GRIP[:3, 2], atol=1e-12)


def test_subgoals_lie_on_the_straight_way_and_close_together() -> None:
    for skill in (pick_targets("t", GRIP, 0.1, 0.07), place_targets("t", GRIP, 0.1, 1)):
        before, _, after = ways(skill)
        for points in (before, after):
            steps = np.diff(points, axis=0)
            assert np.linalg.norm(steps, axis=1).max() <= STRIDE + 1e-9
            np.testing.assert_allclose(steps, steps[:1].repeat(len(steps), 0))
        for item in skill.subgoals:
            np.testing.assert_allclose(item.pose[:3, :3], GRIP[:3, :3])


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


def test_what_is_in_the_way_where_a_straight_way_begins_says_which_key_is_its_length() -> (
    None
):
    at_ends = [
        _with_remedy(Obstruction("a and slot touch", "slot", phase), 0.06, 0.05)
        for phase in (None, Phase.BEFORE, Phase.AFTER)
    ]
    words = [found.words for found in at_ends if isinstance(found, Obstruction)]
    assert words[0] == "a and slot touch"
    assert "begins, 60 mm away" in words[1]
    assert "approach_m makes it longer" in words[1]
    assert "ends, 50 mm away" in words[2]
    assert "leave_m makes it longer" in words[2]


def test_nobody_else_is_told_with_why() -> None:
    item = PrimaryCandidate(1, "left", "web", 0, 0.0)
    grip = SimpleNamespace(words="grip 10 mm wide")
    steps = [SimpleNamespace(step=SimpleNamespace(words=w)) for w in ("web", "screw")]
    paths = SimpleNamespace(steps=steps, grip_of=lambda _: grip)
    found = CandidateCollector(())
    found.reject(2, "left does it", "it is for right only")
    found.reject(2, "right grips, 8 mm wide", "the tool would be 4.0 mm in screw")
    _, why = _nobody(paths, found, item, 2, None)  # type: ignore[arg-type]
    assert why.words == (
        "nobody else can do step 2 (screw) at all: right grips, 8 mm wide: the tool would be 4.0 mm"
        " in screw"
    )
    hit = Obstruction("right/arm and left/arm overlap by 3.0 mm", "left/arm")
    _, why = _nobody(paths, found, item, 2, hit)  # type: ignore[arg-type]
    assert why.words.endswith("meanwhile: right/arm and left/arm overlap by 3.0 mm")
