"""Time of robots and machines by state, and their overall equipment effectiveness (OEE)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.tasks.task import TaskKind, changed_tools
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TemporalPlanGraph
from twin.durations.nanoseconds import Nanoseconds, to_nanoseconds
from twin.runs.execution_record import ExecutionRecord
from twin.uncertainty.chain_draws import Standstills
from twin.uncertainty.stop import StopCode

_BRINGING = (TaskKind.ARRIVE, TaskKind.PRESENT, TaskKind.BROUGHT)
_CLEARING = (TaskKind.LEAVE, "pick")


class State(StrEnum):
    """State of a robot or machine; exactly one at any time.

    Attributes:
        WORKING: it moves or works, failed attempts included.
        SETUP: it changes its tool, with the way to the rack, or is changed over, or waits for a changeover.
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
    """Return the chains of robots, and then of machines that work at parts; people who take parts away are none."""
    machines = tpg.machine_chains()
    people = {task.robot for task in tpg.tasks if task.kind == TaskKind.TAKEN_OUT}
    robots = (k for k in range(len(tpg.chains)) if k not in machines)
    working = (k for k in tpg.working_machines() if tpg.chains[k].robot not in people)
    return (*robots, *working)


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
    stood = np.concatenate(run.stood_ns) - again - down
    starts, ends = np.concatenate(run.start_ns), np.concatenate(run.end_ns)
    nodes, one = np.arange(len(stood)), np.zeros_like(stood)
    known = (
        Standstills("breakdown", nodes, one, down),
        Standstills("stall", nodes, one, stood),
    )
    clocks = [run.pace(k).own for k in range(len(tpg.chains))]
    found = worker_times(tpg, starts[:, None], ends[:, None], known, clocks)
    for place, k in enumerate(worker_chains(tpg)):
        by_code = run.stopped_by_code_ns[k] if run.stopped_by_code_ns else {}
        for code, lasts in by_code.items():
            found.state_ns[place, _INDEX[_STATE_OF_STOP[code]]] += lasts
        left = run.stopped_ns(k, run.makespan_ns) - sum(by_code.values())
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
    standstills: Sequence[Standstills],
    clocks: Sequence[Callable[[Nanoseconds], Nanoseconds]] = (),
) -> WorkerTimes:
    """Return the times of replications that were executed as planned.

    A wait belongs to the edge whose source was complete last, a task's dependency on a tie. Time that is
    left after that, as for a message, is idle.

    Args:
        tpg: the executed plan, contracted or not.
        start_ns, end_ns: of every node through all chains, shape (nodes, replications) [ns].
        standstills: of the nodes, which are numbered through all chains.
        clocks: of each chain, from the time of the run to its own, which halts during stops; none without stops.
    """
    workers, total = worker_chains(tpg), end_ns.max(axis=0, initial=0)
    standstills = [own for own in standstills if own.cause != "retry"]
    first, machines = np.cumsum([0, *map(len, tpg.chains)]), tpg.working_machines()
    targets, latest, state = _binding_edges(tpg, first, end_ns)
    setup, never = _setup_nodes(tpg), np.zeros_like(total)
    found = np.zeros((len(workers), len(STATES), len(total)), dtype=np.int64)
    planned = np.zeros((len(workers), 1), dtype=np.int64)
    for place, k in enumerate(workers):
        rows = slice(first[k], first[k + 1])
        own = clocks[k] if clocks else np.asarray
        begun, done, sets = start_ns[rows], end_ns[rows], setup[rows]
        taken = done
        if k in machines:
            until = np.vstack([begun[1:], total])
            taken = np.clip(_removals(tpg, rows, k, end_ns), done, until)
        # Only nodes with edges into them are waited for.
        edges = slice(*np.searchsorted(targets, first[k : k + 2]))
        at = targets[edges] - first[k]
        since, until = np.where(at[:, None] > 0, taken[at - 1], never), begun[at]
        wait = own(np.clip(latest[edges], since, until)) - own(since)
        spent = dict.fromkeys(STATES, never)
        for cause in (State.SETUP, State.WAITING, State.STARVED, State.BLOCKED):
            here = state[edges] == _INDEX[cause]
            spent[cause] = np.where(here, wait, 0).sum(axis=0)
        spent[State.BLOCKED] = spent[State.BLOCKED] + _sum(own(taken)) - _sum(own(done))
        stands, broken, still = (np.zeros_like(total) for _ in range(3))
        for group in standstills:
            mine = (group.node >= first[k]) & (group.node < first[k + 1])
            for which, into in (
                (mine, stands),
                (mine & (group.cause == "breakdown"), broken),
                (mine & setup[group.node], still),
            ):
                np.add.at(into, group.column[which], group.duration_ns[which])
        changes = _sum(own(done[sets]) - own(begun[sets])) - still
        work = _sum(own(done)) - _sum(own(begun)) - stands
        spent[State.SETUP] = spent[State.SETUP] + changes
        spent[State.WORKING] = work - changes
        spent[State.DOWN], spent[State.STOPPED] = broken, stands - broken
        spent[State.IDLE] = own(total) - own(never) - sum(spent.values())
        found[place] = list(spent.values())
        planned[place] = to_nanoseconds(tpg.chains[k].duration)[~sets].sum()
    return WorkerTimes(found, np.repeat(planned, len(total), axis=1))


