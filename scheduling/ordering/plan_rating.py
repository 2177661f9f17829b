"""Rating of task plans by the makespan of their temporal plan graphs.

The integer program of the task assignment adds up distances and does not model waits between robots. To rate a plan,
its motions are planned, the best task order is found by a beam search, and transits are shortened so that they need
not pass through the home configuration. The rating is the resulting makespan.
"""

from __future__ import annotations

from dataclasses import dataclass

from planning.cell.workcell import Workcell
from planning.errors import PlanInvariantError, TransitError
from planning.motion.motion_cache import MotionCache
from planning.motion.motion_plan import MotionPlan
from planning.motion.sequential import MotionSettings, plan_motions_sequentially
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import TaskPlan
from scheduling.build_nodes import build_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg, OccupantConflicts
from scheduling.ordering.beam_search import TaskOrderSearch
from scheduling.ordering.known_edges import connect_in_order
from scheduling.ordering.relations import TaskRelations
from scheduling.ordering.reordering import (
    WIDTH,
    find_blocks,
    put_in_order,
    straight_durations,
)
from scheduling.shortcuts.shortcutting import smooth_spans
from scheduling.shortcuts.static_scene import SmoothedPathCache

_WIDTH = 8
"""Beam width of the rating; the final plan is ordered again with a wider beam."""


@dataclass(frozen=True)
class RatedPlan:
    """A task plan with its motions and its makespan.

    Attributes:
        work: what it is a plan of, with its steps in their order.
        task_plan: the assignment.
        motion_plan: how everyone moves.
        by_home_s: makespan of the graph of the best order of its tasks that was found, by way of
            HOME [s].
        makespan_s: makespan of that graph with its runs of transits smoothed past HOME [s].
    """

    work: Assembly
    task_plan: TaskPlan
    motion_plan: MotionPlan
    by_home_s: float
    makespan_s: float


class PlanRater:
    """Rates plans of one assembly by makespan, sharing cached conflicts between tasks.

    Args:
        cell: where it is built.
        settings: how tasks are turned into motions.
        shortcuts: whether paths will be taken past HOME.
        straight: rate these by their straight lines, not by smoothed paths.
    """

    def __init__(
        self,
        cell: Workcell,
        settings: MotionSettings,
        *,
        shortcuts: bool = True,
        straight: bool = False,
    ) -> None:
        self._cell, self._settings = cell, settings
        self._shortcuts, self._straight = shortcuts, straight
        self.conflicts = OccupantConflicts(kept=True)
        self._motions = MotionCache()
        self._smoothed = SmoothedPathCache(settings.seed)

    def rate(self, work: Assembly, plan: TaskPlan) -> RatedPlan | None:
        """Plan the motions of a task plan and rate it; None where no motions are found.

        Args:
            work: what it is a plan of.
            plan: the plan.
        """
        try:
            plan, motions = plan_motions_sequentially(
                self._cell, work, plan, self._settings, known=self._motions
            )
            return self.rate_motions(work, plan, motions)
        except (TransitError, PlanInvariantError):
            return None

    def rate_motions(
        self, work: Assembly, plan: TaskPlan, motions: MotionPlan
    ) -> RatedPlan:
        """Rate already planned motions, see ``rate``.

        Raises:
            PlanInvariantError: the order that was found breaks a guarantee.
        """
        nodes = build_nodes(motions)
        relations = TaskRelations(DerivedTpg(nodes), self.conflicts)
        blocks = find_blocks(nodes.chains, relations)
        if self._straight and self._shortcuts:
            durations = straight_durations(relations.graph, self._settings.speeds)
            best = TaskOrderSearch(relations, blocks, durations).best_path(WIDTH)
            makespan = max(best.clocks, default=0.0)
            return RatedPlan(work, plan, motions, makespan, makespan)
        best = TaskOrderSearch(relations, blocks).best_path(_WIDTH)
        by_home = max(best.clocks, default=0.0)
        order = [blocks[b] for b in best.order()]
        chains = put_in_order(nodes.chains, relations, order)
        graph = DerivedTpg(connect_in_order(chains, relations, order))
        if self._shortcuts:
            graph = smooth_spans(
                graph.tpg,
                self._settings.speeds,
                step=self._settings.step,
                seed=self._settings.seed,
                known=self._smoothed,
                conflicts=self.conflicts,
            )
        makespan = float(graph.rollout.makespan)
        return RatedPlan(work, plan, motions, by_home, makespan)
