"""Times of nodes in many replications, where robots keep to limits of acceleration.

How fast a robot passes a border depends on how far it is cleared at that moment, so completion times
are no longest paths. Replications are executed one after the other, each as a queue of what the
robots do next, in the order of time: what starts from rest before what is decided on at a border, as
in the event engine. A robot that is cleared to the end of its stretch has nothing to decide any more.
"""

from __future__ import annotations

import numpy as np

from planning.kernels import inner_kernel, kernel
from planning.timing.stretch import braked, exit_bound, pass_through
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import EVER, TemporalPlanGraph
from twin.durations.model import Nanoseconds
from twin.engine.bulk.max_plus import PrecedenceArrays
from twin.engine.passage import DriveTimes, drive_times

_NEVER = 2**61


def joined_drives(tpg: TemporalPlanGraph, graph: PrecedenceArrays) -> DriveTimes:
    """Return the drives of a graph whose edges a policy may have added to, nodes numbered through."""
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
    ahead: int,
) -> tuple[Nanoseconds, Nanoseconds]:
    """Return start and end of every node, in every replication.

    Args:
        graph: what must wait for what, not contracted.
        drive: of its chains.
        motion_ns: durations that were drawn, at full speed, shape (replications, nodes) [ns].
        stand_ns: standstills of each node, of the same shape [ns].
        ahead: nodes that a robot may have been given and has not completed.

    Returns:
        Two arrays of the same shape [ns].
    """
    start, end = np.empty_like(motion_ns), np.empty_like(motion_ns)
    top, length = drive.top.copy(), drive.length.copy()
    own = DriveTimes(length, top, drive.ramp, drive.lag, drive.last)
    chains = len(graph.first) - 1
    node = np.empty(chains, np.int64)
    base, due = np.empty(chains, np.int64), np.empty(chains, np.int64)
    passed, speed = np.empty(chains), np.empty(chains)
    pending = np.empty(chains, np.int64)
    for r in range(len(motion_ns)):
        start[r] = end[r] = _NEVER
        for n in range(len(top)):
            # What takes less than at full speed is a shorter way.
            length[n] = drive.length[n]
            if motion_ns[r, n] < length[n] - 1.0:
                length[n] = max(1.0, float(motion_ns[r, n]))
            slower = motion_ns[r, n] > length[n] + 1.0
            top[n] = length[n] / motion_ns[r, n] if slower else 1.0
        for k in range(chains):
            node[k] = graph.first[k]
            base[k], due[k], pending[k] = 0, -1, 0
            passed[k], speed[k] = 0.0, 0.0
        while True:
            times = start[r], end[r]
            k = _next(graph, drive, times, node, base, passed, speed, due, ahead)
            if k < 0:
                break
            n, now = node[k], due[k]
            if drive.length[n] <= 0.0:
                start[r, n] = now
                end[r, n] = now + motion_ns[r, n] + stand_ns[r, n]
                base[k], passed[k] = end[r, n], 0.0
                node[k] = n + 1
            else:
                if speed[k] <= 0.0:
                    base[k], passed[k] = now, 0.0
                last = _cleared(graph, drive, times, n, now, ahead)
                stop = _settled(own, n, last)
                while node[k] <= stop:
                    n = node[k]
                    opens = n == graph.first[k] or drive.last[n - 1] != drive.last[n]
                    late = 0 if opens else drive.lag[n]
                    start[r, n] = base[k] + np.int64(np.rint(passed[k])) + late
                    _pass(
                        own,
                        stand_ns[r],
                        k,
                        n,
                        last,
                        base,
                        passed,
                        speed,
                        pending,
                    )
                    end[r, n] = base[k] + np.int64(np.rint(passed[k])) + drive.lag[n]
                    node[k] = n + 1
                    if n == drive.last[n]:
                        speed[k] = 0.0
                        base[k], passed[k] = end[r, n], 0.0
            due[k] = -1
    return start, end


@inner_kernel
def _next(
    graph: PrecedenceArrays,
    drive: DriveTimes,
    times: tuple[Nanoseconds, Nanoseconds],
    node: Indices,
    base: Nanoseconds,
    passed: Array,
    speed: Array,
    due: Nanoseconds,
    ahead: int,
) -> int:
    """Return the chain that does something next, -1 for none; ``due`` is when each does."""
    found, first, kind = -1, np.int64(_NEVER), 2
    for k in range(len(node)):
        n = node[k]
        if n >= graph.first[k + 1]:
            continue
        if due[k] < 0:
            ready = base[k] + np.int64(np.rint(passed[k]))
            if speed[k] <= 0.0:
                ready = max(ready, _clear(graph, times, n, graph.first[k], ahead))
                opens = n == graph.first[k] or drive.last[n - 1] != drive.last[n]
                if opens:
                    ready = max(ready, graph.not_before[n])
            if ready >= _NEVER:
                continue
            due[k] = ready
        decides = 1 if drive.length[n] > 0.0 else 0
        if due[k] < first or (due[k] == first and decides < kind):
            found, first, kind = k, due[k], decides
    return found


@inner_kernel
def _clear(
    graph: PrecedenceArrays,
    times: tuple[Nanoseconds, Nanoseconds],
    n: int,
    first: int,
    ahead: int,
) -> np.int64:
    """Return when a node is cleared, as far as it is known."""
    start, end = times
    t = np.int64(0)
    for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
        met = end[graph.source[e]]
        if len(graph.patience) > 0 and graph.patience[e] < EVER:
            met = min(met, start[graph.source[e]] + graph.patience[e])
        t = max(t, met)
    if n - ahead >= first:
        t = max(t, end[n - ahead])
    return t


@inner_kernel
def _cleared(
    graph: PrecedenceArrays,
    drive: DriveTimes,
    times: tuple[Nanoseconds, Nanoseconds],
    n: int,
    now: int,
    ahead: int,
) -> int:
    """Return the last node of a stretch that a robot may enter as far as it knows."""
    last, first = n, graph.first[graph.chain[n]]
    while last < drive.last[n] and _clear(graph, times, last + 1, first, ahead) <= now:
        last += 1
    return last


@inner_kernel
def _settled(drive: DriveTimes, n: int, last: int) -> int:
    """Return the last node of which the speed at its end is settled now: often many are."""
    if last == drive.last[n]:
        return last
    # What becomes clear later counts only within the way of braking.
    far, stop = 0.0, last
    while stop > n and far < 0.5:
        far += drive.length[stop] / drive.ramp[stop]
        stop -= 1
    return stop


@inner_kernel
def _pass(
    drive: DriveTimes,
    stand: Nanoseconds,
    k: int,
    n: int,
    last: int,
    base: Nanoseconds,
    passed: Array,
    speed: Array,
    pending: Nanoseconds,
) -> None:
    """Take a node, as ``Passage.go`` does without stops by the clock."""
    length, ramp = drive.length[n], drive.ramp[n]
    bound = exit_bound(drive.length, drive.top, n, last, drive.ramp)
    pending[k] += stand[n]
    gone = 0.0
    if pending[k] > 0:
        took, leave, gone = braked(length, speed[k], ramp)
        passed[k] += took
        speed[k] = leave
        if leave > 0.0:
            return
        base[k] += np.int64(np.rint(passed[k])) + pending[k]
        passed[k], pending[k] = 0.0, 0
    took, leave, _ = pass_through(length - gone, drive.top[n], speed[k], bound, ramp)
    passed[k] += took
    speed[k] = leave
