"""What a run has come to by its log: from there a dispatcher that was started anew goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from planning.errors import TwinError
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.run.events import Event

ANEW = "the dispatcher was started anew"
"""Detail of the event by which a log tells of that."""


@dataclass
class History:
    """What has happened in a run.

    Attributes:
        cleared_ns, start_ns, end_ns: when each node of each chain was released, begun and complete, as far
            as they were, one entry a chain [ns].
        finished: chains that have come to their end.
        holders: who holds each object that is held.
        held: robots that a person lets stand.
        starts: how often the dispatcher was started.
        since_ns: how late it is in the run [ns].
    """

    cleared_ns: list[list[int]] = field(default_factory=list)
    start_ns: list[list[int]] = field(default_factory=list)
    end_ns: list[list[int]] = field(default_factory=list)
    finished: set[int] = field(default_factory=set)
    holders: dict[str, str] = field(default_factory=dict)
    held: set[str] = field(default_factory=set)
    starts: int = 1
    since_ns: int = 0


def history_of(tpg: TemporalPlanGraph, events: Sequence[Event]) -> History:
    """Return what has happened by a log.

    Args:
        tpg: the plan.
        events: the log.

    Raises:
        TwinError: something was planned anew, which cannot be made again from what happened.
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
                " that nobody can go on from there; see to the cell and run the rest"
            )
        found.since_ns = max(found.since_ns, event.t_ns)
        if event.detail == ANEW:
            found.starts += 1
        elif event.kind == "ordered":
            names = {event.robot} if event.robot else set(chains)
            found.held = found.held - names | (
                names if event.detail == "hold" else set()
            )
        elif event.robot in chains:
            k = chains[event.robot]
            if event.kind in rows:
                rows[event.kind][k].append(event.t_ns)
            elif event.kind == "finished":
                found.finished.add(k)
            elif event.kind == "attached":
                found.holders[event.object] = event.robot
            elif event.kind == "detached":
                found.holders.pop(event.object, None)
    return found
