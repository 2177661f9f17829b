"""Rolling planning window of steps: its size, and the times at which it advances.

The order of steps is fixed, and the structure is known to be stable after every step. Robots, objects and motions of
a step are chosen when the step enters the window, or when its product is ordered.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from planning.tasks.assignment import TaskPlan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from twin.scenario.sections.execution import StepWindowSection


class StepWindow:
    """Rolling planning window over the steps of an assembly.

    Args:
        section: steps at a time; None for all at once.
        motions: of the first of them.
    """

    def __init__(
        self, section: StepWindowSection | None, motions: PlannedMotions
    ) -> None:
        self._section, self._ahead = section, motions.ahead
        self._begins: tuple[TemporalPlanGraph, list[dict[int, int]]] | None = None

    def due(
        self,
        tpg: TemporalPlanGraph,
        released: Sequence[int],
        planned: int,
        undone: Collection[int],
        last: int,
    ) -> bool:
        """Return whether steps after the planned ones are due for planning.

        Args:
            tpg: the executed plan.
            released: number of released nodes of each chain.
            planned: number of first steps that are planned.
            undone: steps that are not done.
            last: how many there are to be.
        """
        if self._section is None or planned >= last:
            return False
        # Steps of machines alone follow those of robots: no robot waits for their start.
        left = sum(
            bool(own) and all(released[k] <= n for k, n in own.items())
            for step, own in enumerate(self._first_nodes(tpg, planned), start=1)
            if step not in undone
        )
        return left <= self._section.least

    def after(self, planned: int, last: int) -> int:
        """Return the next number of planned steps after a given one, where more are wanted."""
        assert self._ahead is not None
        if self._section is None:
            return last
        return min(self._ahead.with_whole_products(planned + self._section.steps), last)

    @property
    def in_products(self) -> bool:
        """Whether the steps after the first ones belong to further products."""
        return self._ahead is not None and self._ahead.wanted < self._ahead.steps

    def whole_products(self, steps: int) -> int:
        """Return how many of the first steps make whole products; all without products."""
        ahead = self._ahead
        if ahead is None:
            return steps
        return ahead.steps_of_products(ahead.whole_products(steps))

    @property
    def ordered_at_once(self) -> bool:
        """Whether all ordered products are planned at once."""
        return self.in_products and self._section is None

    def last(self, given_up: Collection[int], more: int) -> int:
        """Return the final number of steps, spare products included; 0 where all are planned.

        Args:
            given_up: steps that are not done though they are wanted: others take the place of their products.
            more: products that have been ordered since.
        """
        if self._ahead is None:
            return 0
        ahead = self._ahead
        others = ahead.count_products(given_up) + more
        return ahead.steps_of_products(ahead.whole_products(ahead.wanted) + others)

    def is_short(self, given_up: Collection[int], more: int, planned: int) -> bool:
        """Return whether a number of planned steps lacks wanted ones; see ``last``."""
        if self._ahead is None or not self.in_products:
            return bool(given_up)
        ahead = self._ahead
        made = ahead.whole_products(planned) - ahead.count_products(given_up)
        return made < ahead.whole_products(ahead.wanted) + more

    def all_steps(self, plan: TaskPlan) -> range:
        """Return the numbers of all steps, those after the planned ones included."""
        if self._ahead is None or self.in_products:
            return range(1, len(plan.choices) + 1)
        return range(1, self._ahead.steps + 1)

    def unplanned(self, plan: TaskPlan) -> int:
        """Return the number of steps not planned yet, spare products included."""
        return 0 if self._ahead is None else self._ahead.steps - len(plan.choices)

    def of_first(self, motions: PlannedMotions, count: int) -> PlannedMotions:
        """Return motions with the work of a number of first steps."""
        if self._ahead is None:
            return motions
        return replace(motions, work=self._ahead.first(count))

    def _first_nodes(
        self, tpg: TemporalPlanGraph, planned: int
    ) -> list[dict[int, int]]:
        """Return the first node of each robot in each step, by chain."""
        if self._begins is None or self._begins[0] is not tpg:
            found: list[dict[int, int]] = [{} for _ in range(planned)]
            machines = tpg.machine_chains()
            for k, chain in enumerate(tpg.chains):
                for node, index in enumerate(chain.task.tolist()):
                    if k not in machines and tpg.tasks[index].step <= planned:
                        found[tpg.tasks[index].step - 1].setdefault(k, node)
            self._begins = tpg, found
        return self._begins[1]
