"""The same transits planned by roboplan, a planner in C++."""

from __future__ import annotations

from itertools import combinations
from xml.etree import ElementTree

import numpy as np
from roboplan import core, rrt

from benchmarks.transits.scenes import BoxScene, Query
from planning.cell.robot_model import RobotModel
from planning.transforms import Array


class Peer:
    """Roboplan's RRT-Connect and shortcutting in a scene.

    Args:
        scene: the arm and the boxes.
        step: longest step between the configurations that it looks at on a motion [rad].
    """

    def __init__(self, scene: BoxScene, step: float) -> None:
        model = scene.model
        self._step = step
        self._names = list(model.joint_names)
        description = core.loadUrdfSceneDescriptionFromXml(
            _without_fingers(model), list(model.package_dirs)
        )
        self._scene = core.Scene("boxes", description)
        self._scene.addGroup("arm", self._names)
        self._scene.allowAdjacentLinkCollisions()
        self._scene.setCollisions(_never_collide(model), False)
        colour, still = np.ones(4), sorted(_links(model, base=True))
        for k, (size, pose) in enumerate(zip(scene.sizes, scene.poses, strict=True)):
            self._scene.addBoxGeometry(
                f"box{k}", "universe", core.Box(*size), np.asfortranarray(pose), colour
            )
            still.append(f"box{k}")
        self._scene.setCollisions(list(combinations(still, 2)), False)

    def plan(self, query: Query, seed: int) -> Array | None:
        """Return a shortened path, shape (w, n), None where none is found.

        Args:
            query: the transit.
            seed: of the search and of the shortcutting.
        """
        planner = rrt.RRT(
            self._scene,
            rrt.RRTOptions(
                group_name="arm",
                max_nodes=20_000,
                max_connection_distance=0.7,
                collision_check_step_size=self._step,
                max_planning_time=1.0,
                rrt_connect=True,
            ),
        )
        planner.setRngSeed(seed)
        try:
            path = planner.plan(
                core.JointConfiguration(self._names, query.start),
                core.JointConfiguration(self._names, query.goal),
            )
        except RuntimeError:
            return None
        options = core.PathShortcuttingOptions("arm", self._step, 100, seed)
        path = core.PathShortcutter(self._scene, options).shortcut(path)
        return np.array(path.positions)


def _without_fingers(model: RobotModel) -> str:
    """Return a description whose fingers are fixed 20 mm from the middle, as ours are."""
    root = ElementTree.parse(model.urdf).getroot()
    for joint in root.iter("joint"):
        if joint.get("type") == "prismatic" and joint.get("name") not in (
            model.joint_names
        ):
            origin, axis = joint.find("origin"), joint.find("axis")
            assert origin is not None
            assert axis is not None
            place, along = (
                np.array(item.get("xyz", "0 0 0").split(), dtype=np.float64)
                for item in (origin, axis)
            )
            origin.set("xyz", " ".join(map(str, place + 0.02 * along)))
            joint.set("type", "fixed")
            for item in joint.findall("mimic"):
                joint.remove(item)
    return ElementTree.tostring(root, encoding="unicode")


def _links(model: RobotModel, *, base: bool) -> dict[str, list[int]]:
    """Return the numbers of the bodies of each link, those of the base or all."""
    links: dict[str, list[int]] = {}
    for k, part in enumerate(model.parts):
        if part.joint < 0 or not base:
            links.setdefault(part.body.name.rsplit("_", 1)[0], []).append(k)
    return links


def _never_collide(model: RobotModel) -> list[tuple[str, str]]:
    """Return the pairs of links no bodies of which are held apart by our checker."""
    links = _links(model, base=False)
    return [
        (one, two)
        for one, two in combinations(links, 2)
        if all(
            (min(i, j), max(i, j)) in model.never_collide
            for i in links[one]
            for j in links[two]
        )
    ]
