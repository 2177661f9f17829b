"""Time of robots and machines by state, and their overall equipment effectiveness (OEE)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.tasks.task import TaskKind
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TemporalPlanGraph
from twin.durations.nanoseconds import Nanoseconds, to_nanoseconds
from twin.runs.execution_record import ExecutionRecord
from twin.uncertainty.stop import StopCode

_BRINGING = (TaskKind.ARRIVE, TaskKind.PRESENT, TaskKind.BROUGHT)
_CLEARING = (TaskKind.LEAVE, "pick")
_CHANGING = (TaskKind.LEAVE_TOOL, TaskKind.TAKE_TOOL)


class State(StrEnum):
    """State of a robot or machine; exactly one at any time.

    Attributes:
        WORKING: it moves or works, failed attempts included.
        SETUP: it changes its tool, with the way to the rack.
        WAITING: a part has not come from its source yet.
        STARVED: the work of another one, on which its next task depends, is not done yet.
        BLOCKED: its next place, or the way there, is not free; of a machine also that it is done and its
            part was not picked yet.
        DOWN: it is broken down.
        STOPPED: it stands because of a stall or an emergency stop.
        PLANNED: a planned stop.
        OFF_SHIFT: out of the hours of its calendar.
        IDLE: nothing is left to do, or it waits for a message, the clock or its turn.
    """

    WORKING = "working"
    SETUP = "setup"
    WAITING = "waiting for part"
    STARVED = "starved"
    BLOCKED = "blocked"
    DOWN = "down"
    STOPPED = "stopped"
    PLANNED = "planned stop"
    OFF_SHIFT = "off shift"
    IDLE = "idle"


STATES = tuple(State)
"""All states, in the order in which arrays have them."""

_INDEX = {state: k for k, state in enumerate(STATES)}

_STATE_OF_STOP: dict[StopCode, State] = {
    "off-shift": State.OFF_SHIFT,
    "planned": State.PLANNED,
    "breakdown": State.DOWN,
    "emergency": State.STOPPED,
}


@dataclass(frozen=True)
class WorkerTimes:
    """Times of robots and working machines in some replications, in the order of ``worker_chains``.

    Attributes:
        state_ns: time in each of STATES, adding up to the makespan, shape (workers, states, replications) [ns].
        planned_ns: planned time of the work without setup, shape (workers, replications) [ns].
    """

    state_ns: Nanoseconds
    planned_ns: Nanoseconds

    def shares_and_factors(self, quality: Array) -> dict[str, Array]:
        """Return shares of time by state, and factors of the OEE after ISO 22400-2, shape (workers, replications) each.

        ``availability`` is the working time over the planned busy time, which is all but planned stops and
        hours off shift; ``performance`` the planned time of the work over its actual time; ``oee`` the product
        of both and ``quality``. What never works has NaN.

        Args:
            quality: share of good products, shape (replications,).
        """
        time = dict(zip(STATES, np.moveaxis(self.state_ns, 1, 0), strict=True))
        work, total = time[State.WORKING], self.state_ns.sum(axis=1)
        off = time[State.PLANNED] + time[State.OFF_SHIFT]
        factors = {
            "availability": ratio(work, total - off),
            "performance": ratio(self.planned_ns, work),
            "quality": np.broadcast_to(quality, work.shape),
        }
        oee = np.prod(list(factors.values()), axis=0)
        return (
            {s: ratio(own, total) for s, own in time.items()} | factors | {"oee": oee}
        )


def worker_chains(tpg: TemporalPlanGraph) -> tuple[int, ...]:
    """Return the chains of robots, and then of machines that work at parts."""
    machines = tpg.machine_chains()
    robots = (k for k in range(len(tpg.chains)) if k not in machines)
    return (*robots, *tpg.working_machines())


def run_worker_times(
    tpg: TemporalPlanGraph, run: ExecutionRecord, names: Sequence[str] = ()
) -> WorkerTimes:
    """Return the times of one run in which every node ended, as one replication.

    Args:
        tpg: the executed plan.
        run: how.
        names: of the workers of interest, idle where they are not in the plan; by default those of
            ``worker_chains``.
    """
    down, again = (np.zeros(sum(map(len, tpg.chains)), np.int64) for _ in range(2))
    offset = 0
    for chain, stands in zip(tpg.chains, run.standstills, strict=True):
        for own in stands:
            of_cause = {"breakdown": down, "retry": again}.get(own.cause)
            if of_cause is not None:
                of_cause[offset + own.node] += own.duration_ns
        offset += len(chain)
    stood = np.concatenate(run.stood_ns) - again
    starts, ends = np.concatenate(run.start_ns), np.concatenate(run.end_ns)
    starts, ends, stood, down = (own[:, None] for own in (starts, ends, stood, down))
    clocks = [run.pace(k).own for k in range(len(tpg.chains))]
    found = worker_times(tpg, starts, ends, stood, down, clocks)
    for place, k in enumerate(worker_chains(tpg)):
        known = run.stopped_by_code_ns[k] if run.stopped_by_code_ns else {}
        for code, lasts in known.items():
            found.state_ns[place, _INDEX[_STATE_OF_STOP[code]]] += lasts
        left = run.stopped_ns(k, run.makespan_ns) - sum(known.values())
        found.state_ns[place, _INDEX[State.STOPPED]] += left
    if not names:
        return found
    own_names = [tpg.chains[k].robot for k in worker_chains(tpg)]
    states = np.zeros((len(names), len(STATES), 1), dtype=np.int64)
    states[:, _INDEX[State.IDLE]] = run.makespan_ns
    planned = np.zeros((len(names), 1), dtype=np.int64)
    for place, name in enumerate(names):
        if name in own_names:
            states[place] = found.state_ns[own_names.index(name)]
            planned[place] = found.planned_ns[own_names.index(name)]
    return WorkerTimes(states, planned)


def worker_times(
    tpg: TemporalPlanGraph,
    start_ns: Nanoseconds,
    end_ns: Nanoseconds,
    stood_ns: Nanoseconds,
    down_ns: Nanoseconds,
    clocks: Sequence[Callable[[Nanoseconds], Nanoseconds]] = (),
) -> WorkerTimes:
    """Return the times of replications that were executed as planned.

    A wait belongs to the edge whose source was complete last, a task's dependency on a tie. Time that is
    left after that, as for a message, is idle.

    Args:
        tpg: the executed plan, contracted or not.
        start_ns, end_ns: of every node through all chains, shape (nodes, replications) [ns].
        stood_ns: standstills in each node, without failed attempts, of the same shape [ns].
        down_ns: those of them that are breakdowns [ns].
        clocks: of each chain, from the time of the run to its own, which halts during stops; none without stops.
    """
    workers, total = worker_chains(tpg), end_ns.max(axis=0, initial=0)[None]
    first = np.cumsum([0, *map(len, tpg.chains)])
    latest, state = _binding_edges(tpg, first, end_ns)
    setup, gone = _setup_nodes(tpg), _removals(tpg, first, end_ns)
    found = np.zeros((len(workers), len(STATES), end_ns.shape[1]), dtype=np.int64)
    planned = np.zeros((len(workers), 1), dtype=np.int64)
    never = np.zeros_like(total)
    for place, k in enumerate(workers):
        rows = slice(first[k], first[k + 1])
        own = clocks[k] if clocks else np.asarray
        begun, done, sets = start_ns[rows], end_ns[rows], setup[rows]
        # The last wait is until the end of the run.
        since, until = np.vstack([never, done]), np.vstack([begun, total])
        taken = np.clip(np.vstack([never, gone[rows]]), since, until)
        met = np.clip(np.vstack([latest[rows], never]), taken, until)
        times = [own(t) for t in (since, taken, met, until)]
        full, wait, rest = map(np.subtract, times[1:], times[:-1])
        spent = dict.fromkeys(STATES, never[0])
        for cause in (State.WAITING, State.STARVED, State.BLOCKED):
            here = state[rows] == _INDEX[cause]
            spent[cause] = np.where(here, wait[:-1], 0).sum(axis=0)
        spent[State.BLOCKED] = spent[State.BLOCKED] + full.sum(axis=0)
        spent[State.IDLE] = rest.sum(axis=0)
        work = own(done) - own(begun) - stood_ns[rows]
        spent[State.WORKING] = work[~sets].sum(axis=0)
        spent[State.SETUP] = work[sets].sum(axis=0)
        spent[State.DOWN] = down_ns[rows].sum(axis=0)
        spent[State.STOPPED] = (stood_ns - down_ns)[rows].sum(axis=0)
        found[place] = list(spent.values())
        planned[place] = to_nanoseconds(tpg.chains[k].duration)[~sets].sum()
    return WorkerTimes(found, np.repeat(planned, end_ns.shape[1], axis=1))


def _binding_edges(
    tpg: TemporalPlanGraph, first: Indices, end_ns: Nanoseconds
) -> tuple[Nanoseconds, Indices]:
    """Return when the last source of each node was complete, and the state that waiting for it is."""
    latest = np.zeros_like(end_ns)
    state = np.full(end_ns.shape, len(STATES))
    if not len(tpg.edges):
        return latest, state
    a, m, b, n = tpg.edges.T
    target = first[b] + n
    order = np.argsort(target, kind="stable")
    source, target = (first[a] + m)[order], target[order]
    task = np.concatenate([chain.task for chain in tpg.chains])
    kinds = dict.fromkeys(_BRINGING, State.WAITING)
    kinds |= dict.fromkeys(_CLEARING, State.BLOCKED)
    of_task = [_INDEX[kinds.get(t.kind, State.STARVED)] for t in tpg.tasks]
    conflict = tpg.cause[order] == MOTION_CONFLICT
    by_edge = np.where(conflict, _INDEX[State.BLOCKED], np.array(of_task)[task[source]])
    groups = np.flatnonzero(np.diff(target, prepend=-1))
    counts, done = np.diff(groups, append=len(target)), end_ns[source]
    last = np.maximum.reduceat(done, groups, axis=0)
    binds = done == np.repeat(last, counts, axis=0)
    which = np.where(binds, by_edge[:, None], len(STATES))
    latest[target[groups]] = last
    state[target[groups]] = np.minimum.reduceat(which, groups, axis=0)
    return latest, state


def _setup_nodes(tpg: TemporalPlanGraph) -> npt.NDArray[np.bool_]:
    """Tell which nodes handle a tool at its rack, or bring a robot there, shape (nodes,)."""
    tools = {task.object for task in tpg.tasks if task.kind in _CHANGING}
    found = []
    for chain in tpg.chains:
        tasks = [tpg.tasks[k] for k in chain.task.tolist()]
        sets = [task.object in tools for task in tasks]
        for n in range(len(tasks) - 2, -1, -1):
            sets[n] |= sets[n + 1] and tasks[n].kind == TaskKind.TRANSIT
        found.append(np.array(sets, dtype=np.bool_))
    return np.concatenate(found)


def _removals(
    tpg: TemporalPlanGraph, first: Indices, end_ns: Nanoseconds
) -> Nanoseconds:
    """Return when a part was picked at which a machine had worked, by its node; 0 where none was, shape as ``end_ns`` [ns]."""
    gone = np.zeros_like(end_ns)
    task = np.concatenate([chain.task for chain in tpg.chains])
    last = np.full(len(tpg.tasks), -1)
    np.maximum.at(last, task, np.arange(len(task)))
    picks: dict[str | None, list[int]] = {}
    for t in tpg.tasks:
        if t.kind == "pick" and last[t.index] >= 0:
            picks.setdefault(t.object, []).append(t.index)
    for k in tpg.working_machines():
        for row in range(first[k], first[k + 1]):
            work = tpg.tasks[task[row]]
            later = (p for p in picks.get(work.object, ()) if p > work.index)
            if (pick := next(later, None)) is not None:
                gone[row] = end_ns[last[pick]]
    return gone


def ratio(part: npt.NDArray[Any], whole: npt.NDArray[Any]) -> Array:
    """Return quotients, NaN where the divisor is not above 0."""
    found = np.full(part.shape, np.nan)
    np.divide(part, whole, out=found, where=whole > 0)
    return found
