"""Encoding of the exported ROS 2 messages to bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Transform, quat_wxyz
from twin.exports.ros.cdr import CdrMessage
from twin.exports.segments import Segment

Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""

_TRIANGLE_LIST = 11
_ADD, _DELETE_ALL = 0, 3
_NOTHING = np.empty((0, 3))


@dataclass(frozen=True, eq=False)
class FramePose:
    """Pose of a frame in its parent frame.

    Attributes:
        parent, child: their names.
        xyz: of the origin, shape (3,) [m].
        quat_xyzw: rotation, shape (4,).
    """

    parent: str
    child: str
    xyz: Array
    quat_xyzw: Array


def frame_pose(parent: str, child: str, pose: Transform) -> FramePose:
    """Return the pose of a frame in another one."""
    return FramePose(parent, child, pose[:3, 3], np.roll(quat_wxyz(pose), -1))


@dataclass(frozen=True, eq=False)
class Marker:
    """Triangles of one colour that move with a frame.

    Attributes:
        frame: its name.
        space: name that identifies the marker together with its number.
        number: of the marker.
        corners: three rows per triangle, in the frame, shape (3 k, 3) [m].
        colour: of all of them.
    """

    frame: str
    space: str
    number: int
    corners: Array
    colour: Colour


def joint_state(t_ns: int, names: tuple[str, ...], q: Array, v: Array | None) -> bytes:
    """Return a ``sensor_msgs/JointState``.

    Args:
        t_ns: its time [ns].
        names: of the joints.
        q: positions, shape (n,) [rad or m].
        v: speeds, likewise, None where they are not known.
    """
    out = CdrMessage()
    out.header(t_ns, "")
    out.strings(names)
    out.sequence(q)
    out.sequence(v)
    out.sequence(None)
    return out.data


def tf_message(t_ns: int, poses: Sequence[FramePose]) -> bytes:
    """Return a ``tf2_msgs/TFMessage`` of one time [ns]."""
    out = CdrMessage()
    out.count(len(poses))
    for pose in poses:
        out.header(t_ns, pose.parent)
        out.string(pose.child)
        out.float64(pose.xyz)
        out.float64(pose.quat_xyzw)
    return out.data


def joint_trajectory(t_ns: int, segment: Segment) -> bytes:
    """Return a ``trajectory_msgs/JointTrajectory`` that starts at a time [ns]."""
    out = CdrMessage()
    out.header(t_ns, "")
    out.strings(segment.joint_names)
    out.count(len(segment.t_ns))
    for k, passed_ns in enumerate(segment.t_ns.tolist()):
        out.sequence(segment.q[k])
        out.sequence(None if segment.v is None else segment.v[k])
        out.sequence(None if segment.a is None else segment.a[k])
        out.sequence(None)
        out.time(passed_ns)
    return out.data


def marker_array(markers: Sequence[Marker]) -> bytes:
    """Return a ``visualization_msgs/MarkerArray`` that takes the place of all before it."""
    out = CdrMessage()
    out.count(1 + len(markers))
    _write(out, Marker("", "", 0, _NOTHING, (0.0, 0.0, 0.0, 0.0)), _DELETE_ALL)
    for marker in markers:
        _write(out, marker, _ADD)
    return out.data


def _write(out: CdrMessage, marker: Marker, action: int) -> None:
    # With a stamp of 0 the viewer uses the pose of the frame at the time that it shows.
    out.header(0, marker.frame)
    out.string(marker.space)
    out.numbers("i", marker.number, _TRIANGLE_LIST, action)
    out.float64(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))  # pose
    out.float64(np.ones(3))  # scale
    out.numbers("f", *marker.colour)
    out.time(0)  # lifetime: unlimited
    out.numbers("B", True)  # locked to its frame
    out.count(len(marker.corners))
    out.float64(marker.corners)
    out.count(0)  # colours per corner
    out.string("")  # texture: resource, image, coordinates
    out.header(0, "")
    out.string("")
    out.count(0)
    out.count(0)
    out.string("")  # text
    out.string("")  # mesh: resource, file, its materials
    out.string("")
    out.count(0)
    out.numbers("B", False)
