"""Rows of replications: outcome, makespan, and waits by cause."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
)
from twin.durations import NANOSECONDS, Nanoseconds
from twin.engine.bulk.max_plus import Completions
from twin.engine.bulk.policy_graph import OTHER

COMPLETED, ERROR = "completed", "error"

WAIT_COLUMNS = {
    TASK_DEPENDENCY: "wait_dependency_s",
    MOTION_CONFLICT: "wait_conflict_s",
    OTHER: "wait_other_s",
}
"""Columns of the waits of all robots together, by cause."""


@dataclass(frozen=True)
class ReplicationRows:
    """Rows of a block of replications; what did not complete has no waits.

    Attributes:
        replication: number of each, shape (r,).
        outcome: ``completed``, ``failed``, ``aborted`` or ``error``, shape (r,).
        makespan_ns: shape (r,) [ns]; -1 for an error.
        busy_ns: work and stalls of each robot, shape (robots, r) [ns]; -1 where unknown.
        waited_ns: waits of all robots by cause, shape (3, r) [ns]; -1 where unknown.
        engine: ``bulk`` or ``events``.
        error: what went wrong, empty where nothing did, shape (r,).
        robots: their names.
    """

    replication: Indices
    outcome: npt.NDArray[Any]
    makespan_ns: Nanoseconds
    busy_ns: Nanoseconds
    waited_ns: Nanoseconds
    engine: str
    error: npt.NDArray[Any]
    robots: tuple[str, ...]

    def fill(self, which: npt.NDArray[np.bool_], found: Completions) -> None:
        """Enter replications that completed.

        Args:
            which: which rows, shape (r,).
            found: what came of them.
        """
        self.outcome[which] = COMPLETED
        self.makespan_ns[which] = found.makespan_ns
        self.busy_ns[:, which] = found.chain_end_ns - found.waited_ns.sum(axis=1)
        self.waited_ns[:, which] = found.waited_ns.sum(axis=0)

    def makespans_s(self) -> npt.NDArray[np.float64]:
        """Return the makespans, NaN where a replication did not complete, shape (r,) [s]."""
        return _seconds(self.makespan_ns, self.outcome == COMPLETED)

    def columns(self) -> dict[str, Any]:
        """Return the columns of ``replications.parquet`` that do not name the cell."""
        completed = self.outcome == COMPLETED
        out: dict[str, Any] = {
            "replication": self.replication,
            "outcome": self.outcome.astype(str),
            "makespan_s": _seconds(self.makespan_ns, self.makespan_ns >= 0),
            "wait_total_s": _seconds(self.waited_ns.sum(axis=0), completed),
        }
        for cause, name in WAIT_COLUMNS.items():
            out[name] = _seconds(self.waited_ns[cause], completed)
        for k, robot in enumerate(self.robots):
            out[f"busy_s_{robot}"] = _seconds(self.busy_ns[k], completed)
        out["engine"] = np.full(len(completed), self.engine)
        out["error"] = self.error.astype(str)
        return out


def empty_rows(
    replications: Indices, robots: tuple[str, ...], *, engine: str
) -> ReplicationRows:
    """Return rows to be filled."""
    count = len(replications)
    return ReplicationRows(
        replication=replications,
        outcome=np.full(count, "", dtype=object),
        makespan_ns=np.full(count, -1, dtype=np.int64),
        busy_ns=np.full((len(robots), count), -1, dtype=np.int64),
        waited_ns=np.full((3, count), -1, dtype=np.int64),
        engine=engine,
        error=np.full(count, "", dtype=object),
        robots=robots,
    )


def _seconds(
    nanoseconds: Nanoseconds, known: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float64]:
    return np.where(known, nanoseconds / NANOSECONDS, np.nan)
