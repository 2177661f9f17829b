"""Which luck a task has that was planned anew: that of the same try at the same skill of its step.

Draws are named by tasks. A task that is planned again before anybody has tried it keeps the name, and so the
luck, that it had in the first plan; one that is tried once more has a name of its own. So what happens to a
step does not depend on when or how often others were planned, and ways to recover can be compared.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from planning.tasks.task import LEFT_OUT, Task
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.uncertainty.draws import TaskName

_AGAIN = 2**32
"""Added to the number of a task for each time that it is tried once more."""

_Skill = tuple[int, str]
"""Step and kind of a task."""


@dataclass(frozen=True)
class Luck:
    """Names of the draws of all tasks of an operation.

    Attributes:
        first: tasks of the first plan, by step and kind.
        skills: step and kind of every task, by index: those of what failed or is left out, too.
        names: of the draws of tasks whose names are not their own, by index.
    """

    first: Mapping[_Skill, tuple[Task, ...]]
    skills: Mapping[int, _Skill]
    names: Mapping[int, TaskName]

    @classmethod
    def of(cls, tpg: TemporalPlanGraph) -> Luck:
        """Return the luck of a first plan, whose tasks name their draws themselves."""
        first: dict[_Skill, tuple[Task, ...]] = {}
        for task in tpg.tasks:
            own = task.step, task.kind
            first[own] = (*first.get(own, ()), task)
        return cls(first, {t.index: (t.step, t.kind) for t in tpg.tasks}, {})

    def onward(self, tpg: TemporalPlanGraph, new: int) -> Luck:
        """Return the names for a graph whose tasks from an index on are new."""
        before = [t.index for t in tpg.tasks[:new] if t.kind != LEFT_OUT]
        tries = Counter(self.skills[index] for index in before)
        skills = {index: self.skills[index] for index in range(new)}
        names = {k: name for k, name in self.names.items() if k < new}
        for task in tpg.tasks[new:]:
            own = task.step, task.kind
            skills[task.index] = own
            if planned := self.first.get(own):
                again = max(tries[own] - len(planned) + 1, 0)
                model = planned[min(tries[own], len(planned) - 1)]
                names[task.index] = (model.robot, model.index + again * _AGAIN)
            tries[own] += 1
        return Luck(self.first, skills, names)
