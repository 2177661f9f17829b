"""Results of blocks of replications: one row per replication, sums over tasks, and one file per block.

Each file is written completely or not at all, so an interrupted study resumes from the files of its blocks.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import reduce
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from planning.errors import OutputError
from planning.files import (
    NPZ_ERRORS,
    digest_parts,
    read_file,
    read_npz,
    replace_atomically,
)
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from scheduling.graph.windows import window_gaps
from twin.bulk.max_plus import CompletionSums
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.engine.execution_model import OTHER
from twin.operations.replicated.operating import OperatedRows, OperatingWorkload
from twin.studies.replications.experiment import Block
from twin.throughput.states import WorkerTimes
from twin.throughput.throughput import ProductTimes

COMPLETED, ERROR = "completed", "error"

WAIT_COLUMNS = {
    TASK_DEPENDENCY: "wait_dependency_s",
    MOTION_CONFLICT: "wait_conflict_s",
    OTHER: "wait_other_s",
}
"""Columns of the waits of all robots together, by cause."""

KEPT = 500
"""Replications whose starts and ends of tasks are kept, for bands on a Gantt chart."""

_FEWEST, _MOST_KEPT = 50, 4_000_000
"""Least number of these for long plans, and the number of their task times that is otherwise not exceeded."""

_LARGEST = (
    1 << 28
)  # bytes; some hundred times the size of the largest block in practice

_SEAL = "made_from_and_sha256"
_NAME = re.compile(r"(\d+)-(\d+)-(\d+)\.npz")
_TEXTS = ("outcome", "error")
_ROWS = ("replication", "makespan_ns", "busy_ns", "waited_ns")

UNKNOWN = -(2**62)
"""Time that passed in a window of a replication that did not complete [ns]."""
_TALLY = ("critical", "critical_edges", "slack_ns", "start_ns", "end_ns")

Part = TypeVar("Part", OperatedRows, ProductTimes, WorkerTimes, "WindowTimes")


@dataclass(frozen=True)
class ReplicationRows:
    """Rows of a block of replications; incomplete ones have no waits.

    Attributes:
        replication: number of each, shape (r,).
        outcome: ``completed``, ``failed``, ``aborted`` or ``error``, shape (r,).
        makespan_ns: shape (r,) [ns]; -1 for an error.
        busy_ns: work and stalls of each robot, then of each machine that works at parts, shape
            (robots and machines, r) [ns]; -1 where unknown.
        waited_ns: waits of all robots by cause, shape (3, r) [ns]; -1 where unknown.
        engine: ``bulk`` or ``events``.
        error: error message, empty without one, shape (r,).
        robots: names of robots and machines.
        operated: results of replanning; None without it.
    """

    replication: Indices
    outcome: npt.NDArray[Any]
    makespan_ns: Nanoseconds
    busy_ns: Nanoseconds
    waited_ns: Nanoseconds
    engine: str
    error: npt.NDArray[Any]
    robots: tuple[str, ...]
    operated: OperatedRows | None = None

    def fill(
        self,
        which: npt.NDArray[np.bool_],
        found: CompletionSums,
        tpg: TemporalPlanGraph,
    ) -> None:
        """Enter the results of completed replications.

        Args:
            which: those rows, shape (r,).
            found: their times.
            tpg: the executed plan.
        """
        robots, machines = worker_chains(tpg)
        self.outcome[which] = COMPLETED
        self.makespan_ns[which] = found.chain_end_ns.max(axis=0, initial=0)
        busy = found.chain_end_ns - found.waited_ns.sum(axis=1)
        self.busy_ns[:, which] = 0
        names = [tpg.chains[k].robot for k in (*robots, *machines)]
        for k, name in enumerate(self.robots):
            if name in names:
                self.busy_ns[k, which] = busy[tpg.chain_index[name]]
        self.waited_ns[:, which] = found.waited_ns[robots].sum(axis=0)

    def makespans_s(self) -> Array:
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
        if self.operated is not None:
            out |= self.operated.columns(self.makespan_ns)
        out["engine"] = np.full(len(completed), self.engine)
        out["error"] = self.error.astype(str)
        return out


@dataclass(frozen=True)
class TaskTally:
    """Sums over replications, and samples of the first of them.

    Attributes:
        count: replications counted.
        critical: in how many of them each task was on the critical path, shape (tasks,).
        critical_edges: the same for type-2 edges, shape (edges,).
        slack_ns: sum of the slacks of each task, shape (tasks,) [ns].
        start_ns, end_ns: of each task in replications below KEPT, shape (k, tasks) [ns].
    """

    count: int
    critical: Indices
    critical_edges: Indices
    slack_ns: Nanoseconds
    start_ns: Nanoseconds
    end_ns: Nanoseconds

    def plus(self, other: TaskTally) -> TaskTally:
        """Return the sum of both; ``other`` has the later replications."""
        return TaskTally(
            self.count + other.count,
            self.critical + other.critical,
            self.critical_edges + other.critical_edges,
            self.slack_ns + other.slack_ns,
            np.concatenate([self.start_ns, other.start_ns]),
            np.concatenate([self.end_ns, other.end_ns]),
        )


@dataclass(frozen=True)
class TaskGroups:
    """Nodes of every task, each a group of ``sum_completions``; nodes of all chains are numbered through.

    Attributes:
        task: index of each task that has nodes, in the order of its nodes, shape (tasks,).
        first: its first node, shape (tasks,).
        last: its last node, shape (tasks,).
    """

    task: Indices
    first: Indices
    last: Indices

    def tally(self, replications: Indices, found: CompletionSums) -> TaskTally:
        """Return sums over completed replications, and task times of the first of them."""
        kept = replications < min(KEPT, max(_FEWEST, _MOST_KEPT // len(self.task)))
        return TaskTally(
            len(replications),
            found.critical,
            found.critical_edge,
            found.slack_ns,
            found.start_ns.T[np.ix_(kept, self.first)],
            found.end_ns.T[np.ix_(kept, self.last)],
        )


@dataclass(frozen=True)
class WindowTimes:
    """Time that passed in windows of time, in all replications.

    Attributes:
        gap_ns: UNKNOWN where a replication did not complete, shape (windows, r) [ns].
        free_gap_ns: the same without holding back; empty where the plan has none.
        free_makespan_ns: and its makespan, -1 where that did not complete, shape (r,) [ns].
    """

    gap_ns: Nanoseconds
    free_gap_ns: Nanoseconds
    free_makespan_ns: Nanoseconds


@dataclass(frozen=True)
class BlockResult:
    """Result of a block of replications.

    Attributes:
        block: which.
        rows: one per replication.
        tally: sums over tasks of completed replications.
        products, workers: of replications that came to their end; None where there is only one product.
        windows: None where there are none.
    """

    block: Block
    rows: ReplicationRows
    tally: TaskTally
    products: ProductTimes | None = None
    windows: WindowTimes | None = None
    workers: WorkerTimes | None = None


def worker_chains(tpg: TemporalPlanGraph) -> tuple[list[int], tuple[int, ...]]:
    """Return the chains of the robots, and those of the machines that work at parts."""
    machines = tpg.machine_chains()
    robots = [k for k in range(len(tpg.chains)) if k not in machines]
    return robots, tpg.working_machines()


def empty_rows(
    block: Block,
    tpg: TemporalPlanGraph,
    *,
    engine: str,
    operated: OperatingWorkload | None = None,
) -> ReplicationRows:
    """Return empty rows for the robots that have or may get tasks."""
    count = block.count
    robots, machines = worker_chains(tpg)
    work = [tpg.chains[k].robot for k in (*robots, *machines)]
    names = tuple(dict.fromkeys([*work, *(operated.robots if operated else ())]))
    return ReplicationRows(
        replication=np.asarray(block.replications, dtype=np.int64),
        outcome=np.full(count, "", dtype=object),
        makespan_ns=np.full(count, -1, dtype=np.int64),
        busy_ns=np.full((len(names), count), -1, dtype=np.int64),
        waited_ns=np.full((3, count), -1, dtype=np.int64),
        engine=engine,
        error=np.full(count, "", dtype=object),
        robots=names,
        operated=None if operated is None else operated.rows(count),
    )


def block_result(
    block: Block,
    rows: ReplicationRows,
    well: npt.NDArray[np.bool_],
    found: CompletionSums,
    tpg: TemporalPlanGraph,
) -> BlockResult:
    """Return the result of a block, with the rows of completed replications.

    Args:
        block: which.
        rows: of all its replications.
        well: those that completed, shape (r,).
        found: their times.
        tpg: the executed plan, contracted or not.
    """
    rows.fill(well, found, tpg)
    tally = task_groups(tpg).tally(rows.replication[well], found)
    windows = None
    if tpg.windows:
        gaps = np.full((len(tpg.windows), len(well)), UNKNOWN, dtype=np.int64)
        gaps[:, well] = window_gaps(tpg, found.start_ns, found.end_ns)
        none = np.empty(0, dtype=np.int64)
        windows = WindowTimes(gaps, none.reshape(len(gaps), 0), none)
    return BlockResult(block, rows, tally, windows=windows)


def task_groups(tpg: TemporalPlanGraph) -> TaskGroups:
    """Return the nodes of every task of a graph, contracted or not."""
    task = np.concatenate([chain.task for chain in tpg.chains])
    chain = np.repeat(np.arange(len(tpg.chains)), [len(c) for c in tpg.chains])
    opens = np.diff(task, prepend=-1) != 0
    opens |= np.diff(chain, prepend=-1) != 0
    first = np.flatnonzero(opens)
    last = np.append(first[1:], len(task)) - 1
    return TaskGroups(task[first], first, last)


def write_block(folder: Path, result: BlockResult, made_from: str = "") -> None:
    """Write the result of a block.

    Args:
        folder: of the blocks.
        result: its result.
        made_from: hash of all that it depends on, see ``Workload``.

    Raises:
        OutputError: the file cannot be written.
    """
    block = result.block
    arrays: dict[str, Any] = {**vars(result.rows), **vars(result.tally)}
    for more in (
        arrays.pop("operated"),
        result.products,
        result.windows,
        result.workers,
    ):
        arrays |= {} if more is None else vars(more)
    arrays |= {name: arrays[name].astype(str) for name in _TEXTS}
    arrays["robots"] = np.array(result.rows.robots, dtype=str)
    arrays = {name: np.asarray(values) for name, values in arrays.items()}
    arrays[_SEAL] = np.array([made_from, _digest(arrays, block, made_from)])
    with replace_atomically(_path(folder, block)) as temporary:
        np.savez_compressed(temporary, **arrays)


def read_block(folder: Path, block: Block, made_from: str | None = None) -> BlockResult:
    """Read a file of ``write_block``.

    Args:
        folder: of the blocks.
        block: which one.
        made_from: hash of all that it should have been made from; None to believe the file.

    Raises:
        OutputError: the file is missing, damaged, of another block or made from something else.
    """
    path = _path(folder, block)
    try:
        arrays = read_npz(read_file(path, _LARGEST), kinds="iU", most=_LARGEST)
        origin, digest = arrays.pop(_SEAL).tolist()
        if digest != _digest(arrays, block, origin):
            raise ValueError("its content is not what was written, or of another block")
        rows = ReplicationRows(
            **{name: arrays[name] for name in _ROWS},
            **{name: arrays[name].astype(object) for name in _TEXTS},
            engine=str(arrays["engine"]),
            robots=tuple(arrays["robots"].tolist()),
            operated=_part(OperatedRows, arrays),
        )
        tally = TaskTally(
            int(arrays["count"]), **{name: arrays[name] for name in _TALLY}
        )
        products, windows = _part(ProductTimes, arrays), _part(WindowTimes, arrays)
        workers = _part(WorkerTimes, arrays)
    except NPZ_ERRORS as error:
        raise OutputError(f"{path}: is no block of a study: {error}") from error
    if made_from not in (None, origin):
        raise OutputError(
            f"{path}: was made from another scenario, plan, policy, variant or version of a package"
        )
    return BlockResult(block, rows, tally, products, windows, workers)


def _part(kind: type[Part], arrays: Mapping[str, Any]) -> Part | None:
    """Return a part of a block's file; None if missing."""
    names = [item.name for item in fields(kind)]
    return kind(**{k: arrays[k] for k in names}) if names[0] in arrays else None


