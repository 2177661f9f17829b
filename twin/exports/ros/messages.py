"""Messages of ROS 2, encoded.

CDR, the form that messages of ROS 2 have in a file: little-endian, plain, aligned to own size.

Definitions of the messages that are written, as a file has to hold them: field by field.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Transform, quat_wxyz
from twin.durations.model import NANOSECONDS
from twin.exports.segments import Segment

_ENCAPSULATION = b"\x00\x01\x00\x00"


class CdrMessage:
    """A message that is written field by field, in the order of its definition."""

    def __init__(self) -> None:
        self._data = bytearray(_ENCAPSULATION)

    @property
    def data(self) -> bytes:
        """What has been written so far."""
        return bytes(self._data)

    def numbers(self, form: str, *values: float) -> None:
        """Write numbers of a form of ``struct``: B for bytes and bools, i, I or f."""
        self._align(struct.calcsize(form))
        self._data += struct.pack(f"<{len(values)}{form}", *values)

    def count(self, length: int) -> None:
        """Write the length of a sequence or a string."""
        self.numbers("I", length)

    def float64(self, values: Array) -> None:
        """Write numbers of double precision, without their count."""
        if values.size:
            self._align(8)
            self._data += np.ascontiguousarray(values, dtype="<f8").tobytes()

    def string(self, value: str) -> None:
        """Write a string."""
        encoded = value.encode() + b"\x00"
        self.count(len(encoded))
        self._data += encoded

    def strings(self, values: tuple[str, ...]) -> None:
        """Write a sequence of strings."""
        self.count(len(values))
        for value in values:
            self.string(value)

    def sequence(self, values: Array | None) -> None:
        """Write a sequence of numbers of double precision; None is an empty one."""
        self.count(0 if values is None else values.size)
        if values is not None:
            self.float64(values)

    def time(self, t_ns: int) -> None:
        """Write a time or a duration [ns]."""
        seconds, rest = divmod(t_ns, NANOSECONDS)
        self.numbers("i", seconds)
        self.numbers("I", rest)

    def header(self, t_ns: int, frame: str) -> None:
        """Write a ``std_msgs/Header``."""
        self.time(t_ns)
        self.string(frame)

    def _align(self, size: int) -> None:
        """Fill up with zeros; sizes count from behind the header."""
        self._data += bytes(-(len(self._data) - len(_ENCAPSULATION)) % size)


Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""

_TRIANGLE_LIST = 11
_ADD, _DELETE_ALL = 0, 3
_NOTHING = np.empty((0, 3))


@dataclass(frozen=True, eq=False)
class FramePose:
    """Pose of a frame in another one.

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
        corners: three rows a triangle, in the frame, shape (3 k, 3) [m].
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
    # A stamp of 0 means: wherever the frame is at the time that is looked at.
    out.header(0, marker.frame)
    out.string(marker.space)
    out.numbers("i", marker.number, _TRIANGLE_LIST, action)
    out.float64(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))  # pose
    out.float64(np.ones(3))  # scale
    out.numbers("f", *marker.colour)
    out.time(0)  # for good
    out.numbers("B", True)  # locked to its frame
    out.count(len(marker.corners))
    out.float64(marker.corners)
    out.count(0)  # colours of single corners
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


_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_DURATION = "MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n"
_HEADER = (
    "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n",
    _TIME,
)
_VECTOR = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_POINT = "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
_QUATERNION = (
    "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
)
_TRANSFORM = (
    "MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\n"
    "string child_frame_id\ngeometry_msgs/Transform transform\n",
    "MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\n"
    "geometry_msgs/Quaternion rotation\n",
    _VECTOR,
    _QUATERNION,
)
_TRAJECTORY_POINT = (
    "MSG: trajectory_msgs/JointTrajectoryPoint\nfloat64[] positions\n"
    "float64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
    "builtin_interfaces/Duration time_from_start\n"
)
_MARKER = (
    "MSG: visualization_msgs/Marker\n"
    "int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\nint32 LINE_STRIP=4\n"
    "int32 LINE_LIST=5\nint32 CUBE_LIST=6\nint32 SPHERE_LIST=7\nint32 POINTS=8\n"
    "int32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\nint32 TRIANGLE_LIST=11\n"
    "int32 ADD=0\nint32 MODIFY=0\nint32 DELETE=2\nint32 DELETEALL=3\n"
    "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
    "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
    "builtin_interfaces/Duration lifetime\nbool frame_locked\n"
    "geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\n"
    "string texture_resource\nsensor_msgs/CompressedImage texture\n"
    "visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\n"
    "string mesh_resource\nvisualization_msgs/MeshFile mesh_file\n"
    "bool mesh_use_embedded_materials\n",
    "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\n"
    "geometry_msgs/Quaternion orientation\n",
    "MSG: std_msgs/ColorRGBA\nfloat32 r\nfloat32 g\nfloat32 b\nfloat32 a\n",
    "MSG: sensor_msgs/CompressedImage\nstd_msgs/Header header\nstring format\n"
    "uint8[] data\n",
    "MSG: visualization_msgs/UVCoordinate\nfloat32 u\nfloat32 v\n",
    "MSG: visualization_msgs/MeshFile\nstring filename\nuint8[] data\n",
    _POINT,
    _VECTOR,
    _QUATERNION,
    _DURATION,
)


def _definition(fields: str, *needed: str) -> str:
    """Return the fields of a message, and behind lines of = those of all that it is made of."""
    return ("=" * 80 + "\n").join([fields, *needed])


JOINT_STATE = "sensor_msgs/msg/JointState"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"

DEFINITIONS = {
    JOINT_STATE: _definition(
        "std_msgs/Header header\nstring[] name\nfloat64[] position\n"
        "float64[] velocity\nfloat64[] effort\n",
        *_HEADER,
    ),
    TF_MESSAGE: _definition(
        "geometry_msgs/TransformStamped[] transforms\n", *_TRANSFORM, *_HEADER
    ),
    JOINT_TRAJECTORY: _definition(
        "std_msgs/Header header\nstring[] joint_names\n"
        "trajectory_msgs/JointTrajectoryPoint[] points\n",
        _TRAJECTORY_POINT,
        _DURATION,
        *_HEADER,
    ),
    MARKER_ARRAY: _definition(
        "visualization_msgs/Marker[] markers\n", *_MARKER, *_HEADER
    ),
}
"""Of every message that is written, by its type; those of ROS 2 Humble and later."""
