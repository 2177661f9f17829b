"""Names of tasks and waits for people: each task with its part and step, each wait with its robots."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from planning.tasks.task import CLOSE, OPEN, TRANSIT, Task
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.runs.activities import HOLDING, IDLE, RETRYING, TOLD, WAITING, part_names

_VERBS = {
    RETRYING: "tries again",
    HOLDING: "stays",
    CLOSE: "tool closes",
    OPEN: "tool opens",
}


class PlanWords:
    """Says what the tasks of a plan are, and which tasks of others a node waits for."""

    def __init__(self, tpg: TemporalPlanGraph) -> None:
        """Speak of a plan.

        Args:
            tpg: the plan; with the barriers of its slots where these are waited for.
        """
        self._tpg = tpg
        self._steps = max((task.step for task in tpg.tasks), default=0)
        self._part = part_names(tpg)
        self._sources: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for before, source, after, target in tpg.edges.tolist():
            self._sources.setdefault((after, target), []).append((before, source))
        self._tasks = [self._describe(task) for task in tpg.tasks]

    def task(self, task: int) -> str:
        """Return what a task is about: what is done, with which part, in which step.

        There is nothing to be said of a task that the plan does not have.
        """
        return self._tasks[task] if 0 <= task < len(self._tasks) else ""

    def is_skill(self, task: int) -> bool:
        """Tell whether the plan has a task and it is more than a transit."""
        return 0 <= task < len(self._tasks) and self._tpg.tasks[task].kind != TRANSIT

    def state(self, state: str, task: int) -> str:
        """Return what a robot does in a state of its lane, a wait apart."""
        words = self.task(task)
        if not words or state == IDLE:
            return state
        return f"{_VERBS.get(state, state)}: {words}" if state in TOLD else words

    def wait(self, chain: int, node: int, complete: Callable[[int, int], bool]) -> str:
        """Return whom a node waits for, and for what of theirs; empty when it is nobody.

        Args:
            chain: whose node.
            node: that waits.
            complete: tells whether a node of a chain is complete.
        """
        left = [
            source
            for source in self._sources.get((chain, node), ())
            if not complete(*source)
        ]
        if not left:
            return ""
        chain, last = left[-1]
        more = any(other != chain for other, _ in left)
        return self._wait(*self._owner(chain, last), more=more)

    def lane(self, chain: int) -> Iterator[tuple[str, str]]:
        """Yield everything that the lane of a robot may say, each with its state."""
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
            if task.kind == TRANSIT and task.object and words == f"to {part}":
                words = f"{part} to its place"
            elif part not in words:
                words += f" {'after' if words == 'HOME' else 'for'} {part}"
        return f"{words} (step {task.step}/{self._steps})"
