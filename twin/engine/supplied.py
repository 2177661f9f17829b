"""Execution of a graph in which something is brought that nobody knows to be late."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import Any

import numpy as np
import simpy

from twin.engine.ending import Ending
from twin.engine.processes import Execution, Steps


class SuppliedExecution(Execution):
    """State of one run in which objects come at times that nobody knows beforehand.

    Each is brought in the one node of a machine, see ``scheduling.rolling.supply``. Nobody waits for that
    node before somebody has come for the object and has not found it; from then on everybody does.

    Attributes:
        ended: why the execution ended before its plan was complete; None where no such cause is known.
    """

    ended: Ending | None = None

    def __init__(self, *rest: Any, **options: Any) -> None:
        """Set the cell up at time 0; see Execution."""
        super().__init__(*rest, **options)
        self._coming: dict[int, str] = {}
        self._missed: set[str] = set()

    def late(self, chain: int, at_ns: int) -> None:
        """Let what a machine brings be there from a time on [ns].

        Args:
            chain: of the machine.
            at_ns: the time; where the run is over before, it is never brought.
        """

        def come() -> Steps:
            yield self.env.timeout(at_ns)
            del self._coming[chain]
            self._dispatch_again()

        self._coming[chain] = str(self.tpg.tasks[self.task[chain][0]].object)
        self._lift_unknown()
        self.env.process(come())

    @property
    def never_came(self) -> frozenset[int]:
        """Chains of the machines that have brought nothing."""
        return frozenset(self._coming)

    def _lift_unknown(self) -> None:
        """Let nobody wait for what nobody knows to be late."""
        for a, u, b, v in self.tpg.edges.tolist():
            if a in self._coming and self._coming[a] not in self._missed:
                self.dispatcher.lift((a, u), (b, v))

    def _dispatch_again(self) -> None:
        if not self.report_arrived.triggered:
            self.report_arrived.succeed()

    def _done(self) -> bool:
        rows = (end for k, end in enumerate(self.end) if k not in self._coming)
        return all(not end or end[-1] >= 0 for end in rows)

    def _next_is_safe(self, chain: int) -> bool:
        return chain not in self._coming and super()._next_is_safe(chain)

    def _tell_of_wait(self, chain: int, node: int) -> None:
        if chain not in self._coming:
            super()._tell_of_wait(chain, node)

    def _fails(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        yield from self._until_stops_end(chain)
        if (name := self._missing(chain, node)) is None:
            return (yield from super()._fails(chain, node))
        self._missed.add(name)
        self.start[chain][node] = self.now_ns
        self._never_tried(chain, node)
        self.failed.append(chain)
        if self.narrator is not None:
            self.narrator.emit("started", chain, node)
            label = self.tpg.tasks[self.task[chain][node]].label
            detail = f"{label}: {name} is not there"
            self.narrator.emit("failed", chain, node, detail=detail)
        return True

    def _missing(self, chain: int, node: int) -> str | None:
        """Return what a skill that begins with a node is about, where that is not there yet."""
        task = self.task[chain]
        begins = node == 0 or task[node - 1] != task[node]
        if not self._coming or not begins or not self.tpg.chains[chain].skill[node]:
            return None
        name = self.tpg.tasks[task[node]].object
        return name if name in self._coming.values() else None

    def _never_tried(self, chain: int, node: int) -> None:
        """Take note that there is no attempt at a skill, whatever was drawn."""
        own, stood = list(self.times.standstills), list(self.times.stood)
        own[chain] = tuple(s for s in own[chain] if s.node != node)
        stood[chain] = np.where(np.arange(len(stood[chain])) == node, 0, stood[chain])
        failed = list(self.times.failed)
        failed[chain] = node
        self.times = replace(
            self.times,
            standstills=tuple(own),
            stood=tuple(stood),
            failed=tuple(failed),
        )
