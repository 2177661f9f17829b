"""Skill durations: the duration model of each skill of a plan, and random durations for many replications."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.tasks.task import (
    ActuationKey,
    ExceptionKey,
    TaskKind,
    strongest_exception,
)
from planning.transforms import Array, Indices
from scheduling.graph.actuations import actuation_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.composed import SkillOverride
from twin.durations.model import DurationModel
from twin.durations.nanoseconds import Nanoseconds, to_nanoseconds
from twin.uncertainty.draws import TaskName, uniforms
from twin.uncertainty.least_durations import least_ns


@dataclass(frozen=True)
class SkillDurations:
    """Duration models of skills; motions take their nominal time.

    A duration belongs to the task, not to the run: the same task has the same draw under every
    policy and however its nodes were cut. A draw that is shorter than the reference path takes
    at the joints' speed limits is raised to that.

    The duration of a skill with tool actuation can be given in two forms. A model of the skill covers
    all of it, and its motions share the drawn time. Without one, motions take their nominal times, and
    the actuation time is drawn while the robot stands.

    Attributes:
        models: duration model of each skill; a skill without one keeps its nominal duration.
        overrides: exceptions; robot and object beat robot alone, that beats object alone, and
            every exception beats ``models``.
        antithetic: draw in pairs: where replication 2k uses the uniform u, replication 2k + 1
            uses 1 - u. Replications of even number are the same as without it.
        actuations: duration models of tools that close and open, by act, robot and tool; what has
            none takes its nominal time.
    """

    models: Mapping[str, DurationModel]
    overrides: tuple[SkillOverride, ...] = ()
    antithetic: bool = False
    actuations: Mapping[ActuationKey, DurationModel] = field(default_factory=dict)

    def model_of(
        self, skill: str, robot: str, object_kind: str | None
    ) -> DurationModel | None:
        """Return the model of a skill for a robot and a type of object, None without one."""
        found = strongest_exception(self._exceptions, skill, robot, object_kind)
        return self.models.get(skill) if found is None else found

    @cached_property
    def _exceptions(self) -> dict[ExceptionKey, DurationModel]:
        return {
            (item.skill, item.robot, item.object): item.duration
            for item in self.overrides
        }

    def bind(
        self,
        tpg: TemporalPlanGraph,
        names: Mapping[int, TaskName] = MappingProxyType({}),
    ) -> SkillDraws:
        """Return the draws of one TPG, to be reused for the same TPG.

        Args:
            tpg: the graph.
            names: of the draws of tasks that are not named by themselves, by index.
        """
        drawn = sorted(self._drawn(tpg), key=lambda item: item.task)
        least = least_ns(tpg)
        groups: dict[DurationModel, list[int]] = {}
        for row, item in enumerate(drawn):
            groups.setdefault(item.model, []).append(row)
        return SkillDraws(
            nominal=nominal_ns(tpg),
            tasks=np.array([item.task for item in drawn], dtype=np.int64),
            names=tuple(
                names.get(item.task, (tpg.tasks[item.task].robot, item.task))
                for item in drawn
            ),
            skills=[item.what for item in drawn],
            groups=tuple(
                (model, np.array(rows, dtype=np.int64))
                for model, rows in groups.items()
            ),
            nodes=tuple((item.chain, item.nodes, item.weights) for item in drawn),
            least=np.array(
                [
                    _least_total(least[item.chain][item.nodes], item.weights)
                    for item in drawn
                ],
                dtype=np.int64,
            ),
            antithetic=self.antithetic,
        )

    def _drawn(self, tpg: TemporalPlanGraph) -> Iterator[_Drawn]:
        """Yield the drawn durations of a graph's skills."""
        kind_of = {item.name: item.kind for item in tpg.cell.objects}
        for k, (chain, acts) in enumerate(
            zip(tpg.chains, actuation_nodes(tpg), strict=True)
        ):
            skills = np.flatnonzero(chain.skill)
            actuated = np.zeros(len(chain), dtype=np.bool_)
            actuated[list(acts)] = True
            # Within limits motions share what is drawn as their least times, so that what is enough for
            # the whole is enough for each.
            driven = chain.drive if acts else None
            shared = chain.duration if driven is None else driven.least
            tasks, first = np.unique(chain.task[skills], return_index=True)
            # Of no nodes at all np.split makes one empty part.
            parts = np.split(skills, first)[1:]
            for index, own in zip(tasks.tolist(), parts, strict=True):
                task = tpg.tasks[index]
                kind = kind_of.get(task.object or "")
                if task.kind == TaskKind.CHANGEOVER:
                    kind = task.object
                model = self.model_of(task.kind, task.robot, kind)
                if model is not None:
                    weights = chain.duration[own]
                    if actuated[own].any():
                        weights = np.where(actuated[own], 0.0, shared[own])
                    yield _Drawn(index, task.kind, model, k, own, weights)
                    continue
                for node in own[actuated[own]].tolist():
                    act = acts[node]
                    if (model := self.actuations.get(act.key)) is not None:
                        still = np.array([node], dtype=np.int64)
                        yield _Drawn(index, act.act, model, k, still, np.ones(1))


class _Drawn(NamedTuple):
    """A drawn duration of a task.

    Attributes:
        task: its index.
        what: the skill, or the action of a tool in it.
        model: of the duration.
        chain, nodes: that take it together.
        weights: in proportion to which they share it, shape (nodes,).
    """

    task: int
    what: str
    model: DurationModel
    chain: int
    nodes: Indices
    weights: Array


