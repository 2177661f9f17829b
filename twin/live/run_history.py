"""State of a run, restored from its log so that a restarted dispatcher can continue the run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from planning.errors import TwinError
from scheduling.graph.dispatcher import Node
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.runs.events import Event, EventCode


@dataclass
class History:
    """History of a run.

    Attributes:
        cleared_ns, start_ns, end_ns: release, start and end of each node of each chain, as far
            as they were, one entry a chain [ns].
        finished: chains that have come to their end.
        holders: robot that holds each held object.
        handled: number of logged handlings of each node, by chain and node.
        held: robots stopped by a person.
        starts: how often the dispatcher was started.
        since_ns: how late it is in the run [ns].
    """

    cleared_ns: list[list[int]] = field(default_factory=list)
    start_ns: list[list[int]] = field(default_factory=list)
    end_ns: list[list[int]] = field(default_factory=list)
    finished: set[int] = field(default_factory=set)
    holders: dict[str, str] = field(default_factory=dict)
    handled: Counter[Node] = field(default_factory=Counter)
    held: set[str] = field(default_factory=set)
    starts: int = 1
    since_ns: int = 0


def history_of(tpg: TemporalPlanGraph, events: Sequence[Event]) -> History:
    """Return the history in a log.

    Args:
        tpg: the plan.
        events: the log.

    Raises:
        TwinError: the run was replanned, which cannot be reconstructed from the log.
    """
    chains = tpg.chain_index
    cleared, begun, done = (list[list[int]]() for _ in range(3))
    for own in (cleared, begun, done):
        own += [[] for _ in tpg.chains]
    found = History(cleared, begun, done)
    rows = {
        "released": found.cleared_ns,
        "started": found.start_ns,
        "completed": found.end_ns,
    }
    for event in events:
        if event.kind in ("failed", "replanned", "recovered"):
            at = f"{event.t_ns / 1e9:.3f} s"
            raise TwinError(
                f"at {at} something failed ({event.detail}): what was planned since is not in the log, so"
                " that the run cannot continue from there; clear the cell and run the rest"
            )
        found.since_ns = max(found.since_ns, event.t_ns)
        if event.code is EventCode.DISPATCHER_RESTARTED:
            found.starts += 1
        elif event.kind == "ordered":
            names = {event.robot} if event.robot else set(chains)
            hold = event.code is EventCode.HOLD
            found.held = found.held - names | (names if hold else set())
        elif event.robot in chains:
            k = chains[event.robot]
            if event.kind in rows:
                rows[event.kind][k].append(event.t_ns)
            elif event.kind == "finished":
                found.finished.add(k)
            elif event.kind in ("attached", "detached"):
                found.handled[k, event.node] += 1
                found.holders.pop(event.object, None)
                if event.kind == "attached":
                    found.holders[event.object] = event.robot
    return found
