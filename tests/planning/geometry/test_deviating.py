"""What a skill may deviate, held against inverse kinematics of displaced flanges, point by point."""

from dataclasses import replace

import numpy as np
import pytest

from planning.cell.workcell import PlacedRobot, PoseError
from planning.geometry.exact import Solid, place_at_middle
from planning.geometry.robot_bodies import (
    position_error_bound,
    robot_bodies,
    with_deviations,
)
from planning.kinematics.kinematics import inverse_kinematics, joint_poses_of
from planning.robots.registry import robot_model
from planning.transforms import Array, rotation, translation
from scheduling.verification.deviating_links import DeviatingLinks
from scheduling.witness.robot import WitnessRobot

ERROR = PoseError(0.001, 0.002)


def placed(model: str) -> PlacedRobot:
    own = robot_model(model)
    base = translation(0.3, -0.2, 0.1) @ rotation("z", 0.7)
    return PlacedRobot("arm", own, base, own.home)


def a_path(robot: PlacedRobot, seed: int) -> Array:
    """Some configurations near each other, HOME or elsewhere."""
    rng = np.random.default_rng(seed)
    start = robot.home + rng.uniform(-0.3, 0.3, robot.model.dof)
    return np.asarray(start + np.linspace(0.0, 0.04, 4)[:, None])


def on_ball(rng: np.random.Generator, radius: float) -> Array:
    way = rng.normal(size=3)
    return np.asarray(radius * way / np.linalg.norm(way))


def displaced(robot: PlacedRobot, q: Array, rng: np.random.Generator) -> Array | None:
    """Joint values that bring the flange as far off as it may be, by the solver of planning."""
    here = joint_poses_of(robot, q)[-1] @ robot.model.flange
    turn, way = on_ball(rng, ERROR.rad), on_ball(rng, ERROR.m)
    angle = np.linalg.norm(turn)
    cross = np.cross(np.eye(3), turn / angle)
    turned = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    target = np.array(here)
    target[:3, :3], target[:3, 3] = turned @ here[:3, :3], here[:3, 3] + way
    found = inverse_kinematics(robot, "flange", target, q, restarts=0)
    return found[0] if found else None


def moved(robot: PlacedRobot, solids: list[Solid], q: Array, other: Array) -> Array:
    """How far the corners of each body are from where they were."""
    a, b = joint_poses_of(robot, q), joint_poses_of(robot, other)
    out = []
    for solid in solids:
        points, j = np.c_[solid.vertices, np.ones(len(solid.vertices))], solid.joint + 1
        gone = (points @ (b[j] - a[j]).T)[:, :3]
        out.append(np.linalg.norm(gone, axis=1).max())
    return np.array(out)


@pytest.mark.parametrize("model", ["gp4", "panda"])
@pytest.mark.parametrize("seed", range(3))
def test_no_body_is_further_off_than_its_bound(model: str, seed: int) -> None:
    """And bounds are no idle ones: each link comes to a good share of its own."""
    robot = placed(model)
    path, rng = a_path(robot, seed), np.random.default_rng(seed)
    solids = list(robot_bodies(robot).solids)
    bounds = position_error_bound(robot, path, ERROR, solids)
    # The same by the proof's code, which may ask for less, and not for more.
    reference = WitnessRobot(robot)
    frames, tried = reference.joint_frames_along(path), 0
    off = np.tile([ERROR.m, ERROR.rad], (len(path) - 1, 1))
    links = DeviatingLinks(reference, frames, off)
    proved: dict[int, float] = {}
    for part in reference.parts:
        far = links.deviates(part)
        reach = 0.0 if far is None else float(far.max())
        proved[part.joint] = max(reach, proved.get(part.joint, 0.0))
    most = np.zeros(len(solids))
    for q in path:
        for _ in range(40):
            other = displaced(robot, q, rng)
            if other is not None:
                tried += 1
                most = np.maximum(most, moved(robot, solids, q, other))
    assert tried > 100
    assert np.all(most <= bounds + 1e-9)
    for joint, reach in proved.items():
        own = np.array([solid.joint == joint for solid in solids])
        assert most[own].max() <= reach + 1e-9
        assert reach <= bounds[own].max() * 1.001
    moving = bounds > 0.0
    assert np.all(most[moving] >= 0.2 * bounds[moving])


def test_what_the_flange_carries_goes_with_it() -> None:
    robot = placed("gp4")
    solids = list(robot_bodies(robot).solids)
    path = a_path(robot, 0)
    bounds = position_error_bound(robot, path, PoseError(0.001, 0.0), solids)
    last = [s.joint == robot.model.dof - 1 for s in solids]
    assert bounds[last] == pytest.approx(0.001)
    base = [s.joint < 0 for s in solids]
    assert not bounds[base].any()


def test_bodies_that_deviate_are_that_much_thicker_for_all_but_themselves() -> None:
    robot = placed("gp4")
    path, own = a_path(robot, 1), robot_bodies(robot)
    wide = with_deviations(own, robot, path, ERROR)
    bounds = position_error_bound(robot, path, ERROR, own.solids)
    for solid, far in zip(wide.solids, bounds, strict=True):
        pose, _ = place_at_middle(solid, path[0], path[0])
        assert solid.deviation_bound_with_base(pose) == pytest.approx(far)
        assert solid.where_planned.deviation_bound_with_base(pose) == 0.0
    assert wide.hulls.deviates == pytest.approx(bounds)
    assert not wide.hulls.seen_from_base().deviates.any()
    off = replace(robot, base_error=PoseError(0.01, 0.0))
    both = with_deviations(robot_bodies(off), off, path, ERROR)
    pose, _ = place_at_middle(both.solids[-1], path[0], path[0])
    assert both.solids[-1].deviation_bound_with_base(pose) == pytest.approx(
        0.01 + bounds[-1]
    )
