"""Standstills after a worst-case delay: one robot never finishes a node, and all others continue as far as possible.

Every type-2 edge makes a robot wait for a node of another robot. If that node is never completed, the others continue
until none of them can move. The cell then remains in a state that does not occur in a nominal run. The audit checks
all such states.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planning.tasks.task import Handling
from planning.transforms import Array, Transform
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.graph_structure import find_precedence
from twin.audits.audit import STATES_APART_S, Auditor
from twin.audits.case import Violation
from twin.audits.motion.executed import ObjectRow, Recording, RobotRows, Stay
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


def standing_recording(tpg: TemporalPlanGraph, counts: tuple[int, ...]) -> Recording:
    """Return the state after some nodes of each chain as one second in which nothing moves."""
    objects = tuple(
        ObjectRow(0.0, h.object, h.holder, h.pose)
        for h in tpg.handlings
        if h.node < counts[h.robot] or tpg.holds_before(h)
    )
    robots = _standing_rows(tpg, [counts], np.array([[0.0, 1.0]]))
    return Recording(robots, objects, 1.0)


def _standing_rows(
    tpg: TemporalPlanGraph, stops: Sequence[tuple[int, ...]], times: Array
) -> dict[str, RobotRows]:
    """Return rows of robots that stand in one state after another.

    Args:
        tpg: the plan.
        stops: of each state, the number of nodes after which each chain stands.
        times: of the rows of each state, shape (states, m) [s]; the last is of the node after it.
    """
    robots, chains, each = {}, tpg.chain_index, times.shape[1]
    for placed in tpg.cell.robots:
        q = np.tile(placed.home, (len(stops), 1))
        nodes = np.full(times.shape, -1)
        if placed.name in chains:
            index = chains[placed.name]
            chain = tpg.chains[index]
            counts = np.array([stop[index] for stop in stops], dtype=np.int64)
            q = np.vstack([chain.start[None], chain.waypoints])[chain.first[counts]]
            nodes[:] = np.maximum(counts - 1, 0)[:, None]
            nodes[:, -1] = np.minimum(counts, len(chain) - 1)
        q = np.repeat(q, each, axis=0)
        robots[placed.name] = RobotRows(times.ravel(), q, nodes.ravel())
    return robots


def _placements(
    tpg: TemporalPlanGraph, stops: Sequence[tuple[int, ...]]
) -> Iterator[dict[str, Stay]]:
    """Yield the places of all present objects in states, each place as one and the same stay."""
    numbers = {item.name: k for k, item in enumerate(tpg.cell.objects)}
    # Each with the node, of a chain, in which it is put there; -1 from the start on.
    known: list[tuple[str, str | None, Transform, int, int]] = [
        (o.name, None, o.start, 0, -1) for o in tpg.cell.objects if not o.later
    ]
    known += [
        (h.object, h.holder, h.pose, h.robot, -1 if tpg.holds_before(h) else h.node)
        for h in tpg.handlings
    ]
    stays = [Stay(*at[:3], 0.0, math.inf, None) for at in known]
    gone = np.array([stay.holder == Handling.GONE for stay in stays], dtype=np.bool_)
    rows = [(numbers[at[0]], *at[3:]) for at in known]
    number, chain, node = np.array(rows, dtype=np.int64).reshape(-1, 3).T
    for counts in stops:
        done = np.flatnonzero(node < np.array(counts)[chain])
        last = np.full(len(numbers), -1)
        np.maximum.at(last, number[done], done)
        last = last[last >= 0]
        there = [stays[k] for k in last[~gone[last]].tolist()]
        yield {stay.object: stay for stay in there}


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
    begun = [_begun(tpg, state) for state in states]
    stops = list(dict.fromkeys(begun))  # many stops may lead to the same state
    times = np.add.outer(STATES_APART_S * np.arange(len(stops)), np.arange(3.0))
    least, chosen = math.inf, engine_named(engine)
    known: dict[tuple[int, ...], tuple[Violation, ...]] = {}
    with Auditor(tpg, chosen) as auditor:
        recording = Recording(
            _standing_rows(tpg, stops, times), (), times.max(initial=0.0)
        )
        looks = auditor.audit_stands(recording, _placements(tpg, stops))
        for counts, report in zip(stops, looks, strict=False):
            if report.violations:
                alone = standing_recording(tpg, counts)
                report = auditor.audit(alone, within=least, ordered=False)
            least, known[counts] = report.min_distance_m, report.violations
            progress(STOPPING, len(known), len(stops))
    found = [
        (s, v) for s, counts in zip(states, begun, strict=True) for v in known[counts]
    ]
    return AdversaryReport(len(states), least, tuple(found), engine_and_version(chosen))
