"""Completion times of nodes in many replications, for robots with acceleration limits.

The speed at the end of a node depends on the later nodes that are released by then, so completion times are not
longest paths. Replications are simulated one after another, each with a time-ordered queue of the next actions of
robots. At equal times, robots at rest start before moving robots decide on their speed, as in the event engine. If
a robot starts from rest, is released up to its next stop and has no disturbance, its node times are the same in
every replication. They are computed once and reused.

Compiled inner functions take single arrays and numbers instead of tuples. For an array in a tuple, numba counts
references atomically, which took three quarters of the time.
"""

from __future__ import annotations

import numpy as np

from planning.kernels import inner_kernel, kernel
from planning.timing.stretch import brake_within_piece, exit_bound, passage_seconds
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import EVER, TemporalPlanGraph
from twin.bulk.max_plus import PrecedenceArrays
from twin.durations.nanoseconds import Nanoseconds
from twin.engine.passage import DriveTimes, drive_times

_NEVER = 2**61

_REMEMBERED = 4
"""Nodes of passages that are remembered, over the nodes of the graph."""


def joined_drives(tpg: TemporalPlanGraph, graph: PrecedenceArrays) -> DriveTimes:
    """Return the drive times of a graph with a policy's edges, nodes numbered through."""
    drives = [drive_times(c, np.zeros(len(c), dtype=np.int64)) for c in tpg.chains]
    nodes = len(graph.order)
    out = DriveTimes(
        np.zeros(nodes),
        np.ones(nodes),
        np.zeros(nodes),
        np.zeros(nodes, dtype=np.int64),
        np.zeros(nodes, dtype=np.int64),
    )
    for first, drive in zip(graph.first.tolist(), drives, strict=False):
        for whole, own in zip(out, drive, strict=True):
            whole[first : first + len(own)] = own
        out.last[first : first + len(drive.last)] += first
    return out


@kernel
def driven_times(
    graph: PrecedenceArrays,
    drive: DriveTimes,
    motion_ns: Nanoseconds,
    stand_ns: Nanoseconds,
    override: Array,
    ahead: int,
) -> tuple[Nanoseconds, Nanoseconds]:
    """Return start and end of every node, in every replication.

    Args:
        graph: precedence graph, not contracted.
        drive: of its chains.
        motion_ns: durations that were drawn, at full speed, shape (replications, nodes) [ns].
        stand_ns: standstills of each node, of the same shape [ns].
        override: share of planned speed at which each node is executed, of the same shape, see
            ``drive_times``; of shape (0, 0) for 1.
        ahead: nodes that a robot may have been given and has not completed.

    Returns:
        Two arrays of the same shape [ns].
    """
    start, end = np.empty_like(motion_ns), np.empty_like(motion_ns)
    first, last_of = graph.first, drive.last
    ramp, lag = drive.ramp.copy(), drive.lag.copy()
    patience, edge_first, source = graph.patience, graph.edge_first, graph.source
    top, length = drive.top.copy(), drive.length.copy()
    chains, nodes = len(first) - 1, len(top)
    node = np.empty(chains, np.int64)
    base, due = np.empty(chains, np.int64), np.empty(chains, np.int64)
    passed, speed = np.empty(chains), np.empty(chains)
    pending = np.empty(chains, np.int64)
    waiting = _waiting(edge_first, nodes, ahead)
    # Of each node the place of the passage that begins with it, -1 if it is not known yet; times from its begin.
    known = np.full(nodes, -1)
    known_start = np.empty(_REMEMBERED * nodes, np.int64)
    known_end = np.empty(_REMEMBERED * nodes, np.int64)
    remembered = 0
    disturbed = np.zeros(nodes + 1, np.int64)  # how many of the nodes before each
    for r in range(len(motion_ns)):
        begun, done, stand = start[r], end[r], stand_ns[r]
        begun[:] = _NEVER
        done[:] = _NEVER
        for n in range(nodes):
            factor, before, whole = 1.0, 1.0, drive.length[n]
            if len(override):
                factor, before = override[r, n], override[0, n]
                ramp[n] = drive.ramp[n] / factor
                lag[n] = np.int64(np.ceil(drive.lag[n] / factor))
                whole /= factor
            # A shorter time than at full speed means a shorter path.
            length[n] = whole
            if motion_ns[r, n] < length[n] - 1.0:
                length[n] = max(1.0, float(motion_ns[r, n]))
            slower = motion_ns[r, n] > length[n] + 1.0
            top[n] = length[n] / motion_ns[r, n] if slower else 1.0
            usual = length[n] == whole and not slower and stand[n] == 0
            usual = usual and factor == before
            disturbed[n + 1] = disturbed[n] + (0 if usual else 1)
        for k in range(chains):
            node[k] = first[k]
            base[k], due[k], pending[k] = 0, -1, 0
            passed[k], speed[k] = 0.0, 0.0
        while True:
            for k in range(chains):
                n = node[k]
                if due[k] < 0 and n < first[k + 1]:
                    ready = base[k] + np.int64(np.rint(passed[k]))
                    if speed[k] <= 0.0:
                        clear = _clear(
                            edge_first,
                            source,
                            patience,
                            begun,
                            done,
                            n,
                            first[k],
                            ahead,
                        )
                        ready = max(ready, clear)
                        if n == first[k] or last_of[n - 1] != last_of[n]:
                            ready = max(ready, graph.not_before[n])
                    if ready < _NEVER:
                        due[k] = ready
            k = _next(due, node, length)
            if k < 0:
                break
            n, now = node[k], due[k]
            due[k] = -1
            if length[n] <= 0.0:
                begun[n] = now
                done[n] = now + motion_ns[r, n] + stand[n]
                base[k], passed[k] = done[n], 0.0
                node[k] = n + 1
                continue
            if speed[k] <= 0.0:
                base[k], passed[k] = now, 0.0
            last = waiting[
                n + 1
            ]  # the first one that it may not enter as far as it knows
            while last <= last_of[n] and (
                _clear(edge_first, source, patience, begun, done, last, first[k], ahead)
                <= now
            ):
                last = waiting[last + 1]
            last = min(last - 1, last_of[n])
            alike = speed[k] <= 0.0 and pending[k] == 0 and last == last_of[n]
            alike = alike and disturbed[last + 1] == disturbed[n]
            place = known[n]
            if alike and place >= 0:
                for m in range(n, last + 1):
                    begun[m] = now + known_start[place + m - n]
                    done[m] = now + known_end[place + m - n]
                base[k], passed[k], node[k] = done[last], 0.0, last + 1
                continue
            opened, stop = n, _settled(length, ramp, n, last, last_of[n])
            for n in range(opened, stop + 1):
                opens = n == first[k] or last_of[n - 1] != last_of[n]
                begun[n] = base[k] + np.int64(np.rint(passed[k]))
                if not opens:
                    begun[n] += lag[n]
                bound = exit_bound(length, top, n, last, ramp)
                base[k], passed[k], speed[k], pending[k] = _pass(
                    length[n],
                    top[n],
                    ramp[n],
                    bound,
                    base[k],
                    passed[k],
                    speed[k],
                    pending[k] + stand[n],
                )
                done[n] = base[k] + np.int64(np.rint(passed[k])) + lag[n]
            node[k] = stop + 1
            if stop == last_of[stop]:
                speed[k] = 0.0
                base[k], passed[k] = done[stop], 0.0
            more = last + 1 - opened
            if alike and remembered + more <= len(known_start):
                known[opened] = remembered
                known_start[remembered : remembered + more] = begun[opened : last + 1]
                known_end[remembered : remembered + more] = done[opened : last + 1]
                known_start[remembered : remembered + more] -= now
                known_end[remembered : remembered + more] -= now
                remembered += more
    return start, end