def _sum(values: Nanoseconds) -> Nanoseconds:
    return np.asarray(values.sum(axis=0), dtype=np.int64)


def _binding_edges(
    tpg: TemporalPlanGraph, first: Indices, end_ns: Nanoseconds
) -> tuple[Indices, Nanoseconds, npt.NDArray[np.int8]]:
    """Return the nodes with edges into them, when the last source of each was complete, and what waiting for it is."""
    a, m, b, n = tpg.edges.T
    target = first[b] + n
    order = np.argsort(target, kind="stable")
    source, target = (first[a] + m)[order], target[order]
    task = np.concatenate([chain.task for chain in tpg.chains])
    kinds = dict.fromkeys(_BRINGING, State.WAITING)
    kinds |= dict.fromkeys(_CLEARING, State.BLOCKED)
    kinds[TaskKind.CHANGEOVER] = State.SETUP
    of_task = [_INDEX[kinds.get(t.kind, State.STARVED)] for t in tpg.tasks]
    of_edge = np.array(of_task, dtype=np.int8)[task[source]]
    of_edge[tpg.cause[order] == MOTION_CONFLICT] = _INDEX[State.BLOCKED]
    groups = np.flatnonzero(np.diff(target, prepend=-1))
    counts, last = np.diff(groups, append=len(target)), end_ns[source[groups]]
    state = np.repeat(of_edge[groups, None], last.shape[1], axis=1)
    # Of nodes with several edges all first ones, then all second ones, and so on.
    several = [np.flatnonzero(counts > max(k, 1)) for k in range(counts.max(initial=0))]
    for k, own in enumerate(several):
        last[own] = np.maximum(last[own], end_ns[source[groups[own] + k]])
        state[own] = len(STATES)
    for k, own in enumerate(several):
        edge = groups[own] + k
        binds = end_ns[source[edge]] == last[own]
        better = np.minimum(state[own], of_edge[edge, None])
        state[own] = np.where(binds, better, state[own])
    return target[groups], last, state


def _setup_nodes(tpg: TemporalPlanGraph) -> npt.NDArray[np.bool_]:
    """Tell which nodes are changeovers, handle a tool at its rack or bring a robot there, shape (nodes,)."""
    tools = changed_tools(tpg.tasks)
    changes = np.array(
        [t.kind == TaskKind.CHANGEOVER or t.object in tools for t in tpg.tasks]
    )
    transits = np.array([t.kind == TaskKind.TRANSIT for t in tpg.tasks])
    found = []
    for chain in tpg.chains:
        sets, ways = changes[chain.task].tolist(), transits[chain.task].tolist()
        for n in range(len(sets) - 2, -1, -1):
            sets[n] |= sets[n + 1] and ways[n]
        found.append(np.array(sets, dtype=np.bool_))
    return np.concatenate(found)


def _removals(
    tpg: TemporalPlanGraph, rows: slice, machine: int, end_ns: Nanoseconds
) -> Nanoseconds:
    """Return when each part was picked at which a machine had worked, 0 where none was, shape (its nodes, ...) [ns]."""
    gone = np.zeros_like(end_ns[rows])
    last = np.full(len(tpg.tasks), -1)
    task = np.concatenate([chain.task for chain in tpg.chains])
    np.maximum.at(last, task, np.arange(len(task)))
    picks: dict[str | None, list[int]] = {}
    for t in tpg.tasks:
        if t.kind == "pick" and last[t.index] >= 0:
            picks.setdefault(t.object, []).append(t.index)
    for node, k in enumerate(tpg.chains[machine].task.tolist()):
        later = (p for p in picks.get(tpg.tasks[k].object, ()) if p > k)
        if (pick := next(later, None)) is not None:
            gone[node] = end_ns[last[pick]]
    return gone


def ratio(part: npt.NDArray[Any], whole: npt.NDArray[Any]) -> Array:
    """Return quotients, NaN where the divisor is not above 0."""
    found = np.full(part.shape, np.nan)
    np.divide(part, whole, out=found, where=whole > 0)
    return found
