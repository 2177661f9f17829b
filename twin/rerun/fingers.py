"""Fingers in the Rerun recording: they close on grasped objects and open to release them.

Fingers of robots are joints of their description; those of a mounted tool are turned into joints where
its shapes identify them. They close until they touch the part, see ``planning.grips.pads``. A tool from
a rack is drawn as an object with open fingers.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from xml.etree.ElementTree import Element, SubElement

import rerun as rr
from rerun.urdf import UrdfTree

from planning.cell.workcell import CellObject, PlacedRobot
from planning.grips.pads import finger_sides, pads_at
from planning.kinematics.kinematics import frame_pose
from planning.robots.descriptions.urdf_geometry import joint_link, pose_in_root
from planning.robots.registry import ROBOTS
from planning.tasks.task import Actuation, Task
from planning.transforms import Array, Transform, inverse
from scheduling.graph.actuations import actuation_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS
from twin.rerun.entities import entity_path, robot_part, time_column
from twin.runs.execution_record import ExecutionRecord
from twin.runs.trajectory import Placement

_FINGER = ".finger_"
"""In the names of links and joints that fingers of tools are made."""

_BETWEEN = "tool"
"""Frame between the fingers of a tool, which close along its y axis."""

_FRAME_NS = NANOSECONDS // 20
"""Least time between two frames [ns]."""


def open_finger_joints(robot: PlacedRobot, tree: UrdfTree) -> dict[str, float]:
    """Return the joints of a robot's fingers and their open values [m].

    Args:
        robot: whose fingers they are.
        tree: as it is drawn, see ``split_fingers``.
    """
    names = (joint.name for joint in tree.joints())
    return _own_fingers(robot) | {name: 0.0 for name in names if _FINGER in name}


def _own_fingers(robot: PlacedRobot) -> dict[str, float]:
    """Return the finger joints of a robot's own description and their open values [m]."""
    entry = ROBOTS.get(robot.model.name)
    return dict(entry.frozen) if entry and robot.tool is None else {}


def split_fingers(robot: PlacedRobot, root: Element) -> None:
    """Make the fingers of a tool prismatic links in a robot description, open at zero.

    What a link shows is a finger where all that it collides with is on one side, see
    ``planning.grips.pads.finger_sides``; else each of its shapes on one side is one, if there is one to
    show for each to collide with.

    Args:
        robot: with a tool on it.
        root: of the description; changed.
    """
    if _own_fingers(robot) or _BETWEEN not in robot.model.frames:
        return
    tip = robot.model.frame_in_last_joint(_BETWEEN)
    sides = finger_sides(robot.model, tip)
    if sides is None:
        return
    outwards = {
        body.name: y
        for y, side in zip((1.0, -1.0), sides, strict=True)
        for body in side
    }
    above = {joint_link(joint, "child"): joint for joint in root.findall("joint")}
    last = joint_link(
        next(j for j in above.values() if j.get("name") == robot.model.joint_names[-1]),
        "child",
    )
    last_at = pose_in_root(last, above, {}, robot.name)
    for link in root.findall("link"):
        name = str(link.get("name"))
        shown, solid = link.findall("visual"), link.findall("collision")
        signs = [outwards.get(f"{name}_{k}") for k in range(len(solid))]
        if not any(signs):
            continue
        if len(set(signs)) == 1:
            signs = signs[:1] * len(shown)
        elif len(shown) != len(solid):
            continue
        at = inverse(last_at) @ pose_in_root(name, above, {}, robot.name)
        for k, (visual, y) in enumerate(zip(shown, signs, strict=True)):
            if y is not None:
                link.remove(visual)
                axis = y * at[:3, :3].T @ tip[:3, 1]
                root.extend(_sliding(name, f"{name}{_FINGER}{k}", visual, axis))


