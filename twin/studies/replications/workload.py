"""Workload of a study for one policy and one variant of the inputs, in a form that can be sent to other processes.

Replications need only times, since paths are verified in advance. A workload therefore contains a timing graph: a
``TemporalPlanGraph`` without shapes and paths, of a few hundred kilobytes for hundreds of steps.
"""

from __future__ import annotations

import pickle
import zlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.bulk.bulk_engine import BulkEngine
from twin.bulk.max_plus import (
    CompletionSums,
    PrecedenceArrays,
    policy_graph,
    sum_completions,
)
from twin.durations.nanoseconds import Nanoseconds
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.operations.operation import with_products
from twin.operations.replicated.operating import SAME, OperatingWorkload, Operator
from twin.runs.execution_record import DeadlockError, ExecutionRecord
from twin.scenario.sections.kind import assembly_kind
from twin.studies.replications.block_results import (
    COMPLETED,
    ERROR,
    BlockResult,
    ReplicationRows,
    block_result,
    empty_rows,
    joined_parts,
    task_groups,
)
from twin.studies.replications.experiment import Block
from twin.throughput.states import (
    WorkerTimes,
    run_worker_times,
    worker_chains,
    worker_times,
)
from twin.throughput.throughput import ProductTimes, product_times, run_product_times

LineTimes = tuple[ProductTimes, WorkerTimes]
"""Times of the products and workers of a line in some replications."""


@dataclass(frozen=True)
class Workload:
    """A plan and its execution model.

    Attributes:
        tpg: plan to execute; a timing graph is enough.
        execution: execution model, with disturbances.
        seed: seed of the draws.
        reasons: why only the event engine can execute it; empty if both engines can.
        bulk_until_ns: the bulk engine executes blocks of which all end before nevertheless [ns].
        made_from: hash of scenario, plan, policy, variant, files and versions, saved with the results of
            replications.
        free: the plan without holding back, executed with the same draws to be compared
            with; None where nothing is.
        operated: data for replanning after failures for good; None where these end a replication.
    """

    tpg: TemporalPlanGraph
    execution: ExecutionModel
    seed: int
    reasons: tuple[str, ...] = ()
    made_from: str = ""
    free: TemporalPlanGraph | None = None
    operated: OperatingWorkload | None = None
    bulk_until_ns: int = 0

    @property
    def by_events(self) -> bool:
        """Tell whether the event engine executes all replications."""
        return bool(self.reasons) and self.bulk_until_ns == 0


def pack_workload(workload: Workload) -> bytes:
    """Serialize a workload; a worker that gets it several times unpacks it once."""
    return zlib.compress(pickle.dumps(workload, protocol=5), 1)


def compute_block(packed_workload: bytes, block: Block) -> BlockResult:
    """Execute a block of replications of a packed workload; the function that workers call.

    A replication that raises is a row with its error.
    """
    return _engines(packed_workload).compute(block)


@lru_cache(maxsize=8)
def _engines(packed_workload: bytes) -> Engines:
    return Engines(pickle.loads(zlib.decompress(packed_workload)))


