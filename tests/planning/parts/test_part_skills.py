"""Skills on parts as poses: straight ways as long as asked for, and processes along their paths."""

from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from planning.parts.assembly import PartHandling, Process
from planning.parts.part_skills import (
    SMALL_STRIDE,
    SMALL_TURN,
    SkillTry,
    pick_targets,
    place_targets,
    process_targets,
)
from planning.parts.step_paths import Pairing
from planning.steps.handovers import CandidateCollector
from planning.steps.skill import STRIDE, Obstruction, Phase, SkillTargets
from planning.tasks.assignment import PrimaryCandidate
from planning.transforms import Transform, from_rpy

GRIP = from_rpy((0.4, 0.1, 0.2), (np.pi, 0.5, 0.3))


@pytest.mark.parametrize("approach", [0.01, 0.03, 0.1])
@pytest.mark.parametrize("leave", [0.05, 1.0])
@pytest.mark.parametrize(
    ("targets", "name"), [(pick_targets, "pick"), (place_targets, "place-down")]
)
def test_ways_are_straight_and_as_long_as_asked_for(
    targets: Callable[[str, Transform, PartHandling], SkillTargets],
    name: str,
    approach: float,
    leave: float,
) -> None:
    """A pick comes along the tool and lifts straight up; a place the other way round."""
    skill = targets("tool", GRIP, PartHandling(approach=approach, leave=leave))
    assert (skill.skill, skill.lead) == (name, 1)
    points = np.array([item.pose[:3, 3] for item in skill.subgoals])
    at = skill.change_at
    assert at is not None
    np.testing.assert_allclose(points[at], GRIP[:3, 3])
    along, up = GRIP[:3, 2], np.array([0.0, 0.0, 1.0])
    came, left = (along, up) if name == "pick" else (-up, -along)
    np.testing.assert_allclose(points[at] - points[0], approach * came, atol=1e-12)
    np.testing.assert_allclose(points[-1] - points[at], leave * left, atol=1e-12)
    for way in (points[: at + 1], points[at:]):
        steps = np.diff(way, axis=0)
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
    tried = SkillTry(None, None, None, 0.06, 0.05)  # type: ignore[arg-type]
    words = [
        tried._with_remedy(Obstruction("a and slot touch", "slot", phase)).words
        for phase in (None, Phase.BEFORE, Phase.AFTER)
    ]
    assert words[0] == "a and slot touch"
    assert "begins, 60 mm away" in words[1]
    assert "approach_m makes it longer" in words[1]
    assert "ends, 50 mm away" in words[2]
    assert "leave_m makes it longer" in words[2]


def test_nobody_else_is_told_with_why() -> None:
    item = PrimaryCandidate(1, "left", "web", 0, 0.0)
    steps = [SimpleNamespace(step=SimpleNamespace(words=w)) for w in ("web", "screw")]
    found = CandidateCollector(())
    pairing = Pairing(SimpleNamespace(steps=steps), found)  # type: ignore[arg-type]
    found.reject(2, "left does it", "it is for right only")
    found.reject(2, "right grips, 8 mm wide", "the tool would be 4.0 mm in screw")
    why = pairing._nobody(item, 2, None)
    assert why.words == (
        "nobody else can do step 2 (screw) at all: right grips, 8 mm wide: the tool would be 4.0 mm"
        " in screw"
    )
    hit = Obstruction("right/arm and left/arm overlap by 3.0 mm", "left/arm")
    why = pairing._nobody(item, 2, hit)
    assert why.words.endswith("meanwhile: right/arm and left/arm overlap by 3.0 mm")
