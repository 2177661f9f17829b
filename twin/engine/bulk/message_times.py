"""Completion times with latencies and short queues, as longest paths.

A dispatcher that lets a robot have d nodes ahead releases node n once node n - d is reported
complete and so is everything that n waits for, in order. Releases and reports take time on their
way. All of that is a maximum of sums, so it needs no events::

    released(n) = max(released(n - 1), end(n - d) + report, end(source) + report, ...)
    start(n)    = max(end(n - 1), released(n) + release)

What has happened already may be given, then the rest follows from it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.kernels import kernel
from twin.durations import Nanoseconds
from twin.engine.bulk.policy_graph import PrecedenceArrays
from twin.engine.execution_model import Messages


class Past(NamedTuple):
    """State of a run in progress, by node; nodes are numbered through, chain by chain.

    Attributes:
        now_ns: the time; what has not started starts no earlier [ns].
        start_ns: -1 for a node that has not started, shape (nodes,) [ns].
        end_ns: -1 for a node that is not complete, shape (nodes,) [ns].
        not_before_ns: when each robot can go on, shape (chains, replications) [ns].
    """

    now_ns: int
    start_ns: Nanoseconds
    end_ns: Nanoseconds
    not_before_ns: Nanoseconds


def end_times(
    graph: PrecedenceArrays, busy_ns: Nanoseconds, messages: Messages, past: Past
) -> Nanoseconds:
    """Return when every node is complete, for several replications.

    Args:
        graph: what must wait for what, not contracted.
        busy_ns: stall and duration of each node together, for a node under way what is left
            of it from now on, shape (nodes, replications) [ns].
        messages: between robots and dispatcher.
        past: what has happened already.

    Returns:
        Shape (nodes, replications) [ns].
    """
    ahead = messages.ahead(driven=False)
    return _end_times(graph, busy_ns, messages._replace(queue_depth=ahead), past)


@kernel
def _end_times(
    graph: PrecedenceArrays, busy_ns: Nanoseconds, messages: Messages, past: Past
) -> Nanoseconds:
    end, released = np.empty_like(busy_ns), np.empty_like(busy_ns)
    now = np.int64(past.now_ns)
    for n in graph.order:
        chain = graph.chain[n]
        own = n - 1 if n > graph.first[chain] else -1
        ahead = n - messages.queue_depth
        known_start, known_end = past.start_ns[n], past.end_ns[n]
        for r in range(busy_ns.shape[1]):
            if known_start >= 0:
                released[n, r] = known_start - messages.release_ns
                if known_end >= 0:
                    end[n, r] = known_end
                else:
                    end[n, r] = max(now, past.not_before_ns[chain, r])
                    end[n, r] += busy_ns[n, r]
                continue
            t = np.int64(0)
            if own >= 0:
                t = released[own, r]
            if ahead >= graph.first[chain]:
                t = max(t, end[ahead, r] + messages.report_ns)
            for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
                t = max(t, end[graph.source[e], r] + messages.report_ns)
            released[n, r] = t
            t += messages.release_ns
            if own >= 0:
                t = max(t, end[own, r])
            t = max(t, now)
            t = max(t, graph.not_before[n])
            t = max(t, past.not_before_ns[chain, r])
            end[n, r] = t + busy_ns[n, r]
    return end
