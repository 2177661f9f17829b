"""Late objects, delivered by machines at times that are not known in advance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.engine.execution import Execution
from twin.engine.ports import Steps, SupplyPort


class LateSupply(SupplyPort):
    """Late objects; each is delivered by a machine with a single node, see ``scheduling.rolling.supply``.

    Robots wait for this node only after one of them has found the object missing.

    Args:
        execution: the run.
    """

    def __init__(self, execution: Execution) -> None:
        self._execution = execution
        self.arriving: dict[int, str] = {}
        self._late: dict[int, str] = {}
        self.missed: set[str] = set()
        execution.gates.append(lambda chain: chain not in self.arriving)

    def schedule(self, chain: int, at_ns: int) -> None:
        """Schedule the delivery of a machine.

        Args:
            chain: of the machine.
            at_ns: the time [ns]; where the run is over before, it is never brought.
        """
        execution = self._execution

        def arrive() -> Steps:
            yield execution.env.timeout(at_ns)
            del self.arriving[chain]
            execution.redispatch()

        self.arriving[chain] = str(execution.tpg.tasks[execution.task[chain][0]].object)
        self._late[chain] = self.arriving[chain]
        self.lift_unknown()
        execution.env.process(arrive())

    def lift_unknown(self) -> None:
        """Remove edges from machines whose object no robot has missed yet."""
        for a, u, b, v in self._execution.tpg.edges.tolist():
            if a in self.arriving and self.arriving[a] not in self.missed:
                self._execution.dispatcher.lift((a, u), (b, v))

    def missing(self, chain: int, node: int) -> str | None:
        """Return the object of a skill that begins with a node, if it has not arrived."""
        execution, task = self._execution, self._execution.task[chain]
        begins = node == 0 or task[node - 1] != task[node]
        skill = begins and execution.tpg.chains[chain].skill[node]
        if not self._late or not skill or chain in self._late:
            return None
        name = execution.tpg.tasks[task[node]].object
        # What has been sent for is not there before its message has arrived.
        out = (own for k, own in self._late.items() if execution.start[k][0] < 0)
        return name if name in out else None

    def miss(self, chain: int, node: int) -> bool:
        """Let a skill fail for good if its object is missing; return whether it is."""
        if (name := self.missing(chain, node)) is None:
            return False
        execution = self._execution
        self.missed.add(name)
        execution.start[chain][node] = execution.now_ns
        self._skip(chain, node)
        if execution.narrator is not None:
            execution.narrator.emit("started", chain, node)
            label = execution.tpg.tasks[execution.task[chain][node]].label
            detail = f"{label}: {name} is not there"
            execution.narrator.emit("failed", chain, node, detail=detail)
        return True

    def _skip(self, chain: int, node: int) -> None:
        """Mark a skill as not attempted, whatever was drawn."""
        times = self._execution.times
        own, stood = list(times.standstills), list(times.stood)
        own[chain] = tuple(s for s in own[chain] if s.node != node)
        stood[chain] = np.where(np.arange(len(stood[chain])) == node, 0, stood[chain])
        failed = list(times.failed)
        failed[chain] = node
        self._execution.times = replace(
            times, standstills=tuple(own), stood=tuple(stood), failed=tuple(failed)
        )
        self._execution.robots.skip(chain, node)
