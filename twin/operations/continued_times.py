"""Durations and standstills of the nodes of a revised plan, which replaces the plan of a run in progress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planning.transforms import Array
from twin.durations.nanoseconds import Nanoseconds
from twin.operations.commitment import PlanRevision
from twin.uncertainty.node_times import NodeTimes, Standstill
from twin.uncertainty.stop_times import Stops


def continued_times(
    old: NodeTimes, revision: PlanRevision, end_ns: Sequence[Sequence[int]]
) -> NodeTimes:
    """Return the times of all nodes of a revision; those of committed nodes are unchanged.

    Args:
        old: node times of the graph that it replaces.
        revision: the revision, with committed nodes and times of the others.
        end_ns: ends of the nodes of each chain of the old graph, -1 if not complete [ns].
    """
    new = revision.times
    place = {name: k for k, name in enumerate(revision.new)}
    motion, stood, stands, failed = [], [], [], []
    overrides: list[Array] = []
    lost = set[int]()
    for k, (chain, count) in enumerate(
        zip(revision.tpg.chains, revision.counts, strict=True)
    ):
        motions: list[Nanoseconds] = []
        scaled: list[Array] = []
        stalls: list[Nanoseconds] = []
        entries: list[Standstill] = []
        fails, loses = -1, False
        if k < len(old.motion):
            motions.append(old.motion[k][:count])
            scaled.append(old.override(k)[:count])
            stalls.append(old.stood[k][:count])
            entries += [s for s in old.standstills[k] if s.node < count]
        if (own := place.get(chain.robot)) is not None:
            motions.append(new.motion[own])
            scaled.append(new.override(own))
            stalls.append(new.stood[own])
            later = new.standstills[own]
            entries += [replace(s, node=s.node + count) for s in later]
            fails = new.failed[own] + count if new.failed[own] >= 0 else -1
            loses = own in new.lost
        node = old.failed[k] if k < len(old.failed) else -1
        if 0 <= node < count and end_ns[k][node] < 0:
            # A committed node that will fail comes before any new node.
            fails, loses = node, k in old.lost
        motion.append(np.concatenate(motions))
        overrides.append(np.concatenate(scaled))
        stood.append(np.concatenate(stalls))
        stands.append(tuple(entries))
        failed.append(fails)
        lost |= {k} if loses else set()
    for k, node in enumerate(old.failed):
        if 0 <= node < revision.counts[k] and end_ns[k][node] >= 0:
            # All attempts at its skill failed, so it has no motion.
            motion[k][node] = 0
    return replace(
        old,
        motion=tuple(motion),
        stood=tuple(stood),
        standstills=tuple(stands),
        failed=tuple(failed),
        lost=frozenset(lost),
        stops=_stops(old, revision),
        speed_override=tuple(overrides) if old.speed_override else (),
    )


def _stops(old: NodeTimes, revision: PlanRevision) -> tuple[Stops, ...] | None:
    """Return the stops of all chains; new chains get newly drawn ones."""
    known, drawn = old.stops, revision.times.stops
    if known is None and drawn is None:
        return None
    own = dict(zip(revision.new, drawn or (), strict=False))
    chains = enumerate(revision.tpg.chains)
    return tuple(
        known[k]
        if known is not None and k < len(known)
        else own.get(chain.robot) or Stops([])
        for k, chain in chains
    )
