"""Long motion plans from short ones, by assembly and reversed assembly in alternation.

Run backwards, a plan without collisions has none, and every object is back where it started. So
a plan of n steps gives plans of 2n, 3n, ... steps with the orders a real one has.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import Handling, Task
from planning.transforms import Transform


def repeat_plan(plan: MotionPlan, times: int) -> MotionPlan:
    """Return a plan that goes forwards, backwards, forwards ... ``times`` times in all.

    Args:
        plan: tasks with indices 0, 1, ...; no object comes up later.
        times: at least 1.
    """
    count = len(plan.tasks)
    end = max(float(motion.time[-1]) for motion in plan.motions)
    backwards = _backwards(plan, end)
    tasks: list[Task] = []
    motions: list[TaskMotion] = []
    dependencies = []
    for k in range(times):
        part = backwards if k % 2 else plan
        for task, motion in zip(part.tasks, part.motions, strict=True):
            tasks.append(replace(task, index=task.index + k * count))
            motions.append(TaskMotion(motion.path, motion.time + k * end))
        dependencies.append(part.dependencies + k * count)
    images = [
        [k * count + (count - 1 - t if k % 2 else t) for k in range(times)]
        for t in range(count)
    ]
    return replace(
        plan,
        tasks=tuple(tasks),
        motions=tuple(motions),
        dependencies=np.concatenate(dependencies),
        allowed=tuple(
            replace(a, tasks=frozenset(i for t in a.tasks for i in images[t]))
            for a in plan.allowed
        ),
    )


def _backwards(plan: MotionPlan, end: float) -> MotionPlan:
    """Return the plan run backwards, from time 0 on; task t becomes count - 1 - t."""
    last = len(plan.tasks) - 1
    before = _states_before(plan)
    tasks, motions = [], []
    for t in range(last, -1, -1):
        task, motion = plan.tasks[t], plan.motions[t]
        waypoints = len(motion.path)
        handlings = tuple(
            Handling(h.object, waypoints - 1 - h.waypoint, *before[t, k])
            for k, h in reversed(list(enumerate(task.handlings)))
        )
        tasks.append(replace(task, index=last - t, handlings=handlings))
        motions.append(
            TaskMotion(
                np.ascontiguousarray(motion.path[::-1]),
                np.ascontiguousarray(end - motion.time[::-1]),
            )
        )
    dependencies = last - np.asarray(plan.dependencies, dtype=np.int64)[:, ::-1]
    return replace(
        plan, tasks=tuple(tasks), motions=tuple(motions), dependencies=dependencies
    )


def _states_before(
    plan: MotionPlan,
) -> dict[tuple[int, int], tuple[str | None, Transform]]:
    """Return holder and pose of what each handling handles, before it happens."""
    events = sorted(
        (float(plan.motions[t].time[h.waypoint]), t, k)
        for t, task in enumerate(plan.tasks)
        for k, h in enumerate(task.handlings)
    )
    state: dict[str, tuple[str | None, Transform]] = {
        item.name: (None, item.start) for item in plan.cell.objects
    }
    out = {}
    for _, t, k in events:
        h = plan.tasks[t].handlings[k]
        out[t, k] = state[h.object]
        state[h.object] = (h.holder, h.pose)
    return out
