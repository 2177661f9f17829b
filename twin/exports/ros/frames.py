"""Poses of robot links and objects over the time of a run, as translations and quaternions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.tasks.task import Handling
from planning.transforms import Array, from_quat_wxyz, quat_wxyz
from twin.durations.nanoseconds import NANOSECONDS
from twin.exports.ros.drawn_robot import DrawnRobot
from twin.exports.ros.messages import FramePose, frame_pose
from twin.trial.run_result import RunResult

WORLD = "world"


def link_frame(robot: str, link: str) -> str:
    """Return the name of the frame of a link."""
    return f"{robot}/{link}"


def flange_frame(robot: str) -> str:
    """Return the name of the frame that held objects are attached to."""
    return f"{robot}/@flange"


def fixed_frames(robot: PlacedRobot, drawn: DrawnRobot) -> Iterator[FramePose]:
    """Yield the frames of a robot that never move as seen from their parents."""
    names = [link_frame(robot.name, link) for link in drawn.carriers]
    yield frame_pose(WORLD, names[0], robot.base)
    for link in drawn.links:
        child = link_frame(robot.name, link.name)
        yield frame_pose(names[link.joint], child, link.pose)
    yield frame_pose(names[-1], flange_frame(robot.name), robot.model.flange)


def moved_frames(
    robot: PlacedRobot, drawn: DrawnRobot, q: Array
) -> Iterator[list[FramePose]]:
    """Yield the frames after the joints of a robot, for each of some configurations.

    Args:
        robot: the robot.
        drawn: names its links.
        q: configurations, shape (m, n).
    """
    chain = robot.model.chain
    names = [link_frame(robot.name, link) for link in drawn.carriers]
    xyz = np.empty((len(q), robot.model.dof, 3))
    quat = np.empty((len(q), robot.model.dof, 4))
    for j, place in enumerate(chain.placement):
        xyz[:, j], fixed = place[:3, 3], np.roll(quat_wxyz(place), -1)
        if chain.prismatic[j]:
            xyz[:, j] += q[:, j, None] * (place[:3, :3] @ chain.axis[j])
            quat[:, j] = fixed
        else:
            half = 0.5 * q[:, j, None]
            turn = np.hstack([np.sin(half) * chain.axis[j], np.cos(half)])
            quat[:, j] = _product(fixed, turn)
    for k in range(len(q)):
        yield [
            FramePose(names[j], names[j + 1], xyz[k, j], quat[k, j])
            for j in range(robot.model.dof)
        ]


def _product(one: Array, others: Array) -> Array:
    """Return a quaternion (x, y, z, w) times each of others, shape (m, 4)."""
    v, w = one[:3], one[3]
    u, s = others[:, :3], others[:, 3:]
    vector = w * u + s * v + np.cross(np.broadcast_to(v, u.shape), u)
    return np.hstack([vector, w * s - (u @ v)[:, None]])


@dataclass(frozen=True)
class ObjectState:
    """The objects that are there from a time on, until the next such time.

    Attributes:
        t_ns: when [ns].
        changed: names of those that arrive or are transferred.
        gone: whether one has left.
        frames: of all that are there, by name.
    """

    t_ns: int
    changed: tuple[str, ...]
    gone: bool
    frames: dict[str, FramePose]


def object_frame(name: str) -> str:
    """Return the name of the frame of an object."""
    return f"objects/{name}"


def object_states(run: RunResult) -> Iterator[ObjectState]:
    """Yield object placements after each change, by time."""
    table = run.objects
    times = np.rint(table["t_s"].to_numpy() * NANOSECONDS).astype(np.int64)
    columns = ("object", "parent", "xyz", "quat_wxyz")
    rows = list(zip(*(table[name].to_pylist() for name in columns), strict=True))
    frames: dict[str, FramePose] = {}
    for t_ns in np.unique(times).tolist():
        changed, gone = [], False
        for k in np.flatnonzero(times == t_ns).tolist():
            name, parent, xyz, quat = rows[k]
            if parent == Handling.GONE:
                frames.pop(name, None)
                gone = True
                continue
            if parent != WORLD:
                parent = flange_frame(parent.rpartition("/")[0])
            pose = from_quat_wxyz(xyz, quat)
            frames[name] = frame_pose(parent, object_frame(name), pose)
            changed.append(name)
        there = tuple(name for name in changed if name in frames)
        yield ObjectState(t_ns, there, gone, dict(frames))
