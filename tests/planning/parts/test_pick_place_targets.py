"""The ways to a part, with it and away from it are straight and as long as asked for."""

from __future__ import annotations

import numpy as np
import pytest

from planning.parts.part_skills import pick_targets, place_targets
from planning.steps.skill import STRIDE, SkillTargets
from planning.transforms import Array, from_rpy

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
