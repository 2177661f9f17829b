"""Text descriptions of tasks, with part and step, and of waits, with the robots involved."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from planning.tasks.task import Actuation, Task, TaskKind
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.activities.activities import (
    HOLDING,
    IDLE,
    RETRYING,
    TOLD,
    WAITING,
    part_names,
)

_VERBS = {
    RETRYING: "tries again",
    HOLDING: "stays",
    Actuation.CLOSE: "tool closes",
    Actuation.OPEN: "tool opens",
}


class PlanDescriptions:
    """Describes the tasks of a plan and the waits of its nodes."""

    def __init__(self, tpg: TemporalPlanGraph) -> None:
        """Describe a plan.

        Args:
            tpg: the plan; with the barriers between slots, if robots wait for these.
        """
        self._tpg = tpg
        self._steps = max((task.step for task in tpg.tasks), default=0)
        self._part = part_names(tpg)
        self._sources: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for before, source, after, target in tpg.edges.tolist():
            self._sources.setdefault((after, target), []).append((before, source))
        self._tasks = [self._describe(task) for task in tpg.tasks]

    def task(self, task: int) -> str:
        """Return a description of a task: action, part and step.

        Empty for a task that the plan does not have.
        """
        return self._tasks[task] if 0 <= task < len(self._tasks) else ""

    def is_skill(self, task: int) -> bool:
        """Return whether a task is in the plan and not a transit."""
        return (
            0 <= task < len(self._tasks)
            and self._tpg.tasks[task].kind != TaskKind.TRANSIT
        )

    def state(self, state: str, task: int) -> str:
        """Return a description of a state of a robot's lane, other than a wait."""
        words = self.task(task)
        if not words or state == IDLE:
            return state
        return f"{_VERBS.get(state, state)}: {words}" if state in TOLD else words

    def wait(self, chain: int, node: int, complete: Callable[[int, int], bool]) -> str:
        """Return which robots and tasks a node waits for; empty for none.

        Args:
            chain: chain of the node.
            node: node that waits.
            complete: returns whether a node of a chain is complete.
        """
        left = self.awaited(chain, node, complete)
        if not left:
            return ""
        chain, last = left[-1]
        more = any(other != chain for other, _ in left)
        return self._wait(*self._owner(chain, last), more=more)

    def awaited(
        self, chain: int, node: int, complete: Callable[[int, int], bool]
    ) -> list[tuple[int, int]]:
        """Return the incomplete nodes that a node waits for; see ``wait``."""
        sources = self._sources.get((chain, node), ())
        return [source for source in sources if not complete(*source)]

    def lane(self, chain: int) -> Iterator[tuple[str, str]]:
        """Yield all possible texts of a robot's lane, each with its state."""
        yield IDLE, IDLE
        yield WAITING, WAITING
        for task in dict.fromkeys(self._tpg.chains[chain].task.tolist()):
            yield self._tasks[task], self._tpg.tasks[task].kind
            for state in sorted(TOLD):
                yield self.state(state, task), state
        waited = {
            self._owner(*source)
            for (own, _), sources in self._sources.items()
            if own == chain
            for source in sources
        }
        for robot, task in sorted(waited):
            for more in (False, True):
                yield self._wait(robot, task, more=more), WAITING

    def _owner(self, chain: int, node: int) -> tuple[int, int]:
        return chain, int(self._tpg.chains[chain].task[node])

    def _wait(self, chain: int, task: int, *, more: bool) -> str:
        others = " and others" if more else ""
        robot = self._tpg.chains[chain].robot
        return f"waits for {robot}{others}: {self._tasks[task]}"

    def _describe(self, task: Task) -> str:
        words = task.label.removesuffix(f" step {task.step}")
        part = self._part[task.index]
        if part != f"step {task.step}":
            if task.kind == TaskKind.TRANSIT and task.object and words == f"to {part}":
                words = f"{part} to its place"
            elif part not in words:
                words += f" {'after' if words == 'HOME' else 'for'} {part}"
        return f"{words} (step {task.step}/{self._steps})"
