"""Tables of a run: events, and the rows of ``trajectory.parquet`` and ``objects.parquet``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from planning.files import replace_atomically
from planning.tasks.task import Handling
from planning.transforms import Array, quat_wxyz
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS
from twin.runs.events import Event
from twin.runs.execution_record import ExecutionRecord
from twin.runs.folder import OBJECTS, TRAJECTORY
from twin.runs.trajectory import (
    Placement,
    Trajectory,
    object_placements,
    robot_trajectories,
)

WORLD = "world"
FLANGE = "flange"


def trajectory_table(
    trajectories: Sequence[Trajectory], measured: Sequence[str] = ()
) -> pa.Table:
    """Return columns t_s, robot, q_0 ... q_k and node, robot after robot.

    If robots have limits of acceleration, there are also columns v_0 ... v_k and a_0 ... a_k. A robot with fewer joints
    than another has nulls in the remaining columns.

    Args:
        trajectories: of the robots.
        measured: robots with measured motions; noted in the table's metadata.
    """
    counts = [len(motion.t_ns) for motion in trajectories]
    names = pa.array([motion.robot for motion in trajectories], pa.string())
    index = pa.array(np.repeat(np.arange(len(counts), dtype=np.int32), counts))
    columns = {
        "t_s": pa.array(_joined([m.t_ns for m in trajectories]) / NANOSECONDS),
        "robot": pa.DictionaryArray.from_arrays(index, names),
    }
    columns |= _joint_columns("q", [m.q for m in trajectories])
    if any(m.v is not None for m in trajectories):
        columns |= _joint_columns("v", [_or_zero(m, m.v) for m in trajectories])
        columns |= _joint_columns("a", [_or_zero(m, m.a) for m in trajectories])
    columns["node"] = pa.array(_joined([m.node for m in trajectories]))
    about = {"measured": ",".join(measured)} if measured else None
    return pa.table(columns, metadata=about)


def _or_zero(motion: Trajectory, values: Array | None) -> Array:
    return np.zeros_like(motion.q) if values is None else values


def _joint_columns(name: str, values: Sequence[Array]) -> dict[str, pa.ChunkedArray]:
    """Return one column per joint from each robot's rows of values."""
    columns = {}
    for j in range(max((rows.shape[1] for rows in values), default=0)):
        chunks = [
            pa.array(np.ascontiguousarray(rows[:, j]))
            if j < rows.shape[1]
            else pa.nulls(len(rows), pa.float64())
            for rows in values
        ]
        columns[f"{name}_{j}"] = pa.chunked_array(chunks, pa.float64())
    return columns


def _joined(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.zeros(0, np.int64), *parts])


def objects_table(placements: Sequence[Placement]) -> pa.Table:
    """Return columns t_s, object, parent, xyz and quat_wxyz, by time.

    The parent is ``world``, ``<robot>/flange`` for an object that is held, or ``(gone)``.
    """
    return pa.table(
        {
            "t_s": pa.array([p.t_ns / NANOSECONDS for p in placements], pa.float64()),
            "object": pa.array([p.object for p in placements], pa.string()),
            "parent": pa.array(
                [_parent(p) for p in placements],
                pa.string(),
            ),
            "xyz": pa.array(
                [p.pose[:3, 3].tolist() for p in placements], pa.list_(pa.float64(), 3)
            ),
            "quat_wxyz": pa.array(
                [quat_wxyz(p.pose).tolist() for p in placements],
                pa.list_(pa.float64(), 4),
            ),
        }
    )


def _parent(placement: Placement) -> str:
    if placement.holder == Handling.GONE:
        return Handling.GONE
    return WORLD if placement.holder is None else f"{placement.holder}/{FLANGE}"


def events_table(rows: Sequence[Event]) -> pa.Table:
    """Return events with the keys of ``events.jsonl`` as columns."""
    # Dividing once rounds to the nearest double, which prints as the decimals of the log.
    return pa.table(
        {
            "t_s": pa.array([e.t_ns / NANOSECONDS for e in rows], pa.float64()),
            "robot": pa.array([e.robot for e in rows], pa.string()),
            "kind": pa.array([e.kind for e in rows], pa.string()),
            "task": pa.array([e.task for e in rows], pa.int64()),
            "node": pa.array([e.node for e in rows], pa.int64()),
            "object": pa.array([e.object for e in rows], pa.string()),
            "detail": pa.array([e.detail for e in rows], pa.string()),
        }
    )


def write_motion(folder: Path, tpg: TemporalPlanGraph, run: ExecutionRecord) -> None:
    """Write both tables of a run into its folder.

    Raises:
        OutputError: a file cannot be written.
    """
    moves = trajectory_table(robot_trajectories(tpg, run), tuple(run.measured))
    write_table(folder / TRAJECTORY, moves)
    write_table(folder / OBJECTS, objects_table(object_placements(tpg, run)))


def write_table(path: Path, table: pa.Table) -> None:
    """Write a table as Parquet; an interrupted write leaves no partial file."""
    with replace_atomically(path) as temporary:
        pq.write_table(table, temporary, compression="zstd")
