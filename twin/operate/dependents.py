"""Which steps rest on which: what is given up with a step that nobody can do any more."""

from __future__ import annotations

from collections.abc import Mapping

from planning.tasks.task import TRANSIT
from twin.planning.kind import PlannedMotions


def resting_steps(motions: PlannedMotions) -> Mapping[int, frozenset[int]]:
    """Return the later steps in which something touches the object of a step where that is put, by number."""
    plan = motions.motion_plan
    placed = {
        task.object: task.step
        for task in plan.tasks
        if task.kind in ("place-down", "place-up") and task.object is not None
    }
    step_of = {task.index: task.step for task in plan.tasks}
    works = {t.index for t in plan.tasks if t.kind not in (TRANSIT, "pick", "handover")}
    found: dict[int, set[int]] = {}
    for contact in plan.allowed:
        for name in (contact.first, contact.second):
            step = placed.get(name)
            if step is not None:
                later = {step_of[t] for t in contact.tasks & works}
                found.setdefault(step, set()).update(k for k in later if k > step)
    return {step: frozenset(own) for step, own in found.items()}
