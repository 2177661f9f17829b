"""Where a robot was, made of the samples that its driver reports."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planning.transforms import Array
from twin.drivers.driver import Sample
from twin.run.events import Measured


@dataclass
class MeasuredRows:
    """What has been measured of a robot: rows while it moves, and both ends of each time for which it stands.

    Attributes:
        t_ns, q, node: see ``Measured``; where it stands, the first row is of the node before, the last one of
            that which it then begins.
        begin_ns, end_ns: when it began each of its nodes, and was through with it.
        cleared_ns: when it was cleared for them; whatever its clock says, it began none before.
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
        """Tell whether a sample comes after all those that have been taken note of.

        A driver that was started anew may have another clock, but it does not undo nodes.
        """
        if self.last is None:
            return True
        own = self.last[1]
        return (state.done, state.begun, state.at_s) > (own.done, own.begun, own.at_s)

    def add(self, t_ns: int, state: Sample) -> bool:
        """Take note of a sample, and return whether that had not been done before."""
        if not self.is_new(state):
            return False
        begun = self.cleared_ns[state.begun - 1 : state.begun]
        t_ns = max([0, t_ns, *self.t_ns[-1:], *begun])
        self.last = t_ns, state
        self.begin_ns += [t_ns] * (state.begun - len(self.begin_ns))
        self.end_ns += [t_ns] * (state.done - len(self.end_ns))
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

    def _row(self, t_ns: int, q: Array, node: int) -> None:
        if self.t_ns and t_ns <= self.t_ns[-1] and np.any(q != self.q[-1]):
            return  # its clock is known better by now, and this would be a jump
        self.t_ns.append(t_ns)
        self.q.append(q)
        self.node.append(node)

    def measured(self) -> Measured:
        """Return all of it."""
        return Measured(np.array(self.t_ns), np.array(self.q), np.array(self.node))
