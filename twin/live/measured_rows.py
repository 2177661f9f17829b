"""Measured rows of a robot in the execution record: its samples during motion, and both ends of each standstill."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planning.transforms import Array
from twin.drivers.driver import Sample
from twin.runs.execution_record import Measured


@dataclass
class MeasuredRows:
    """Measured rows of a robot: all samples during motion, and both ends of each standstill.

    Attributes:
        t_ns, q, node: see ``Measured``. At a standstill, the first row belongs to the previous node, and the last
            row to the next node.
        begin_ns, end_ns: start and completion times of its nodes.
        cleared_ns: clearance times of its nodes; by any clock, none began earlier.
        last: the last sample, and when it was taken in the run [ns]; None before the first.
    """

    t_ns: list[int] = field(default_factory=list)
    q: list[Array] = field(default_factory=list)
    node: list[int] = field(default_factory=list)
    begin_ns: list[int] = field(default_factory=list)
    end_ns: list[int] = field(default_factory=list)
    cleared_ns: list[int] = field(default_factory=list)
    last: tuple[int, Sample] | None = None
    _stood: tuple[int, Array] | None = None

    def is_new(self, state: Sample) -> bool:
        """Return whether a sample is later than all recorded ones.

        A restarted driver may have another clock, but its completed nodes never decrease.
        """
        if self.last is None:
            return True
        own = self.last[1]
        return (state.done, state.begun, state.at_s) > (own.done, own.begun, own.at_s)

    def add(self, t_ns: int, state: Sample) -> bool:
        """Record a sample; return whether it is new."""
        if not self.is_new(state):
            return False
        begun = self.cleared_ns[state.begun - 1 : state.begun]
        last_ns = 0 if self.last is None else self.last[0]
        t_ns = max([t_ns, last_ns, *begun])
        self.last = t_ns, state
        self.note(t_ns, state.begun, state.done)
        if state.begun == state.done:
            if self._stood is None:
                self._row(t_ns, state.q, state.done - 1)
            self._stood = t_ns, state.q
            return True
        if self._stood is not None:
            # What moved while it stood was no part of the node that it now begins.
            self._row(*self._stood, state.done - 1)
            self._row(*self._stood, state.done)
            self._stood = None
        self._row(t_ns, state.q, state.done)
        return True

    def note(self, t_ns: int, begun: int, done: int) -> None:
        """Record nodes begun and completed at a time [ns], in the order of the chain."""
        begin, end = self.begin_ns, self.end_ns
        begin += [max([t_ns, *begin[-1:], *end[-1:]])] * (begun - len(begin))
        end += [max([t_ns, *begin[done - 1 : done]])] * (done - len(end))

    def _row(self, t_ns: int, q: Array, node: int) -> None:
        if self.t_ns and t_ns <= self.t_ns[-1] and np.any(q != self.q[-1]):
            return  # its clock is known better by now, and this would be a jump
        same = self.node[-2:] == [node, node] and np.array_equal(q, self.q[-1])
        if same and np.array_equal(q, self.q[-2]):
            self.t_ns[-1] = t_ns  # it stands in the middle of a node
            return
        self.t_ns.append(t_ns)
        self.q.append(q)
        self.node.append(node)

    def measured(self) -> Measured:
        """Return the measured motion."""
        return Measured(np.array(self.t_ns), np.array(self.q), np.array(self.node))
