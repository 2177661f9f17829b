"""Draws of some replications, with a part of the times made shorter."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from planning.transforms import Indices
from twin.durations import Nanoseconds
from twin.study.gains.lever import Lever
from twin.uncertainty.chain_draws import Standstills
from twin.uncertainty.node_times import SegmentTimes


def shortened(times_ns: Nanoseconds, share: float) -> Nanoseconds:
    """Return times less a share of them, in whole nanoseconds."""
    return np.asarray(np.rint((1.0 - share) * times_ns), dtype=np.int64)


@dataclass(frozen=True)
class Draws:
    """Times of every node in some replications.

    Attributes:
        numbers: of the replications, shape (r,).
        busy_ns: work and standstills of each node together, shape (nodes, r) [ns].
        standstills: the part of it for which robots stand.
    """

    numbers: Indices
    busy_ns: Nanoseconds
    standstills: tuple[Standstills, ...]

    @classmethod
    def completing(cls, numbers: Indices, times: SegmentTimes) -> Draws:
        """Keep the replications in which no task fails for good."""
        kept = times.completing()
        return cls(numbers[~times.fails], kept.busy_ns, kept.standstills)

    @cached_property
    def work_ns(self) -> Nanoseconds:
        """Times of nodes without standstills, shape (nodes, r) [ns]."""
        work = self.busy_ns.copy()
        for group in self.standstills:
            np.subtract.at(work, (group.node, group.column), group.duration_ns)
        return work

    def times(
        self, busy_ns: Nanoseconds, lever: Lever | None = None, share: float = 0.0
    ) -> SegmentTimes:
        """Return times of nodes as engines take them, with shorter standstills if these are the lever.

        Args:
            busy_ns: of each node, shape (nodes, r) [ns].
            lever: what takes less.
            share: by how much.
        """
        groups = self.standstills
        if lever is not None and lever.causes:
            groups = tuple(
                replace(
                    group,
                    duration_ns=np.where(
                        np.isin(group.node, lever.rows),
                        shortened(group.duration_ns, share),
                        group.duration_ns,
                    ),
                )
                if group.cause in lever.causes
                else group
                for group in groups
            )
        return SegmentTimes(busy_ns, np.zeros(busy_ns.shape[1], np.bool_), groups)

    def stood_ns(self, lever: Lever) -> Nanoseconds:
        """Return the standstills that a lever is, shape (nodes, r) [ns]."""
        stood = np.zeros_like(self.busy_ns)
        for group in self.standstills:
            if group.cause in lever.causes:
                own = np.isin(group.node, lever.rows)
                at = (group.node[own], group.column[own])
                np.add.at(stood, at, group.duration_ns[own])
        return stood

    @contextmanager
    def less(self, lever: Lever, share: float) -> Iterator[Nanoseconds]:
        """Give the times of nodes while a lever takes a share less, shape (nodes, r) [ns].

        Each node is made shorter by itself; standstills stay as they were drawn unless they
        are the lever, and the work stays as it was drawn where they are. The array is
        ``busy_ns`` itself, which is as before afterwards: a copy of all takes longer than to
        execute it again.
        """
        rows = lever.rows
        kept = self.busy_ns[rows]
        if lever.causes:
            for group in self.standstills:
                if group.cause in lever.causes:
                    own = np.isin(group.node, rows)
                    old = group.duration_ns[own]
                    at = (group.node[own], group.column[own])
                    np.subtract.at(self.busy_ns, at, old - shortened(old, share))
        elif len(rows):
            work = self.work_ns[rows] if self.standstills else kept
            self.busy_ns[rows] = kept - work + shortened(work, share)
        try:
            yield self.busy_ns
        finally:
            self.busy_ns[rows] = kept
