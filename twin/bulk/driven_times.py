"""Completion times of nodes in many replications, for robots with acceleration limits.

The speed at the end of a node depends on the later nodes that are released by then, so completion times are not
longest paths. Replications are simulated one after another. Nodes without motion need no order: their times follow
from those of the nodes they wait for. Robots that move decide in the order of time how far they go, as in the event
engine.

What a robot does from rest until its next decision depends on how far it is cleared, and nothing else, where nothing
is disturbed: so do later decisions until it is at rest again. Each such passage is computed once and reused. Times are
returned of segments, nodes that are merged without a change of any time; these are few where passages have many nodes.

Compiled inner functions take single arrays and numbers instead of tuples. For an array in a tuple, numba counts
references atomically, which took three quarters of the time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.kernels import inner_kernel, kernel
from planning.timing.stretch import brake_within_piece, exit_bound, passage_seconds
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import EVER, TemporalPlanGraph
from twin.bulk.max_plus import PrecedenceArrays
from twin.durations.nanoseconds import Nanoseconds
from twin.engine.passage import DriveTimes, drive_times

_NEVER = 2**61

_REMEMBERED = 8
"""Segments of passages that are remembered, over the segments of the graph."""

_CLEARED, _OTHER, _NEXT, _PLACE, _COUNT, _WHOLE, _REST = range(7)
"""Passage: last node that was cleared, other passage from there, next node, its first segment and their number,
1 if the last of them is complete, and time at the end if it ends at rest."""

ShortIndices = npt.NDArray[np.int32]
"""Indices below 2**31."""


class DrawnTimes(NamedTuple):
    """Times of the nodes of robots in some replications; nodes of all chains are numbered through.

    Attributes:
        fixed: durations at full speed of nodes that do not vary, shape (nodes,) [ns].
        rows: nodes that vary, shape (n,).
        motion: their durations, shape (replications, n) [ns].
        stand_first: first standstill of each replication and their number, shape (replications + 1,).
        stand_node, stand_ns: node and duration of each standstill [ns].
        override: share of planned speed at which each node is executed, shape (replications, nodes), see
            ``drive_times``; of shape (0, 0) for 1.
    """

    fixed: Nanoseconds
    rows: Indices
    motion: Nanoseconds
    stand_first: Indices
    stand_node: Indices
    stand_ns: Nanoseconds
    override: Array


def joined_drives(tpg: TemporalPlanGraph) -> DriveTimes:
    """Return the drive times of a graph, nodes numbered through."""
    drives = [drive_times(c, np.zeros(len(c), dtype=np.int64)) for c in tpg.chains]
    firsts = np.cumsum([0, *map(len, tpg.chains)])
    out = DriveTimes(*map(np.concatenate, zip(*drives, strict=True)))
    for first, drive in zip(firsts.tolist(), drives, strict=False):
        out.last[first : first + len(drive.last)] += first
    return out


@kernel
def driven_times(
    graph: PrecedenceArrays,
    head: Indices,
    drive: DriveTimes,
    drawn: DrawnTimes,
    ahead: int,
) -> tuple[Nanoseconds, Nanoseconds]:
    """Return start and end of every segment, in every replication.

    Args:
        graph: precedence graph of segments, of which each is one node at rest or nodes of one stretch.
        head: first node of each segment and the number of nodes, shape (segments + 1,).
        drive: of the nodes of all chains.
        drawn: their times.
        ahead: nodes that a robot may have been given and has not completed; if they are fewer than all, segments
            must be nodes.

    Returns:
        Two arrays of shape (replications, segments) [ns].
    """
    segments, nodes, chains = len(head) - 1, len(drive.last), len(graph.first) - 1
    first, last_of, not_before = graph.first, drive.last, graph.not_before.copy()
    whole, whole_ramp, whole_lag = drive.length, drive.ramp, drive.lag
    # In short types: a replication reads all of it, which is more than fits into a cache.
    source = graph.source.astype(np.int32)
    edges, patience = graph.edge_first.astype(np.int32), graph.patience
    rows, motions, override = drawn.rows, drawn.motion, drawn.override
    stand_node, stand_ns = drawn.stand_node, drawn.stand_ns
    start = np.full((len(motions), segments), _NEVER)
    end = np.full((len(motions), segments), _NEVER)
    waiting = _waiting(edges, segments, ahead)
    # Of segments: whether they are at rest, how long they take then, and the last node of the stretch.
    still, until = whole[head[:-1]] <= 0.0, last_of[head[:-1]]
    work, segment_of = drawn.fixed[head[:-1]], np.empty(nodes, np.int32)
    for s in range(segments):
        if head[s] > 0 and last_of[head[s] - 1] == last_of[head[s]]:
            not_before[s] = 0  # the clock starts no robot within a stretch
        for n in range(head[s], head[s + 1]):
            segment_of[n] = s
    at_rest = np.full(len(rows), -1)  # their segments
    for k in range(len(rows)):
        if whole[rows[k]] <= 0.0:
            at_rest[k] = segment_of[rows[k]]
    length, top = np.empty(nodes), np.empty(nodes)
    ramp, lag = whole_ramp.copy(), whole_lag.copy()
    stand = np.zeros(nodes, np.int64)
    for n in range(nodes):
        factor = override[0, n] if len(override) else 1.0
        length[n], top[n] = _shape(whole[n], factor, drawn.fixed[n])
    usual_length, usual_top = length.copy(), top.copy()
    odd = np.zeros(nodes, np.bool_)  # otherwise than usual in this replication
    # States are rests before segments, and passages; after each there is a list of passages.
    after = np.full(segments + nodes, -1, np.int32)
    passages = np.empty((nodes, 8), np.int64)
    then = np.empty((nodes, 2))  # time that passed, and speed
    offsets = np.empty((_REMEMBERED * segments, 2), np.int64)  # of starts and ends
    found, remembered = 0, 0
    node, segment = np.empty(chains, np.int64), np.empty(chains, np.int64)
    base, due = np.empty(chains, np.int64), np.empty(chains, np.int64)
    passed, speed = np.empty(chains), np.empty(chains)
    pending, blocked = np.empty(chains, np.int64), np.empty(chains, np.int64)
    state = np.empty(chains, np.int64)
    for r in range(len(motions)):
        begun, done = start[r], end[r]
        stands = range(drawn.stand_first[r], drawn.stand_first[r + 1])
        odds = len(stands)
        for k in range(len(rows)):
            if at_rest[k] >= 0:
                work[at_rest[k]] = motions[r, k]
                continue
            n = rows[k]
            factor = 1.0
            if len(override):
                factor = override[r, n]
                ramp[n] = whole_ramp[n] / factor
                lag[n] = np.int64(np.ceil(whole_lag[n] / factor))
            length[n], top[n] = _shape(whole[n], factor, motions[r, k])
            same = length[n] == usual_length[n] and top[n] == usual_top[n]
            if not same or (len(override) and factor != override[0, n]):
                odd[n] = True
                odds += 1
        for k in stands:
            n = stand_node[k]
            stand[n] += stand_ns[k]
            work[segment_of[n]] += stand_ns[k]
            odd[n] = True
        for k in range(chains):
            node[k], segment[k] = head[first[k]], first[k]
            base[k], due[k], pending[k], blocked[k] = 0, -1, 0, -1
            passed[k], speed[k] = 0.0, 0.0
        while True:
            moved = True
            while moved:
                moved = False
                for k in range(chains):
                    if due[k] >= 0 or (blocked[k] >= 0 and done[blocked[k]] >= _NEVER):
                        continue
                    s, low = segment[k], first[k]
                    while s < first[k + 1]:
                        ready = base[k] + np.int64(np.rint(passed[k]))
                        if speed[k] <= 0.0:
                            clear, blocked[k] = _clear(
                                edges, source, patience, begun, done, s, low, ahead
                            )
                            if clear >= _NEVER:
                                break
                            ready = max(ready, clear, not_before[s])
                        if not still[s]:
                            due[k] = ready
                            break
                        begun[s] = ready
                        done[s] = ready + work[s]
                        base[k], passed[k] = done[s], 0.0
                        s += 1
                        node[k], segment[k], moved = head[s], s, True
            k = _next(due)
            if k < 0:
                break
            n, s, now, low = node[k], segment[k], due[k], first[k]
            due[k] = -1
            if speed[k] <= 0.0:
                base[k], passed[k] = now, 0.0
                state[k] = s if pending[k] == 0 and n == head[s] else -1
            # The first segment that it may not enter as far as it knows.
            bar = waiting[s + 1]
            while head[bar] <= until[s]:
                clear, _ = _clear(edges, source, patience, begun, done, bar, low, ahead)
                if clear > now:
                    break
                bar = waiting[bar + 1]
            last = min(head[bar] - 1, until[s])
            usual = state[k] >= 0
            if usual and odds > 0:
                for m in range(n, last + 1):
                    usual = usual and not odd[m]
            p = after[state[k]] if usual else -1
            while p >= 0 and passages[p, _CLEARED] != last:
                p = passages[p, _OTHER]
            if p >= 0:
                for m in range(passages[p, _COUNT]):
                    begun[s + m] = base[k] + offsets[passages[p, _PLACE] + m, 0]
                segment[k] = s + passages[p, _COUNT] - 1 + passages[p, _WHOLE]
                for m in range(segment[k] - s):
                    done[s + m] = base[k] + offsets[passages[p, _PLACE] + m, 1]
                base[k] += passages[p, _REST]
                passed[k], speed[k] = then[p, 0], then[p, 1]
                node[k], state[k] = passages[p, _NEXT], segments + p
                continue
            opened, stop = n, _settled(length, ramp, n, last, until[s])
            for n in range(opened, stop + 1):
                if n == head[s]:
                    begun[s] = base[k] + np.int64(np.rint(passed[k]))
                    if n > 0 and last_of[n - 1] == last_of[n]:
                        begun[s] += lag[n]
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
                if n + 1 == head[s + 1]:
                    done[s] = base[k] + np.int64(np.rint(passed[k])) + lag[n]
                    s += 1
            before, low, node[k], segment[k] = base[k], segment[k], stop + 1, s
            if stop == last_of[stop]:
                speed[k] = 0.0
                base[k] += np.int64(np.rint(passed[k])) + lag[stop]
                passed[k] = 0.0
            ends = 1 if head[s] == stop + 1 else 0
            count = s + 1 - ends - low
            if not usual or found == nodes or remembered + count > len(offsets):
                state[k] = -1
                continue
            passages[found, _CLEARED], passages[found, _NEXT] = last, stop + 1
            passages[found, _PLACE], passages[found, _COUNT] = remembered, count
            passages[found, _WHOLE], passages[found, _REST] = ends, base[k] - before
            passages[found, _OTHER], after[state[k]] = after[state[k]], found
            then[found, 0], then[found, 1] = passed[k], speed[k]
            state[k], found = segments + found, found + 1
            for s in range(low, low + count):
                offsets[remembered, 0] = begun[s] - before
                offsets[remembered, 1] = done[s] - before
                remembered += 1
        for k in stands:
            n = stand_node[k]
            stand[n], odd[n] = 0, False
            work[segment_of[n]] -= stand_ns[k]
        for k in range(len(rows)):
            if at_rest[k] < 0:
                odd[rows[k]] = False
    return start, end


@inner_kernel
def _shape(length: float, factor: float, motion: np.int64) -> tuple[float, float]:
    """Return time at full speed and greatest speed of a node whose duration at full speed was drawn."""
    length /= factor
    # A shorter time than at full speed means a shorter path.
    if motion < length - 1.0:
        length = max(1.0, float(motion))
    return length, (length / motion if motion > length + 1.0 else 1.0)


@inner_kernel
def _waiting(edges: ShortIndices, segments: int, ahead: int) -> Indices:
    """Return for each segment the next one with dependencies on others, shape (segments + 1,)."""
    found = np.full(segments + 1, segments)
    for s in range(segments - 1, -1, -1):
        waits = ahead < segments or edges[s + 1] > edges[s]
        found[s] = s if waits else found[s + 1]
    return found


@inner_kernel
def _next(due: Nanoseconds) -> int:
    """Return the chain with the next decision, -1 for none."""
    found = -1
    for k in range(len(due)):
        if due[k] >= 0 and (found < 0 or due[k] < due[found]):
            found = k
    return found


@inner_kernel
def _clear(
    edges: ShortIndices,
    source: ShortIndices,
    patience: Nanoseconds,
    begun: Nanoseconds,
    done: Nanoseconds,
    s: int,
    first: int,
    ahead: int,
) -> tuple[np.int64, np.int64]:
    """Return the clearance time of a segment as far as known, and a source that is not complete, -1 for none."""
    t, by = np.int64(0), np.int64(-1)
    for e in range(edges[s], edges[s + 1]):
        met = done[source[e]]
        if len(patience) > 0 and patience[e] < EVER:
            met = min(met, begun[source[e]] + patience[e])
        if met >= _NEVER:
            by = source[e]
        t = max(t, met)
    if s - ahead >= first:
        t = max(t, done[s - ahead])
    return t, by


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
