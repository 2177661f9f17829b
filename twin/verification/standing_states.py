"""Standstills after a worst-case delay: one robot never finishes a node, and all others continue as far as possible.

Every type-2 edge makes a robot wait for a node of another robot. If that node is never completed, the others continue
until none of them can move. The cell then remains in a state that does not occur in a nominal run. The audit checks
all such states.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.graph_structure import find_precedence
from twin.audits.audit import Auditor
from twin.audits.case import Violation
from twin.audits.motion.executed import ObjectRow, Recording, RobotRows
from twin.audits.worlds.engines import Engine, engine_and_version, engine_named
from twin.host.progress import Report, report_nothing

STOPPING = "robots that stop"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class StandingState:
    """The cell after one robot stopped and all others advanced as far as allowed.

    Attributes:
        robot: name of the robot that stopped.
        node: the node that it never completes.
        at_end: True when it stands at the end of that node, False when at its start.
        completed: per chain, how many of its nodes are complete.
    """

    robot: str
    node: int
    at_end: bool
    completed: tuple[int, ...]


@dataclass(frozen=True)
class AdversaryReport:
    """Result of the audit of all standing states.

    Attributes:
        states: how many were looked at.
        min_distance_m: least distance of any two robots in them [m].
        violations: each with the state it was seen in; empty when all is well.
        engine: collision engine and its version.
    """

    states: int
    min_distance_m: float
    violations: tuple[tuple[StandingState, Violation], ...]
    engine: str


def standing_states(tpg: TemporalPlanGraph) -> Iterator[StandingState]:
    """Yield two states for the source of every type-2 edge: stopped at its start and its end."""
    precedence = find_precedence(tpg)
    for chain, node in sorted({(a, u) for a, u, _, _ in tpg.edges.tolist()}):
        if precedence is None:  # a cycle: some nodes are never complete
            completed = run_until_still(tpg, chain, node)
        else:
            completed = tuple(
                node if k == chain else precedence.not_after(chain, node, k)
                for k in range(len(tpg.chains))
            )
        for at_end in (False, True):
            yield StandingState(tpg.chains[chain].robot, node, at_end, completed)


def run_until_still(tpg: TemporalPlanGraph, frozen: int, node: int) -> tuple[int, ...]:
    """Return the number of nodes of each chain that complete if one node never does.

    Args:
        tpg: the graph.
        frozen: chain of the node.
        node: the node that is never complete.
    """
    dispatcher = Dispatcher(tpg)
    ready = dispatcher.ready()
    while ready:
        chain, index = ready.pop()
        if (chain, index) != (frozen, node):
            ready += dispatcher.complete(chain, index)
    return tuple(dispatcher.completed(k) for k in range(len(tpg.chains)))


def standing_recording(tpg: TemporalPlanGraph, state: StandingState) -> Recording:
    """Return a standing state as one second in which nothing moves."""
    robots = {}
    chains, counts = tpg.chain_index, _begun(tpg, state)
    for placed in tpg.cell.robots:
        if placed.name not in chains:
            q, nodes = placed.home, [-1, -1]
        else:
            count = counts[chains[placed.name]]
            chain = tpg.chains[chains[placed.name]]
            q = chain.stands_at(count)
            nodes = [max(count - 1, 0), min(count, len(chain) - 1)]
        rows = RobotRows(np.array([0.0, 1.0]), np.stack([q, q]), np.array(nodes))
        robots[placed.name] = rows
    objects = tuple(
        ObjectRow(0.0, h.object, h.holder, h.pose)
        for h in tpg.handlings
        if h.node < counts[h.robot] or tpg.holds_before(h)
    )
    return Recording(robots, objects, 1.0)


def _begun(tpg: TemporalPlanGraph, state: StandingState) -> tuple[int, ...]:
    """Return the number of nodes after which each chain stands."""
    counts = list(state.completed)
    counts[tpg.chain_index[state.robot]] += state.at_end
    return tuple(counts)


def audit_standing_states(
    tpg: TemporalPlanGraph,
    progress: Report = report_nothing,
    engine: Engine | None = None,
) -> AdversaryReport:
    """Stop every robot wherever another waits for it, and audit the resulting states.

    Args:
        tpg: the plan.
        progress: receives the number of checked states and the total.
        engine: to measure with; by default PyBullet where it is installed, else coal.

    Raises:
        RequestError: the engine is not installed.
    """
    states = list(standing_states(tpg))
    least, found = math.inf, []
    chosen = engine_named(engine)
    known: dict[tuple[int, ...], tuple[Violation, ...]] = {}
    with Auditor(tpg, chosen) as auditor:
        for k, state in enumerate(states):
            counts = _begun(tpg, state)
            if counts not in known:  # many stops may lead to the same state
                report = auditor.audit(
                    standing_recording(tpg, state), within=least, ordered=False
                )
                least, known[counts] = report.min_distance_m, report.violations
            found += [(state, violation) for violation in known[counts]]
            progress(STOPPING, k + 1, len(states))
    return AdversaryReport(len(states), least, tuple(found), engine_and_version(chosen))
