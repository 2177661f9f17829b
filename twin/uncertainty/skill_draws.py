"""The skills of one TPG, ready to draw their durations: who draws from which model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.model import DurationModel
from twin.durations.nanoseconds import Nanoseconds, to_nanoseconds
from twin.uncertainty.draws import uniforms_bulk


@dataclass(frozen=True)
class SkillDraws:
    """Draws of the skills of one TPG, for as many replications as asked for.

    Attributes:
        nominal: planned duration of every node, per chain [ns].
        tasks: indices of the tasks that vary, rising, shape (s,).
        robots: robot of each of them.
        skills: skill of each of them.
        groups: each model, and the positions in ``tasks`` that draw from it.
        nodes: chain, skill nodes and their nominal durations [s] of each of the tasks.
        antithetic: replications 2k and 2k + 1 draw u and 1 - u.
    """

    nominal: tuple[Nanoseconds, ...]
    tasks: Indices
    robots: list[str]
    skills: list[str]
    groups: tuple[tuple[DurationModel, Indices], ...]
    nodes: tuple[tuple[int, Indices, Array], ...]
    antithetic: bool

    def totals(self, *, seed: int, replications: npt.ArrayLike) -> Nanoseconds:
        """Return the duration of every task that varies in every replication.

        Returns:
            Shape (replications, s) [ns]; a view whose columns are contiguous.
        """
        numbers = np.asarray(replications, dtype=np.int64)
        keys = numbers & ~1 if self.antithetic else numbers
        u = uniforms_bulk(seed, keys, self.robots, self.tasks, self.skills, "duration")
        if self.antithetic:
            mirrored = (numbers & 1).astype(bool)
            # Exact: u is an odd multiple of 2**-53.
            u[:, mirrored] = 1.0 - u[:, mirrored]
        out = np.empty(u.shape, dtype=np.int64)
        for model, rows in self.groups:
            out[rows] = to_nanoseconds(model.ppf(u[rows]))
        return out.T

    def durations(
        self, *, seed: int, replications: npt.ArrayLike
    ) -> tuple[Nanoseconds, ...]:
        """Return the duration of every node in every replication.

        Returns:
            Per chain, shape (replications, nodes) [ns]; views whose columns are contiguous.
        """
        totals = self.totals(seed=seed, replications=replications).T
        count = totals.shape[1]
        out = [np.repeat(row[:, None], count, axis=1) for row in self.nominal]
        for total, (chain, nodes, weights) in zip(totals, self.nodes, strict=True):
            out[chain][nodes] = share_duration(total, weights)
        return tuple(rows.T for rows in out)


def bind_draws(
    tpg: TemporalPlanGraph,
    model_of: Callable[[str, str, str | None], DurationModel | None],
    *,
    antithetic: bool,
) -> SkillDraws:
    """Return the draws of the skills of a TPG.

    Args:
        tpg: the plan.
        model_of: model of a skill, done by a robot, to an object of a kind; None where the
            nominal durations stay.
        antithetic: see SkillDraws.
    """
    kind_of = {item.name: item.kind for item in tpg.cell.objects}
    place: dict[int, tuple[int, Indices, Array]] = {}
    for k, chain in enumerate(tpg.chains):
        nodes = np.flatnonzero(chain.skill)
        tasks, first = np.unique(chain.task[nodes], return_index=True)
        # Of no nodes at all np.split makes one empty part.
        for task, own in zip(tasks.tolist(), np.split(nodes, first)[1:], strict=True):
            place[task] = (k, own, chain.duration[own])
    varying: list[int] = []
    groups: dict[int, tuple[DurationModel, list[int]]] = {}
    for index in sorted(place):
        task = tpg.tasks[index]
        kind = kind_of.get(task.object) if task.object is not None else None
        model = model_of(task.kind, task.robot, kind)
        if model is not None:
            groups.setdefault(id(model), (model, []))[1].append(len(varying))
            varying.append(index)
    return SkillDraws(
        nominal=tuple(to_nanoseconds(chain.duration) for chain in tpg.chains),
        tasks=np.array(varying, dtype=np.int64),
        robots=[tpg.tasks[index].robot for index in varying],
        skills=[tpg.tasks[index].kind for index in varying],
        groups=tuple(
            (model, np.array(rows, dtype=np.int64)) for model, rows in groups.values()
        ),
        nodes=tuple(place[index] for index in varying),
        antithetic=antithetic,
    )


def share_duration(total: Nanoseconds, weights: Array) -> Nanoseconds:
    """Split whole numbers in proportion to weights; the parts add up to them exactly.

    Args:
        total: shape (replications,) [ns].
        weights: shape (nodes,), shares alike where they are all zero.

    Returns:
        Shape (nodes, replications) [ns].
    """
    if len(weights) == 1:
        return total[None]
    cumulative = np.cumsum(weights)
    if cumulative[-1] <= 0:
        cumulative = np.arange(1.0, len(weights) + 1)
    bounds = np.rint((cumulative / cumulative[-1])[:, None] * total).astype(np.int64)
    return np.asarray(np.diff(bounds, axis=0, prepend=0), dtype=np.int64)
