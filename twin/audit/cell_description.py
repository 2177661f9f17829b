"""The audit's description of a cell: URDF files, boxes and allowed contacts; no geometry.

Capsules, hulls and kinematics of the planner stay behind: Bullet reads the URDF files itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.robots.registry import ROBOTS
from planning.tasks.task_graph import AllowedContact
from planning.transforms import Array, Indices, Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph


@dataclass(frozen=True)
class AuditRobot:
    """A robot as the audit loads it.

    Attributes:
        name: in the cell.
        urdf: its description.
        package_dirs: where meshes are looked up.
        base: pose in the world.
        joints: names of the moved joints, base to tip.
        frozen: values of joints held still, where not zero [rad or m].
        tool_links: links that are the tool; all others are the arm.
        flange: pose of the flange in the frame of the last moved link: what ``objects.parquet``
            calls ``<robot>/flange``.
        home: HOME configuration, shape (n,).
    """

    name: str
    urdf: Path
    package_dirs: tuple[Path, ...]
    base: Transform
    joints: tuple[str, ...]
    frozen: Mapping[str, float]
    tool_links: frozenset[str]
    flange: Transform
    home: Array


@dataclass(frozen=True)
class AuditBox:
    """A box: a fixture or an object, by its edge lengths and (first) pose of its centre.

    A box that comes ``later`` is not there before the recording has a row of it.
    """

    name: str
    size: Array
    pose: Transform
    later: bool = False


@dataclass(frozen=True)
class AuditScene:
    """Everything the audit knows besides what was executed.

    Attributes:
        robots: all robots.
        fixtures: boxes that never move.
        objects: boxes that may be handled.
        allowed: who may touch whom, and when.
        task_of_node: per robot, the task of each of its nodes.
    """

    robots: tuple[AuditRobot, ...]
    fixtures: tuple[AuditBox, ...]
    objects: tuple[AuditBox, ...]
    allowed: tuple[AllowedContact, ...]
    task_of_node: Mapping[str, Indices]


def scene_of(tpg: TemporalPlanGraph) -> AuditScene:
    """Return the scene of a plan."""
    nodes = {r.name: np.empty(0, dtype=np.int64) for r in tpg.cell.robots}
    nodes.update({chain.robot: chain.task for chain in tpg.chains})
    return AuditScene(
        tuple(_robot(placed) for placed in tpg.cell.robots),
        tuple(AuditBox(f.name, f.size, f.pose) for f in tpg.cell.fixtures),
        tuple(AuditBox(o.name, o.size, o.start, o.later) for o in tpg.cell.objects),
        tpg.allowed,
        nodes,
    )


def _robot(placed: PlacedRobot) -> AuditRobot:
    model = placed.model
    # pinocchio names shapes "<link>_<number>"; only the names are used here.
    tool = {p.body.name.rsplit("_", 1)[0] for p in model.parts if p.group == "tool"}
    entry = ROBOTS.get(model.name)
    return AuditRobot(
        placed.name,
        model.urdf,
        model.package_dirs,
        placed.base,
        model.joint_names,
        {} if entry is None else entry.frozen,
        frozenset(tool),
        model.flange,
        placed.home,
    )
