"""Random boxes around an arm, and pairs of configurations that no straight motion joins."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from xml.etree import ElementTree

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.cell.shape import box_shape
from planning.cell.workcell import (
    Clearances,
    Fixture,
    PlacedRobot,
    Workcell,
    start_state,
)
from planning.geometry.scene_checker import SceneChecker
from planning.robots.registry import ROBOTS, robot_model
from planning.transforms import Array, Transform, from_rpy, identity

ROBOTS_MEASURED = ("ur10", "panda", "gp4")
BOXES = (5, 20, 60)

_LARGER = 1.5
"""A UR10 reaches 1.3 m, a UR5e 0.85 m."""

_REACH_M = {"ur10": 1.3, "panda": 0.85, "gp4": 0.55}
_GRAZE_M = 0.003
"""Our round links are polyhedra around them: so far others may come into our boxes."""

_CLEAR_OF_BASE = 0.25
"""Boxes whose centre is nearer to the base, as a share of the reach, would shut the robot in."""


@dataclass(frozen=True)
class Query:
    """A transit to plan.

    Attributes:
        start, goal: free configurations, shape (n,).
    """

    start: Array
    goal: Array


@dataclass(frozen=True)
class BoxScene:
    """An arm among boxes.

    Attributes:
        model: the arm, its base at the origin.
        sizes: edge lengths of the boxes, shape (b, 3) [m].
        poses: of their centres.
        checker: of the arm's motions.
        lenient: likewise, among boxes that are 3 mm smaller on every side.
        queries: transits to plan.
    """

    model: RobotModel
    sizes: Array
    poses: tuple[Transform, ...]
    checker: SceneChecker
    lenient: SceneChecker
    queries: tuple[Query, ...]


@cache
def arm(name: str) -> RobotModel:
    """Return a robot of ours; the UR10 is our UR5e, half as large again."""
    if name != "ur10":
        return robot_model(name)
    root = ElementTree.parse(robot_model("ur5e").urdf).getroot()
    for tag, key in (("origin", "xyz"), ("cylinder", "radius"), ("cylinder", "length")):
        for item in root.iter(tag):
            values = [
                _LARGER * float(value) for value in item.get(key, "0 0 0").split()
            ]
            item.set(key, " ".join(map(str, values)))
    for item in root.iter("box"):
        values = [_LARGER * float(value) for value in item.get("size", "").split()]
        item.set("size", " ".join(map(str, values)))
    path = Path(mkdtemp()) / "ur10.urdf"
    path.write_text(ElementTree.tostring(root, encoding="unicode"))
    return robot_model(str(path))


def make_scene(robot: str, boxes: int, queries: int, seed: int) -> BoxScene:
    """Return a scene and its queries.

    Joints turn from -180 to 180 degrees at both ends of a query, as far as their limits allow.

    Args:
        robot: one of ROBOTS_MEASURED.
        boxes: how many.
        queries: how many.
        seed: of everything that is drawn.
    """
    model = arm(robot)
    rng = np.random.default_rng([ROBOTS_MEASURED.index(robot), boxes, seed])
    home = np.array(ROBOTS["ur5e" if robot == "ur10" else robot].home)
    sizes, poses = np.empty((0, 3)), []
    while len(poses) < boxes:
        size = _REACH_M[robot] * rng.uniform(0.06, 0.25, 3)
        place = _REACH_M[robot] * rng.uniform(-1.0, 1.0, 3)
        pose = from_rpy(place, rng.uniform(-np.pi, np.pi, 3))
        far = np.linalg.norm(place) / _REACH_M[robot]
        if not _CLEAR_OF_BASE < far < 1.0:
            continue
        more = np.vstack([sizes, size])
        if _checker(model, home, more, [*poses, pose]).configuration_free(home):
            sizes = more
            poses.append(pose)
    checker = _checker(model, home, sizes, poses)
    low, high = np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi)
    found: list[Query] = []
    while len(found) < queries:
        ends = []
        while len(ends) < 2:
            q = rng.uniform(low, high)
            if checker.configuration_free(q):
                ends.append(q)
        if not checker.motion_free(*ends):
            found.append(Query(*ends))
    lenient = _checker(model, home, sizes - 2.0 * _GRAZE_M, poses)
    return BoxScene(model, sizes, tuple(poses), checker, lenient, tuple(found))


def _checker(
    model: RobotModel, home: Array, sizes: Array, poses: list[Transform]
) -> SceneChecker:
    fixtures = tuple(
        Fixture(f"box{k}", box_shape(f"box{k}", size), pose)
        for k, (size, pose) in enumerate(zip(sizes, poses, strict=True))
    )
    robot = PlacedRobot("arm", model, identity(), home)
    cell = Workcell((robot,), fixtures, (), Clearances(0.0, 0.0))
    return SceneChecker(cell, "arm", start_state(cell))