class Engines:
    """Both engines of one workload, made when they are needed."""

    def __init__(self, workload: Workload) -> None:
        self.workload = workload

    def compute(self, block: Block) -> BlockResult:
        """Execute a block, in bulk where possible, with and without holding back."""
        result, load = self._compute(block), self.workload
        if load.free is None or result.windows is None:
            return result
        other = self._free.compute(block)
        assert other.windows is not None
        done = other.rows.outcome == COMPLETED
        windows = replace(
            result.windows,
            free_gap_ns=other.windows.gap_ns,
            free_makespan_ns=np.where(done, other.rows.makespan_ns, -1),
        )
        return replace(result, windows=windows)

    @cached_property
    def _free(self) -> Engines:
        load = self.workload
        model = replace(load.execution, hold=0.0)
        free = load.free or load.tpg
        return Engines(replace(load, tpg=free, free=None, execution=model))

    def _compute(self, block: Block) -> BlockResult:
        if self.workload.by_events:
            return self._by_events(block)
        try:
            return self._in_bulk(block)
        except Exception:
            # One of many replications: find out which, and lose no other.
            return self._by_events(block)

    def _in_bulk(self, block: Block) -> BlockResult:
        """Execute a block in bulk; replications with failed tasks by the event engine, and all if some come to a stop."""
        load, bulk = self.workload, self._bulk
        rows = self._rows(block, "bulk")
        times = bulk.sample(seed=load.seed, replications=rows.replication)
        whole, tpg = times.completing(), bulk.contraction.tpg
        ran = bulk.node_times(whole)
        if load.reasons and ran[1].max(initial=0) >= load.bulk_until_ns:
            return self._by_events(block)
        first, parts = task_groups(tpg).first, list[LineTimes]()
        found = sum_completions(bulk.graph, first, *ran)
        if (made := product_times(self._line(tpg), *ran)) is not None:
            spent = worker_times(tpg, *ran, bulk.standstills(whole))
            parts.append((made, spent))
        for place in np.flatnonzero(times.fails).tolist():
            self._by_event(rows, place, parts)
        return self._result(block, rows, ~times.fails, found, tpg, parts)

    def _by_events(self, block: Block) -> BlockResult:
        """Execute a block with the event engine, one replication after the other."""
        rows = self._rows(block, "events")
        parts: list[LineTimes] = []
        runs = [self._by_event(rows, place, parts) for place in range(block.count)]
        done = [run for run in runs if run is not None and run.outcome == COMPLETED]
        well = np.isin(
            [-1 if run is None else run.replication for run in runs],
            [run.replication for run in done],
        )
        found = sum_completions(
            self._node_graph,
            task_groups(self.workload.tpg).first,
            _columns([run.start_ns for run in done], len(self._node_graph.order)),
            _columns([run.end_ns for run in done], len(self._node_graph.order)),
        )
        tpg = self.workload.tpg
        for run in done:
            self._add_line(parts, self._line(tpg), run)
        return self._result(block, rows, well, found, tpg, parts)

    def _rows(self, block: Block, engine: str) -> ReplicationRows:
        load = self.workload
        return empty_rows(block, load.tpg, engine=engine, operated=load.operated)

    def _result(
        self,
        block: Block,
        rows: ReplicationRows,
        well: npt.NDArray[np.bool_],
        found: CompletionSums,
        tpg: TemporalPlanGraph,
        parts: Sequence[LineTimes],
    ) -> BlockResult:
        """Return the result of a block; replications completed by the plan lost nothing."""
        result = block_result(block, rows, well, found, tpg)
        if parts:
            products, workers = zip(*parts, strict=True)
            products, workers = joined_parts(products), joined_parts(workers)
            result = replace(result, products=products, workers=workers)
        if rows.operated is not None:
            rows.operated.knew_ns[well] = rows.makespan_ns[well]
        return result

    @cached_property
    def _operator(self) -> Operator:
        load = self.workload
        assert load.operated is not None
        return Operator(load.operated, load.execution, load.seed)

    def _add_line(
        self,
        parts: list[LineTimes],
        tpg: TemporalPlanGraph,
        run: ExecutionRecord,
        scrapped: Collection[int] = (),
    ) -> None:
        """Add the times of a run's products and workers, if it is of a line and all of its nodes ended."""
        made = run_product_times(tpg, run, self._ordered, scrapped)
        if made is not None:
            planned = self.workload.tpg
            names = [planned.chains[k].robot for k in worker_chains(planned)]
            kept = (own[: self._ordered] for own in vars(made).values())
            spent = run_worker_times(tpg, run, names)
            parts.append((ProductTimes(*kept), spent))

    def _line(self, tpg: TemporalPlanGraph) -> TemporalPlanGraph:
        """Return the plan with the product of each task, which plans to be operated do not have."""
        if self.workload.operated is None or len(tpg.products):
            return tpg
        section = self.workload.operated.scenario.assembly
        return with_products(tpg, assembly_kind(section).written_out(), ())

    @cached_property
    def _ordered(self) -> int:
        """Number of products of the order; a first plan may have fewer."""
        if self.workload.operated is None:
            return int(self.workload.tpg.products.max(initial=0))
        return assembly_kind(self.workload.operated.scenario.assembly).products()

    @cached_property
    def _bulk(self) -> BulkEngine:
        return BulkEngine(self.workload.tpg, self.workload.execution)

    @cached_property
    def _simulator(self) -> Simulator:
        return Simulator(self.workload.tpg, self.workload.execution)

    @cached_property
    def _node_graph(self) -> PrecedenceArrays:
        return policy_graph(self.workload.tpg, self.workload.execution.policy)

    def _by_event(
        self, rows: ReplicationRows, place: int, parts: list[LineTimes]
    ) -> ExecutionRecord | None:
        """Execute one replication with the event engine; enter its outcome and end, and a replanned line's times.

        Returns:
            Node times; None after an error, or if the executed graph is not the plan.
        """
        number, seed = int(rows.replication[place]), self.workload.seed
        operated = self.workload.operated
        if operated is not None and operated.leaves(number):
            rows.outcome[place] = SAME
            return None
        try:
            if operated is not None:
                return self._operate(rows, place, number, parts)
            run = self._simulator.run(seed=seed, replication=number)
        except DeadlockError as error:
            run = error.run
            rows.error[place] = str(error)
        except Exception as error:
            rows.outcome[place] = ERROR
            rows.error[place] = f"{type(error).__name__}: {error}"
            return None
        rows.outcome[place] = run.outcome
        rows.makespan_ns[place] = run.makespan_ns
        return run

    def _operate(
        self, rows: ReplicationRows, place: int, number: int, parts: list[LineTimes]
    ) -> ExecutionRecord | None:
        """Operate one replication, and enter its result."""
        done = self._operator.run(number)
        run, tpg = done.record, done.tpg
        assert rows.operated is not None
        self._operator.enter(rows.operated, place, done)
        rows.outcome[place] = run.outcome
        rows.makespan_ns[place] = run.makespan_ns
        if not done.versions and len(tpg.chains) == len(self.workload.tpg.chains):
            return run
        self._add_line(parts, tpg, run, done.scrapped)
        if run.outcome == COMPLETED:
            graph = policy_graph(tpg, self.workload.execution.policy)
            nodes = len(graph.order)
            times = _columns([run.start_ns], nodes), _columns([run.end_ns], nodes)
            which = np.arange(len(rows.outcome)) == place
            first = task_groups(tpg).first
            rows.fill(which, sum_completions(graph, first, *times), tpg)
        return None


def _columns(values: Sequence[tuple[Nanoseconds, ...]], nodes: int) -> Nanoseconds:
    """Return per-chain arrays of several runs as one, shape (nodes, runs)."""
    if not values:
        return np.empty((nodes, 0), dtype=np.int64)
    return np.stack([np.concatenate(chains) for chains in values], axis=1)
