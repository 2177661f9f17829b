"""Links posed many at a time are where the engine puts them one after another."""

from __future__ import annotations

import numpy as np
import pytest

from planning.cell.workcell import PlacedRobot, Workcell
from planning.robots.registry import robot_model
from planning.transforms import rotation, translation
from twin.audit.worlds.coal_world import CoalWorld
from twin.audit.worlds.link_chain import JointAxes, measured_chain


@pytest.mark.parametrize("name", ["gp4", "iiwa14", "mobile-manipulator"])
def test_a_chain_is_what_was_measured(name: str) -> None:
    model = robot_model(name)
    base = translation(0.1, 0.2, 0.3) @ rotation("z", 0.7)
    world = CoalWorld(Workcell((PlacedRobot("arm", model, base, model.home),), (), ()))
    assert world._chains[0] is not None
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (20, model.dof))
    for own, told in zip(world.link_frames(0, q), world._measured(0, q), strict=True):
        assert np.allclose(own, told, rtol=0.0, atol=1e-12)


def test_joints_that_do_not_follow_one_another_are_left_to_the_engine() -> None:
    """Both joints turn about the base: the first does not carry the second."""

    def measure(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turns = np.array(
            [[np.eye(3), *(_about_z(angle) for angle in row)] for row in q]
        )
        places = np.tile([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]], (len(q), 1, 1))
        return turns, places

    axes = JointAxes(np.array([[0.0, 0, 1]] * 2), np.array([False, False]))
    assert measured_chain(axes, (np.eye(3), np.zeros(3)), measure) is None


def _about_z(angle: float) -> np.ndarray:
    return rotation("z", angle)[:3, :3]
