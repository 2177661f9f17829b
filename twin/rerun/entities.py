"""Entity names, timeline and poses of a Rerun recording."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import rerun as rr

from planning.transforms import Array, quat_wxyz
from twin.rerun.viewer import TIMELINE

WORLD_FRAME = "world"

# Top-level entities of a recording; lanes are timelines of tasks.
LANES = "lanes"
PROGRESS = "progress"
WAITING = "waiting"
TRACKING = "tracking"
EVENTS = "events"
OBJECTS = "objects"
FIXTURES = "fixtures"
FORECAST = "forecast"


def entity_path(*parts: str) -> str:
    """Return the path of an entity whose parts may hold any character."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for part in parts)


def robot_part(robot: str) -> str:
    """Return the path part under which a robot is drawn: one part, as the loader needs."""
    return f"robot-{robot}"


def time_column(t_ns: npt.ArrayLike) -> rr.TimeColumn:
    """Return simulated times [ns] as the recording's only timeline."""
    exact = np.asarray(t_ns, dtype=np.int64).astype("timedelta64[ns]")
    return rr.TimeColumn(TIMELINE, duration=exact)


def quat_xyzw(pose: Array) -> Array:
    """Return a rotation as a Rerun quaternion: (x, y, z, w)."""
    return np.roll(quat_wxyz(pose), -1)


def fixed_pose(pose: Array, parent: str, child: str) -> rr.Transform3D:
    """Return the pose of a frame in another as a whole transform."""
    return rr.Transform3D(
        translation=pose[:3, 3],
        quaternion=rr.Quaternion(xyzw=quat_xyzw(pose)),
        parent_frame=parent,
        child_frame=child,
    )
