"""Frames of objects, which hang on the world or on the flange of a robot, and when that changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planning.tasks.task import GONE
from planning.transforms import from_quat_wxyz
from twin.durations import NANOSECONDS
from twin.exports.ros.messages import FramePose, frame_pose
from twin.exports.ros.robot_frames import WORLD, flange_frame
from twin.trial.run_result import RunResult


@dataclass(frozen=True)
class ObjectsThere:
    """The objects that are there from a time on, until the next such time.

    Attributes:
        t_ns: when [ns].
        changed: names of those that come, or change hands.
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


def objects_there(run: RunResult) -> Iterator[ObjectsThere]:
    """Yield which objects are where whenever that changes, by time."""
    table = run.objects
    times = np.rint(table["t_s"].to_numpy() * NANOSECONDS).astype(np.int64)
    columns = ("object", "parent", "xyz", "quat_wxyz")
    rows = list(zip(*(table[name].to_pylist() for name in columns), strict=True))
    frames: dict[str, FramePose] = {}
    for t_ns in np.unique(times).tolist():
        changed, gone = [], False
        for k in np.flatnonzero(times == t_ns).tolist():
            name, parent, xyz, quat = rows[k]
            if parent == GONE:
                del frames[name]
                gone = True
                continue
            if parent != WORLD:
                parent = flange_frame(parent.rpartition("/")[0])
            pose = from_quat_wxyz(xyz, quat)
            frames[name] = frame_pose(parent, object_frame(name), pose)
            changed.append(name)
        there = tuple(name for name in changed if name in frames)
        yield ObjectsThere(t_ns, there, gone, dict(frames))