def _digest(
    arrays: Mapping[str, npt.NDArray[Any]], block: Block, made_from: str
) -> str:
    """Return a hash of a block's content, identity and inputs."""
    digest = hashlib.sha256(f"{block} {made_from}".encode())
    for piece in digest_parts(arrays):
        digest.update(piece)
    return digest.hexdigest()


def quarantine_block(folder: Path, block: Block) -> Path:
    """Move an unusable block file away; return its new path.

    Raises:
        OutputError: it cannot be moved.
    """
    path = _path(folder, block)
    target = folder / "set-aside" / path.name
    try:
        target.parent.mkdir(exist_ok=True)
        path.replace(target)
    except OSError as error:
        raise OutputError(f"{path}: cannot be moved: {error}") from error
    return target


def blocks_done(folder: Path) -> Iterator[Block]:
    """Yield the blocks that have a file."""
    for path in folder.glob("*.npz"):
        if match := _NAME.fullmatch(path.name):
            yield Block(*map(int, match.groups()))


def cell_blocks(folder: Path, cell: int) -> Iterator[BlockResult]:
    """Yield the results of a cell's blocks, in the order of replications."""
    own = [block for block in blocks_done(folder) if block.cell == cell]
    for block in sorted(own, key=lambda block: block.first):
        yield read_block(folder, block)


