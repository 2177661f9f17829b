"""Definitions of the exported ROS 2 message types as text, as MCAP files must contain them."""

from __future__ import annotations

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
JOINT_STATE = "sensor_msgs/msg/JointState"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"

_RULE = "=" * 80 + "\n"

_FIELDS: dict[str, tuple[str, ...]] = {
    JOINT_STATE: (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\n"
        "float64[] velocity\nfloat64[] effort\n",
        *_HEADER,
    ),
    TF_MESSAGE: (
        "geometry_msgs/TransformStamped[] transforms\n",
        *_TRANSFORM,
        *_HEADER,
    ),
    JOINT_TRAJECTORY: (
        "std_msgs/Header header\nstring[] joint_names\n"
        "trajectory_msgs/JointTrajectoryPoint[] points\n",
        _TRAJECTORY_POINT,
        _DURATION,
        *_HEADER,
    ),
    MARKER_ARRAY: ("visualization_msgs/Marker[] markers\n", *_MARKER, *_HEADER),
}
"""Own fields of every message, and those of all that it is made of."""

DEFINITIONS = {kind: _RULE.join(fields) for kind, fields in _FIELDS.items()}
"""Of every message that is written, by its type; those of ROS 2 Humble and later."""
