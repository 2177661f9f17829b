"""Objects delivered by machines at times unknown in advance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.engine.execution import Execution
from twin.engine.ports import Steps, SupplyPort


class LateSupply(SupplyPort):
    """Objects that arrive late, each brought in the one node of a machine, see ``scheduling.rolling.supply``.

    Robots wait for that node only after one has missed the object.

    Args:
        execution: the run.
    """

    def __init__(self, execution: Execution) -> None:
        self._cell = execution
        self.arriving: dict[int, str] = {}
        self.missed: set[str] = set()
        execution.gates.append(lambda chain: chain not in self.arriving)

    def schedule(self, chain: int, at_ns: int) -> None:
        """Schedule the delivery of a machine.

        Args:
            chain: of the machine.
            at_ns: the time [ns]; where the run is over before, it is never brought.
        """
        cell = self._cell

        def arrive() -> Steps:
            yield cell.env.timeout(at_ns)
            del self.arriving[chain]
            cell.redispatch()

        self.arriving[chain] = str(cell.tpg.tasks[cell.task[chain][0]].object)
        self.lift_unknown()
        cell.env.process(arrive())

    def lift_unknown(self) -> None:
        """Remove edges from machines whose object no robot has missed yet."""
        for a, u, b, v in self._cell.tpg.edges.tolist():
            if a in self.arriving and self.arriving[a] not in self.missed:
                self._cell.dispatcher.lift((a, u), (b, v))

    def missing(self, chain: int, node: int) -> str | None:
        """Return the object of a skill that begins with a node, if it has not arrived."""
        cell, task = self._cell, self._cell.task[chain]
        begins = node == 0 or task[node - 1] != task[node]
        if not self.arriving or not begins or not cell.tpg.chains[chain].skill[node]:
            return None
        name = cell.tpg.tasks[task[node]].object
        return name if name in self.arriving.values() else None

    def miss(self, chain: int, node: int) -> bool:
        """Let a skill fail for good if its object is missing; return whether it is."""
        if (name := self.missing(chain, node)) is None:
            return False
        cell = self._cell
        self.missed.add(name)
        cell.start[chain][node] = cell.now_ns
        self._skip(chain, node)
        if cell.narrator is not None:
            cell.narrator.emit("started", chain, node)
            label = cell.tpg.tasks[cell.task[chain][node]].label
            detail = f"{label}: {name} is not there"
            cell.narrator.emit("failed", chain, node, detail=detail)
        return True

    def _skip(self, chain: int, node: int) -> None:
        """Mark a skill as not attempted, whatever was drawn."""
        times = self._cell.times
        own, stood = list(times.standstills), list(times.stood)
        own[chain] = tuple(s for s in own[chain] if s.node != node)
        stood[chain] = np.where(np.arange(len(stood[chain])) == node, 0, stood[chain])
        failed = list(times.failed)
        failed[chain] = node
        self._cell.times = replace(
            times, standstills=tuple(own), stood=tuple(stood), failed=tuple(failed)
        )
        self._cell.robots.skip(chain, node)