def _sliding(parent: str, name: str, visual: Element, axis: Array) -> Iterator[Element]:
    """Yield a link with one visual, and its prismatic joint on another link."""
    link, joint = (
        Element("link", name=name),
        Element("joint", name=name, type="prismatic"),
    )
    link.append(visual)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=name)
    SubElement(joint, "axis", xyz=" ".join(f"{x:.9g}" for x in axis))
    SubElement(joint, "limit", lower="-1", upper="1", effort="1", velocity="1")
    yield from (link, joint)


def closing_distance(
    robot: PlacedRobot, item: CellObject, in_flange: Transform
) -> float:
    """Return the closing travel of each finger on a part; 0 where they would not touch it [m].

    Args:
        robot: whose fingers close along the y axis of their frame.
        item: the part.
        in_flange: pose of it in the frame of the robot's flange.
    """
    if _BETWEEN not in robot.model.frames:
        return 0.0
    tip = robot.model.frame_in_last_joint(_BETWEEN)
    grip = inverse(in_flange) @ robot.model.frame_in_flange(_BETWEEN)
    pads = pads_at(robot.model, tip, item.shape, grip)
    if pads is None or pads.off is None:
        return 0.0
    return 0.5 * sum(max(pad.travel or 0.0, 0.0) for pad in pads.sides)


def finger_motions(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    placements: Sequence[Placement],
    robot: PlacedRobot,
) -> Iterator[tuple[int, int, str, float]]:
    """Yield finger motions of a robot: from, to [ns], action, and travel of each [m]."""
    rows: dict[str, list[Placement]] = {}
    for placement in placements:
        rows.setdefault(placement.object, []).append(placement)
    for k, nodes in enumerate(actuation_nodes(tpg)):
        chain = tpg.chains[k]
        for node, act in nodes.items():
            task, end = tpg.tasks[int(chain.task[node])], int(run.end_ns[k][node])
            if act.robot != robot.name or task.object is None or end < 0:
                continue
            q = chain.waypoints[chain.first[node]]
            own = rows.get(task.object, [])
            own = own[: bisect_right([p.t_ns for p in own], end)]
            pose = _in_flange(robot, q, task, own)
            if pose is not None:
                begin = end - int(run.duration_ns[k][node])
                displacement = closing_distance(
                    robot, tpg.cell.object(task.object), pose
                )
                yield begin, end, act.act, displacement


def _in_flange(
    robot: PlacedRobot, q: Array, task: Task, before: Sequence[Placement]
) -> Transform | None:
    """Return the pose of a part in the flange frame of the robot that grasps or releases it.

    Args:
        robot: the robot.
        q: where it stands, if it is its own task, shape (n,).
        task: in which it does.
        before: where the part was up to the end of that, by time.
    """
    for handling in task.handlings:
        if handling.object == task.object and handling.holder == robot.name:
            return handling.pose
    # An object handed over was held by this robot before.
    for at in before[:-3:-1]:
        if at.holder == robot.name:
            return at.pose
        if at.holder is None:
            return inverse(frame_pose(robot, q)) @ at.pose
    return None


def move_fingers(
    rec: rr.RecordingStream,
    tree: UrdfTree,
    robot: PlacedRobot,
    moves: Sequence[tuple[int, int, str, float]],
) -> None:
    """Move the fingers of a drawn robot, if it has any.

    Args:
        rec: the recording.
        tree: of the robot.
        robot: whose fingers they are.
        moves: as ``finger_motions`` yields them.
    """
    fingers = open_finger_joints(robot, tree) if moves else {}
    joints = {joint.name: joint for joint in tree.joints()}
    for name, opened in fingers.items():
        t_ns: list[int] = []
        values: list[float] = []
        for begin, end, act, displacement in sorted(moves):
            closed = opened - displacement
            first, last = (
                (opened, closed) if act == Actuation.CLOSE else (closed, opened)
            )
            count = max(1, (end - begin) // _FRAME_NS)
            for j in range(count + 1):
                t_ns.append(begin + (end - begin) * j // count)
                values.append(first + (last - first) * j / count)
        rec.send_columns(
            entity_path(robot_part(robot.name), "joints", name),
            indexes=[time_column(t_ns)],
            columns=joints[name].compute_transform_columns(values, clamp=False),
        )