@inner_kernel
def _waiting(edge_first: Indices, nodes: int, ahead: int) -> Indices:
    """Return for each node the next one with dependencies on others, shape (nodes + 1,)."""
    found = np.full(nodes + 1, nodes)
    for n in range(nodes - 1, -1, -1):
        waits = ahead < nodes or edge_first[n + 1] > edge_first[n]
        found[n] = n if waits else found[n + 1]
    return found


@inner_kernel
def _next(due: Nanoseconds, node: Indices, length: Array) -> int:
    """Return the chain with the next action, -1 for none: starts from rest before decisions."""
    found, first, kind = -1, np.int64(_NEVER), 2
    for k in range(len(due)):
        if due[k] >= 0:
            decides = 1 if length[node[k]] > 0.0 else 0
            if due[k] < first or (due[k] == first and decides < kind):
                found, first, kind = k, due[k], decides
    return found


@inner_kernel
def _clear(
    edge_first: Indices,
    source: Indices,
    patience: Nanoseconds,
    begun: Nanoseconds,
    done: Nanoseconds,
    n: int,
    first: int,
    ahead: int,
) -> np.int64:
    """Return the clearance time of a node, as far as known."""
    t = np.int64(0)
    for e in range(edge_first[n], edge_first[n + 1]):
        met = done[source[e]]
        if len(patience) > 0 and patience[e] < EVER:
            met = min(met, begun[source[e]] + patience[e])
        t = max(t, met)
    if n - ahead >= first:
        t = max(t, done[n - ahead])
    return t


@inner_kernel
def _settled(length: Array, ramp: Array, n: int, last: int, end: int) -> int:
    """Return the last node whose end speed is fixed now; often many are."""
    if last == end:
        return last
    # Later clearances count only within the braking distance.
    far, stop = 0.0, last
    while stop > n and far < 0.5:
        far += length[stop] / ramp[stop]
        stop -= 1
    return stop


@inner_kernel
def _pass(
    length: float,
    top: float,
    ramp: float,
    bound: float,
    base: np.int64,
    passed: float,
    speed: float,
    pending: np.int64,
) -> tuple[np.int64, float, float, np.int64]:
    """Pass a node, as ``Passage.go`` does without stops."""
    gone = 0.0
    if pending > 0:
        took, leave, gone = brake_within_piece(length, speed, ramp)
        passed += took
        speed = leave
        if leave > 0.0:
            return base, passed, speed, pending
        base += np.int64(np.rint(passed)) + pending
        passed, pending = 0.0, np.int64(0)
    took, leave, _ = passage_seconds(length - gone, top, speed, bound, ramp)
    return base, passed + took, leave, pending