def cell_makespans_s(folder: Path, cell: int) -> Array:
    """Return the makespans of a cell, NaN where it did not complete, shape (n,) [s]."""
    return np.concatenate([b.rows.makespans_s() for b in cell_blocks(folder, cell)])


def cell_part(
    folder: Path, cell: int, name: Literal["products", "windows", "workers"]
) -> Any:
    """Return a part of a cell's results over all blocks; None if missing."""
    parts = [getattr(block, name) for block in cell_blocks(folder, cell)]
    parts = [part for part in parts if part is not None]
    return joined_parts(parts) if parts else None


def joined_parts(parts: Sequence[Part]) -> Part:
    """Return parts of results with the replications of all of them."""
    values = zip(*(vars(part).values() for part in parts), strict=True)
    return type(parts[0])(*(np.concatenate(own, axis=-1) for own in values))


def cell_tally(folder: Path, cell: int) -> TaskTally:
    """Return the task tally of a cell, over all its blocks."""
    return reduce(TaskTally.plus, (b.tally for b in cell_blocks(folder, cell)))


def _path(folder: Path, block: Block) -> Path:
    return folder / f"{block.cell}-{block.first}-{block.count}.npz"


def _seconds(nanoseconds: Nanoseconds, known: npt.NDArray[np.bool_]) -> Array:
    return np.where(known, nanoseconds / NANOSECONDS, np.nan)
