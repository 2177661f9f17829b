"""Plan for many products, made from the plan of a few products by copying its nodes, tasks and objects.

A ``Pattern`` specifies how the plan is repeated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from planning.errors import PlanInvariantError
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import (
    NO_EDGES,
    NodeChain,
    TemporalPlanGraph,
)
from scheduling.sequences.sequence import PlanSequence, SequencedPlan


@dataclass(frozen=True)
class Pattern:
    """How the plan of a few products, the pattern, is repeated for many.

    At the end of the pattern everything is again as it was at its start: robots at HOME, sources
    full, places empty. Copies are therefore executed one after another, and may overlap as far as
    the graph allows.

    Attributes:
        products: total number of products.
        period: number of products of the pattern.
        product: the product for which each task of the pattern is done, from 1, shape (tasks,).
            A task that supplies a part to a later copy counts for the product of that copy, and is
            left out if there is no such product.
        lags: triples (a, b, n), shape (d, 3): task b waits for task a of the copy n earlier.
        objects: part and product of each object of the pattern, by name. In the next copy, the
            object is the same part of product + period.
    """

    products: int
    period: int
    product: Indices
    lags: Indices
    objects: Mapping[str, tuple[str, int]]

    @property
    def copies(self) -> int:
        """Number of copies, of which the last one may be truncated."""
        return -(-self.products // self.period)

    def object_of(self, name: str, copy: int) -> str:
        """Return the name of an object in a copy, counted from 0."""
        if name not in self.objects:
            return name
        part, product = self.objects[name]
        return product_part_name(part, product + copy * self.period)


def product_part_name(part: str, product: int) -> str:
    """Return the name of a product's part, counted from 1."""
    return f"{part}.{product}"


def copies_in_sequence(tpg: TemporalPlanGraph, pattern: Pattern) -> PlanSequence:
    """Return the copies of a pattern as a sequence.

    Tasks for products beyond the total number are left out of the last copy.

    Args:
        tpg: graph of the pattern.
        pattern: number of copies, and dependencies between them.

    Raises:
        PlanInvariantError: a robot does not end where it begins, or works for a product before it is done with an
            earlier one.
    """
    copies = np.arange(pattern.copies)[:, None]
    product = pattern.product + copies * pattern.period
    kept = product <= pattern.products
    whole = bool(np.all(kept[-1]))
    plans = [tpg] if whole else [tpg, _with_tasks(tpg, kept[-1])]
    if pattern.copies == 1:
        plans = plans[-1:]
    segments = [
        SequencedPlan(
            len(plans) - 1 if copy + 1 == pattern.copies else 0,
            {name: pattern.object_of(name, copy) for name in pattern.objects},
            product[copy][kept[copy]],
        )
        for copy in range(pattern.copies)
    ]
    index = np.cumsum(kept, axis=1) - 1
    waits = [
        (copy, index[copy, a], copy + lag, index[copy + lag, b])
        for a, b, lag in pattern.lags.tolist()
        for copy in range(pattern.copies - lag)
        if kept[copy, a] and kept[copy + lag, b]
    ]
    rows = np.array(waits, dtype=np.int64).reshape(-1, 4)
    return PlanSequence(tuple(plans), tuple(segments), rows)


def _with_tasks(
    tpg: TemporalPlanGraph, kept: npt.NDArray[np.bool_]
) -> TemporalPlanGraph:
    """Return the nodes of some tasks of a plan, without type-2 edges.

    Args:
        tpg: the plan.
        kept: whether each task is kept, shape (tasks,); a robot does those that are left out last, a machine, which
            does not move, at any time.
    """
    index = np.cumsum(kept) - 1
    chains: list[NodeChain] = []
    place: dict[int, int] = {}
    for k, chain in enumerate(tpg.chains):
        left = kept[chain.task]
        count = int(np.count_nonzero(left))
        if not (np.all(left[:count]) or tpg.cell.is_machine(chain.robot)):
            raise PlanInvariantError(
                f"{chain.robot!r} works for a product before it is done with an earlier one"
            )
        if count:
            place[k] = len(chains)
            order = np.argsort(~left, kind="stable")
            own = replace(
                chain,
                task=index[chain.task[order]],
                skill=chain.skill[order],
                duration=chain.duration[order],
                planned_start=chain.planned_start[order],
            )
            chains.append(own.cut(0, count).frozen())
    pairs = tpg.dependencies
    return TemporalPlanGraph(
        tpg.cell,
        tuple(
            replace(task, index=int(index[task.index]))
            for task in tpg.tasks
            if kept[task.index]
        ),
        tuple(chains),
        *NO_EDGES,
        tuple(
            replace(
                h,
                robot=place[h.robot],
                node=int(np.count_nonzero(kept[tpg.chains[h.robot].task[: h.node]])),
            )
            for h in tpg.handlings
            if kept[tpg.chains[h.robot].task[h.node]]
        ),
        tuple(
            replace(contact, tasks=frozenset(index[tasks].tolist()))
            for contact in tpg.allowed
            if (tasks := [task for task in sorted(contact.tasks) if kept[task]])
        ),
        index[pairs[np.all(kept[pairs], axis=1)]],
        windows=tuple(
            replace(w, begun=int(begun), done=int(done), due=int(due))
            for w in tpg.windows
            if np.all(kept[[w.begun, w.done, w.due]])
            for begun, done, due in [index[[w.begun, w.done, w.due]]]
        ),
    )
