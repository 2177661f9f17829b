"""Runner of replications on any executor, until the requested precision is reached."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path

import numpy as np

from planning.errors import OutputError, TwinError
from planning.transforms import Array
from twin.host.progress import Report, report_nothing
from twin.studies.replications.block_results import (
    BlockResult,
    blocks_done,
    quarantine_block,
    read_block,
    write_block,
)
from twin.studies.replications.executors import parallelism
from twin.studies.replications.experiment import Block, Experiment, blocks_of
from twin.studies.replications.workload import Workload, compute_block, pack_workload

BULK_BLOCK, EVENTS_BLOCK = 500, 20
"""Replications of a block, by engine: about as much work as is worth sending away."""

_MOST_TASKS = 5_000_000
"""Tasks of all replications of a block that are computed side by side."""

_log = logging.getLogger(__name__)

_RESTARTS = 3
"""Number of restarts of a pool after a worker died."""

OpenExecutor = Callable[[], AbstractContextManager[Executor]]

REPLICATING = "replications"
"""Name of the stage for progress displays."""


def run_replications(
    experiment: Experiment,
    workloads: Sequence[Workload],
    folder: Path,
    open_executor: OpenExecutor,
    progress: Report = report_nothing,
) -> int:
    """Run replications that have no file yet, and write a file for every block of them.

    Replications, their results and their blocks depend neither on the executor nor on interruptions.

    Args:
        experiment: how many are wanted.
        workloads: one for each of its cells.
        folder: of the block files, made where it is missing.
        open_executor: opens an executor; called again after a worker has died.
        progress: receives replications done and wanted, of all cells together; how many
            are wanted is a forecast until the precision is reached.

    Returns:
        Replications of each cell.

    Raises:
        TwinError: workers died repeatedly; finished blocks are kept.
        OutputError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    done = set(blocks_done(folder))
    wanted: set[Block] = set()
    begin = 0
    with _Run(experiment, workloads, folder, open_executor, progress) as run:
        for target in experiment.targets():
            blocks = [
                block
                for cell, load in enumerate(workloads)
                for block in blocks_of(cell, begin, target, _block_size(load))
            ]
            run.compute(
                b for b in blocks if not (b in done and run.accept_stored_block(b))
            )
            wanted.update(blocks)
            begin = target
            if run.has_enough(target):
                break
    for block in sorted(done - wanted, key=lambda b: (b.cell, b.first)):
        place = quarantine_block(folder, block)
        _log.warning("%s: is no block of this study and counts for nothing", place)
    return begin


def _block_size(load: Workload) -> int:
    """Return a number of replications per block that balances overhead and memory."""
    if load.by_events or load.operated is not None:
        return EVENTS_BLOCK
    return max(1, min(BULK_BLOCK, _MOST_TASKS // max(len(load.tpg.tasks), 1)))


class _Run:
    """State of a running study: pending blocks, and makespans of finished ones.

    Workers are started on demand, and kept until one dies or all is done.
    """

    def __init__(
        self,
        experiment: Experiment,
        workloads: Sequence[Workload],
        folder: Path,
        open_executor: OpenExecutor,
        progress: Report,
    ) -> None:
        self._experiment, self._folder = experiment, folder
        self._packed_workloads = [pack_workload(load) for load in workloads]
        self._made_from = [load.made_from for load in workloads]
        # 8 bytes a replication, by cell and first replication of its block.
        self._makespans: list[dict[int, Array]] = [{} for _ in workloads]
        self._progress = progress
        self._done = 0
        self._wanted = next(iter(experiment.targets())) * len(workloads)
        self._open = open_executor
        self._opened = ExitStack()
        self._executor: Executor | None = None

    def __enter__(self) -> _Run:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def accept_stored_block(self, block: Block) -> bool:
        """Count a block that has a file; if it is unusable, move the file away and return False."""
        try:
            self._count(read_block(self._folder, block, self._made_from[block.cell]))
        except OutputError as error:
            place = quarantine_block(self._folder, block)
            _log.warning("%s; recomputed, the file is now %s", error, place)
            return False
        return True

    def compute(self, blocks: Iterable[Block]) -> None:
        """Compute blocks and write their files.

        Raises:
            TwinError: workers died again and again.
        """
        waiting = deque(blocks)
        restarts = 0
        while waiting:
            try:
                with self._at_work() as executor:
                    self._drain(executor, waiting)
            except BrokenExecutor as error:
                restarts += 1
                if restarts > _RESTARTS:
                    raise TwinError(
                        f"workers died {restarts} times; what was done is kept, continue with"
                        " --resume and fewer --workers"
                    ) from error

    def has_enough(self, target: int) -> bool:
        """Return whether the means of all cells are precise enough after a number of replications."""
        if self._experiment.replications is not None:
            return True
        rule, mirror = self._experiment.precision, self._experiment.antithetic
        samples = []
        for parts in self._makespans:
            values = np.concatenate([parts[first] for first in sorted(parts)])
            samples.append(values[np.isfinite(values)])
        # A cell in which nothing completes has no mean to wait for.
        if target >= rule.most or all(
            len(sample) < 2 or rule.reached(sample, antithetic=mirror)
            for sample in samples
        ):
            return True
        forecast = max(rule.forecast(sample) for sample in samples if len(sample) > 1)
        self._wanted = max(forecast, target) * len(samples)
        return False

    def _count(self, result: BlockResult) -> None:
        parts = self._makespans[result.block.cell]
        parts[result.block.first] = result.rows.makespans_s()
        self._done += result.block.count
        self._progress(REPLICATING, self._done, max(self._wanted, self._done))

    @contextmanager
    def _at_work(self) -> Iterator[Executor]:
        """Yield the executor; an exception closes it, and the next call opens a new one."""
        if self._executor is None:
            self._executor = self._opened.enter_context(self._open())
        try:
            yield self._executor
        except BaseException as error:
            self._executor = None
            # An executor may have a better message.
            self._opened.__exit__(type(error), error, error.__traceback__)
            raise

    def _drain(self, executor: Executor, waiting: deque[Block]) -> None:
        """Compute blocks until none is waiting; a block leaves the queue when its file is there."""
        under_way: dict[Future[BlockResult], Block] = {}
        most = 2 * parallelism(executor)
        try:
            while waiting or under_way:
                while waiting and len(under_way) < most:
                    block = waiting[0]
                    packed_workload = self._packed_workloads[block.cell]
                    # Where a worker has died meanwhile this fails, and the block must still be waiting.
                    future = executor.submit(compute_block, packed_workload, block)
                    under_way[future] = waiting.popleft()
                finished, _ = wait(under_way, return_when=FIRST_COMPLETED)
                for future in finished:
                    result = future.result()
                    made_from = self._made_from[result.block.cell]
                    write_block(self._folder, result, made_from)
                    self._count(result)
                    del under_way[future]
        finally:
            waiting.extendleft(under_way.values())
            for future in under_way:
                future.cancel()
