"""Camera of a Rerun recording, placed so that the whole scene is in view."""

from __future__ import annotations

import math

import numpy as np
import rerun.blueprint as rrb

from planning.cell.workcell import CellObject, PlacedRobot
from planning.kinematics.kinematics import joint_poses_of
from planning.transforms import Array, Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.drawing.looks import foot_position

_TAN_HALF_VIEW = 0.5206  # tangent of half the vertical angle of view, 55 degrees
_ASPECT = 1.75  # aspect ratio of the 3-D view in a typical window
_MARGIN = 1.04
"""Ratio of the width of the view to that of the scene."""

_MOST_CONFIGURATIONS = 60
"""Approximate number of configurations of each robot that are in view."""

_LEAST_M = 0.3
"""Least distance of the camera from its target [m]."""

_ARMS_TURN = math.atan2(0.22, 1.05)  # angle to the normal of the line of arms
_SITE_TURNS = np.radians(np.arange(-30.0, 31.0, 6.0))  # angles tried at a site
_ARMS_SLOPE, _SITE_SLOPE = 0.615, 0.75  # height per distance along the ground
_CORNERS = 0.5 * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T


def camera(tpg: TemporalPlanGraph) -> rrb.EyeControls3D:
    """Return a camera that looks from above at all places of the run.

    Arms are seen at right angles to the line of their bases, a site of mobile robots at right angles to
    the longest extent of the construction, from the side where the camera can be nearest.
    """
    points = site_points(tpg)
    views = [camera_looking_at(points, towards) for towards in _directions(tpg)]
    target, eye = min(views, key=lambda view: float(np.linalg.norm(view[1] - view[0])))
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=[0, 0, 1]
    )


def site_points(tpg: TemporalPlanGraph) -> Array:
    """Return points that the site spans, shape (p, 3) [m].

    They are the corners of resting objects, and of the robots along their paths. Fixtures do not count:
    the ground may be large.
    """
    points = [np.zeros((0, 3))]
    things = {item.name: item for item in tpg.cell.objects}
    points += [_corners(item, item.start) for item in things.values()]
    points += [
        _corners(things[item.object], item.pose)
        for item in tpg.handlings
        if item.holder is None
    ]
    chains = {chain.robot: chain for chain in tpg.chains}
    for robot in tpg.cell.robots:
        configurations = [robot.home[None]]
        if robot.name in chains:
            chain = chains[robot.name]
            step = max(1, len(chain.waypoints) // _MOST_CONFIGURATIONS)
            configurations += [chain.start[None], chain.waypoints[::step]]
        points += [_outline(robot, q) for q in np.vstack(configurations)]
    return np.vstack(points)


def _outline(robot: PlacedRobot, q: Array) -> Array:
    """Return the joints of a robot and the boxes around its links, shape (p, 3) [m]."""
    poses = joint_poses_of(robot, q)
    out = [poses[:, :3, 3]]
    for part in robot.model.parts:
        pose = poses[part.joint + 1]
        low, high = part.body.vertices.min(axis=0), part.body.vertices.max(axis=0)
        corners = 0.5 * (low + high) + _CORNERS * (high - low)
        out.append(corners @ pose[:3, :3].T + pose[:3, 3])
    return np.vstack(out)


def camera_looking_at(points: Array, towards: Array) -> tuple[Array, Array]:
    """Return target and position of a camera so that some points fill its picture.

    Args:
        points: shape (p, 3) [m].
        towards: unit vector from the target to the camera.
    """
    if len(points) == 0:
        points = np.zeros((1, 3))
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    across = np.stack([right, np.cross(towards, right)])
    tangents = np.array([_TAN_HALF_VIEW * _ASPECT, _TAN_HALF_VIEW]) / _MARGIN
    target: Array = 0.5 * (points.min(axis=0) + points.max(axis=0))
    away = _LEAST_M
    for _ in range(8):  # converges to less than a pixel
        across_view = (points - target) @ across.T
        depth = (points - target) @ towards
        needed = np.max(depth[:, None] + np.abs(across_view) / tangents)
        away = max(float(needed), _LEAST_M)
        seen = across_view / (away - depth)[:, None]
        target = target + away * 0.5 * (seen.min(axis=0) + seen.max(axis=0)) @ across
    return target, target + away * towards


def _corners(item: CellObject, pose: Transform) -> Array:
    own = _CORNERS * item.size + item.shape.middle
    corners: Array = own @ pose[:3, :3].T + pose[:3, 3]
    return corners


def _directions(tpg: TemporalPlanGraph) -> list[Array]:
    """Return suitable directions from the site to the camera, unit vectors."""
    if any(robot.model.is_mobile for robot in tpg.cell.robots):
        along = _main_axis([h.pose[:2, 3] for h in tpg.handlings if h.holder is None])
        turns = np.concatenate([_SITE_TURNS, _SITE_TURNS + math.pi])
        slope = _SITE_SLOPE
    else:
        bases = [foot_position(robot)[:2] for robot in tpg.cell.robots]
        line = bases[-1] - bases[0] if bases else np.zeros(2)
        along = math.atan2(line[1], line[0]) if np.linalg.norm(line) > 1e-6 else 0.0
        turns, slope = np.array([_ARMS_TURN]), _ARMS_SLOPE
    angles = along - math.pi / 2 + turns
    towards = np.stack([np.cos(angles), np.sin(angles), np.full(len(angles), slope)])
    return list((towards / np.linalg.norm(towards, axis=0)).T)


def _main_axis(places: list[Array]) -> float:
    """Return the direction of largest extent of places on the ground [rad]."""
    if len(places) < 2:
        return 0.0
    _, vectors = np.linalg.eigh(np.cov(np.array(places).T))
    return math.atan2(vectors[1, -1], vectors[0, -1])
