"""History of tasks by action and object, used to find the predecessors of new tasks."""

from __future__ import annotations

from collections.abc import Iterator

from planning.tasks.task import Task


class TaskHistory:
    """Tasks so far by action and object: possible predecessors of later tasks."""

    def __init__(self) -> None:
        self._tasks: dict[tuple[str, str], list[Task]] = {}

    def add(self, did: str, name: str, task: Task) -> None:
        """Record a task on an object, in addition to earlier ones of the same action."""
        self._tasks.setdefault((did, name), []).append(task)

    def put(self, did: str, name: str, task: Task) -> None:
        """Record a task on an object, replacing earlier ones of the same action."""
        self._tasks[did, name] = [task]

    def forget(self, did: str, name: str) -> None:
        """Forget all actions on an object."""
        self._tasks.pop((did, name), None)

    def before(self, task: Task, did: str, *names: str) -> Iterator[tuple[Task, Task]]:
        """Yield the tasks that did something to one of some objects, each with one that waits."""
        for name in names:
            for earlier in self._tasks.get((did, name), ()):
                yield earlier, task
