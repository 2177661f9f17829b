"""The tables of a run: what happened, where robots were, where objects were."""

from __future__ import annotations

from collections.abc import Mapping

import pyarrow as pa

from twin.durations.nanoseconds import NANOSECONDS
from twin.exports.recorded_run import RecordedRun


def run_tables(run: RecordedRun) -> Mapping[str, pa.Table]:
    """Return the tables ``events``, ``trajectory`` and ``objects``.

    The columns of the first are the keys of ``events.jsonl``, the others are as in the folder.
    """
    rows = run.events
    # Dividing once rounds to the nearest double, which prints as the decimals of the log.
    events = pa.table(
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
    return {"events": events, "trajectory": run.trajectory, "objects": run.objects}