@dataclass(frozen=True)
class SkillDraws:
    """Draws of the skills of one TPG, for any number of replications.

    Attributes:
        nominal: planned duration of every node, per chain [ns].
        tasks: indices of the tasks that vary, in which a skill or a tool does, non-decreasing, shape (s,).
        names: keys of the draws of each of them.
        skills: skill or tool action of each of them.
        groups: each model, and the positions in ``tasks`` that draw from it.
        nodes: chain, skill nodes and their nominal durations [s] of each of the tasks.
        least: the duration of each of the tasks that its joints' speed limits allow; what is
            drawn shorter is raised to it, shape (s,) [ns].
        antithetic: replications 2k and 2k + 1 draw u and 1 - u.
    """

    nominal: tuple[Nanoseconds, ...]
    tasks: Indices
    names: tuple[TaskName, ...]
    skills: list[str]
    groups: tuple[tuple[DurationModel, Indices], ...]
    nodes: tuple[tuple[int, Indices, Array], ...]
    least: Nanoseconds
    antithetic: bool

    def totals(self, *, seed: int, replications: npt.ArrayLike) -> Nanoseconds:
        """Return the duration of every task that varies, shape (s, replications) [ns].

        No joint is faster than its limit then.

        A task of several skill nodes shares its total among them by
        ``share_duration(total, nominal durations of its skill nodes)``.
        """
        drawn = self._drawn(seed, replications)
        return np.maximum(drawn, self.least[:, None])

    def raised(self, *, seed: int, replication: int) -> int:
        """Return the number of skills drawn shorter than joint limits allow."""
        drawn = self._drawn(seed, [replication])
        return int(np.count_nonzero(drawn[:, 0] < self.least))

    def _drawn(self, seed: int, replications: npt.ArrayLike) -> Nanoseconds:
        """Return the durations drawn from the models, shape (s, replications) [ns]."""
        numbers = np.asarray(replications, dtype=np.int64)
        keys = numbers & ~1 if self.antithetic else numbers
        robots = [robot for robot, _ in self.names]
        tasks = np.array([number for _, number in self.names], dtype=np.int64)
        u = uniforms(seed, keys, robots, tasks, self.skills, "duration")
        if self.antithetic:
            mirrored = (numbers & 1).astype(bool)
            # Exact: u is an odd multiple of 2**-53.
            u[:, mirrored] = 1.0 - u[:, mirrored]
        out = np.empty(u.shape, dtype=np.int64)
        for model, rows in self.groups:
            out[rows] = to_nanoseconds(model.ppf(u[rows]))
        return out

    def durations(self, chain: int, totals: Nanoseconds) -> Nanoseconds:
        """Return the duration of every node of a chain, shape (nodes, replications) [ns].

        Args:
            chain: index of the chain.
            totals: duration of every task that varies, see ``totals``.
        """
        out = np.repeat(self.nominal[chain][:, None], totals.shape[1], axis=1)
        for total, (own, nodes, weights) in zip(totals, self.nodes, strict=True):
            if own == chain:
                out[nodes] = share_duration(total, weights)
        return out


def drawn_nodes(
    draws: SkillDraws,
) -> dict[tuple[int, int], tuple[str, DurationModel, float]]:
    """Return the draw that each node's duration belongs to, by chain and node: name, model, share."""
    models = {row: model for model, rows in draws.groups for row in rows.tolist()}
    found = {}
    for row, (chain, nodes, weights) in enumerate(draws.nodes):
        shares = np.diff(cumulative_shares(weights), prepend=0.0)
        for node, share in zip(nodes.tolist(), shares.tolist(), strict=True):
            found[chain, node] = draws.skills[row], models[row], share
    return found


def _least_total(least: Nanoseconds, weights: Array) -> int:
    """Return the least total duration that gives each skill node of a task its least time [ns]."""
    shares = np.diff(cumulative_shares(weights), prepend=0.0)
    asks = np.divide(least, shares, out=np.zeros(len(shares)), where=shares > 0.0)
    return int(np.ceil(asks.max(initial=0.0) * (1.0 - 1e-12)))


def nominal_ns(tpg: TemporalPlanGraph) -> tuple[Nanoseconds, ...]:
    """Return the planned duration of every node, one array a chain [ns]."""
    return tuple(to_nanoseconds(chain.duration) for chain in tpg.chains)


def cumulative_shares(weights: Array) -> Array:
    """Return cumulative shares in proportion to weights; equal ones where all are zero."""
    cumulative = np.cumsum(weights)
    if cumulative[-1] <= 0:
        cumulative = np.arange(1.0, len(weights) + 1)
    return np.asarray(cumulative / cumulative[-1])


def share_duration(total: Nanoseconds, weights: Array) -> Nanoseconds:
    """Split whole numbers in proportion to weights; the parts add up to them exactly.

    Args:
        total: shape (replications,) [ns].
        weights: shape (nodes,).

    Returns:
        Shape (nodes, replications) [ns].
    """
    if len(weights) == 1:
        return total[None]
    bounds = np.rint(cumulative_shares(weights)[:, None] * total).astype(np.int64)
    return np.asarray(np.diff(bounds, axis=0, prepend=0), dtype=np.int64)
