"""Queues and lines as temporal plan graphs, for tests: a node a service, an edge where a customer or a place is waited for."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from planning.tasks.task import Task
from scheduling.graph.temporal_plan_graph import (
    TASK_DEPENDENCY,
    TemporalPlanGraph,
    pose_nodes,
)
from tests.twin.twin_toys import toy_cell
from twin.bulk.bulk_engine import BulkEngine
from twin.durations.model import DurationModel
from twin.engine.execution_model import ExecutionModel
from twin.throughput.states import STATES, worker_chains, worker_times
from twin.throughput.throughput import ProductTimes, product_times
from twin.uncertainty.skill_durations import SkillDurations


class Service(NamedTuple):
    """A node of a station: kind of its task, product, and the (station, number) of nodes that it waits for."""

    kind: str
    product: int
    after: tuple[tuple[str, int], ...] = ()
    object: str | None = None
    seconds: float = 0.0


def line_tpg(
    stations: Mapping[str, Sequence[Service]], machines: Sequence[str] = ()
) -> TemporalPlanGraph:
    """Return a graph with a chain for each station; those that are not machines are robots."""
    cell = toy_cell([1] * len(stations))
    placed = {
        name: replace(robot, name=name)
        for name, robot in zip(stations, cell.robots, strict=True)
    }
    robots = tuple(own for name, own in placed.items() if name not in machines)
    cell = replace(cell, robots=robots, machines=tuple(placed[k] for k in machines))
    rows = [
        (n, k, name, own)
        for k, (name, services) in enumerate(stations.items())
        for n, own in enumerate(services)
    ]
    rows.sort(key=lambda row: (row[3].product, row[0], row[1]))
    index = {(name, n): m for m, (n, _, name, _) in enumerate(rows)}
    path = np.zeros((1, 1))
    tasks = tuple(
        Task(
            m,
            name,
            own.kind,
            own.product,
            f"{own.kind} {own.product}",
            path,
            (),
            own.object,
        )
        for m, (_, _, name, own) in enumerate(rows)
    )
    chains = tuple(
        pose_nodes(
            name,
            np.zeros(1),
            np.zeros((len(services), 1)),
            np.array([index[name, n] for n in range(len(services))]),
            np.array([own.seconds for own in services]),
            skill=True,
        )
        for name, services in stations.items()
    )
    place = {name: k for k, name in enumerate(stations)}
    edges = sorted((place[a], m, k, n) for n, k, _, own in rows for a, m in own.after)
    cause = np.full(len(edges), TASK_DEPENDENCY, dtype=np.uint8)
    products = np.array([own.product for *_, own in rows])
    array = np.array(edges, dtype=np.int64).reshape(-1, 4)
    return TemporalPlanGraph(
        cell, tasks, chains, array, cause, (), (), products=products
    )


class Replications(NamedTuple):
    """Products of replications, shares of time by station and state, shape (replications,) each, and makespans [s]."""

    times: ProductTimes
    shares: Mapping[str, Mapping[str, np.ndarray]]
    makespan_s: np.ndarray


def replicate(
    tpg: TemporalPlanGraph, durations: Mapping[str, DurationModel], count: int
) -> Replications:
    """Execute a graph in bulk."""
    engine = BulkEngine(tpg, ExecutionModel(SkillDurations(durations)))
    drawn = engine.sample(seed=3, replications=range(count))
    found, own = engine.execute(drawn), engine.contraction.tpg
    spent = worker_times(own, found.start_ns, found.end_ns, ())
    assert np.array_equal(
        spent.state_ns.sum(axis=1),
        np.broadcast_to(found.makespan_ns, spent.planned_ns.shape),
    )
    shares = spent.shares_and_factors(np.ones(count))
    times = product_times(own, found.start_ns, found.end_ns)
    assert times is not None
    return Replications(
        times,
        {
            own.chains[k].robot: {
                state: shares[state][place] for state in (*STATES, "performance")
            }
            for place, k in enumerate(worker_chains(own))
        },
        found.makespan_ns / 1e9,
    )


def queue(customers: int) -> dict[str, list[Service]]:
    """Return a queue with one server: customers enter as they arrive, and are served in their order."""
    numbers = range(customers)
    return {
        "source": [Service("arrive", k + 1) for k in numbers],
        "gate": [Service("enter", k + 1, (("source", k),)) for k in numbers],
        "server": [Service("serve", k + 1, (("gate", k),)) for k in numbers],
    }


def two_machines(parts: int, buffer: int, gate: bool) -> dict[str, list[Service]]:
    """Return two machines with places for parts between them; the first is never starved without a gate.

    A part stays in the first machine until there is a place (blocking after service).
    """
    found = queue(parts) if gate else {}
    found.pop("server", None)
    first, second = [], []
    for k in range(parts):
        after = [("gate", k)] if gate else []
        if k > buffer:
            after.append(("second", 2 * (k - buffer - 1)))
        first.append(Service("drill", k + 1, tuple(after)))
        second.append(Service("pick", k + 1, (("first", k),)))
        second.append(Service("work", k + 1))
    return found | {"first": first, "second": second}
