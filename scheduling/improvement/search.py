"""Anytime search for a better plan, from the one that the integer program chose.

That program adds up distances; it does not see who waits for whom. Here a plan is worth the
makespan of its own graph, with its own motions, the best order of its tasks that is found, and
transits smoothed past HOME. A plan next to the present one is drawn, mostly where the makespan hangs on, and becomes the present
one unless it is clearly worse than the best so far (record-to-record travel, Dueck 1993).

Plans and what they are worth: the makespan of their graphs, in order and past HOME.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import Workcell
from planning.errors import PlanInvariantError, TransitError
from planning.motion.known_motions import KnownMotions, MotionPlan
from planning.motion.sequential import MotionSettings, plan_sequential
from planning.progress import Progress, no_progress
from planning.tasks.assignment import TaskPlan
from planning.tasks.work import AssemblyWork, StepExpansions
from scheduling.build_tpg import build_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.stretches import StretchConflicts
from scheduling.graph.dispatcher import latest_ends
from scheduling.improvement.neighbours import draw_neighbour
from scheduling.ordering.beam_search import TaskOrderSearch, find_blocks, put_in_order
from scheduling.ordering.relations import TaskRelations, connect_in_order
from scheduling.shortcuts.scenery import KnownWays
from scheduling.shortcuts.shortcutting import smooth_runs

_WIDTH = 8
"""Orders followed at once; the plan that is found is ordered again with care."""

_TIGHT = 1e-3
"""The makespan hangs on nodes that could end less than this later [s]."""


@dataclass(frozen=True)
class RatedPlan:
    """A plan with its motions, and when everyone would be ready.

    Attributes:
        work: what it is a plan of, with its steps in their order.
        task_plan: who does what.
        motion_plan: how everyone moves.
        by_home_s: makespan of the graph of the best order of its tasks that was found, by way of
            HOME [s].
        makespan_s: of that graph with its runs of transits smoothed past HOME [s]; infinite
            where it was not looked at.
        critical: steps with tasks that this makespan hangs on.
    """

    work: AssemblyWork
    task_plan: TaskPlan
    motion_plan: MotionPlan
    by_home_s: float
    makespan_s: float
    critical: tuple[int, ...]


class PlanRater:
    """Rates plans of one assembly; how two tasks get on is searched once for all plans.

    Args:
        cell: where it is built.
        settings: how tasks are turned into motions.
        shortcuts: whether paths will be taken past HOME.
    """

    def __init__(
        self,
        cell: Workcell,
        settings: MotionSettings,
        *,
        shortcuts: bool = True,
    ) -> None:
        self._cell, self._settings = cell, settings
        self._shortcuts = shortcuts
        self._conflicts = StretchConflicts(kept=True)
        self._motions = KnownMotions()
        self._ways = KnownWays(settings.seed)

    def rate(
        self, work: AssemblyWork, plan: TaskPlan, worst_s: float = np.inf
    ) -> RatedPlan | None:
        """Plan the motions of a plan and rate them; None where there are none.

        Args:
            work: what it is a plan of.
            plan: the plan.
            worst_s: a plan that takes longer than this by way of HOME is not looked at further.
        """
        steps = StepExpansions(work, plan)
        try:
            motions = plan_sequential(
                self._cell,
                steps.callables(),
                work.link,
                self._settings,
                known=self._motions,
            )
            return self.rate_motions(work, steps.plan, motions, worst_s)
        except (TransitError, PlanInvariantError):
            return None

    def rate_motions(
        self,
        work: AssemblyWork,
        plan: TaskPlan,
        motions: MotionPlan,
        worst_s: float = np.inf,
    ) -> RatedPlan:
        """Rate motions that are planned already, see ``rate``.

        Raises:
            PlanInvariantError: the order that was found breaks a guarantee.
        """
        nodes = build_nodes(motions)
        relations = TaskRelations(DerivedTpg(nodes), self._conflicts)
        blocks = find_blocks(nodes.chains, relations)
        way = TaskOrderSearch(relations, blocks).best_way(_WIDTH)
        by_home = max(way.clocks, default=0.0)
        if by_home > worst_s:
            return RatedPlan(work, plan, motions, by_home, np.inf, ())
        order = [blocks[b] for b in way.order()]
        chains = put_in_order(nodes.chains, relations, order)
        graph = DerivedTpg(connect_in_order(chains, relations, order))
        if self._shortcuts:
            graph = smooth_runs(
                graph.tpg,
                self._settings.speeds,
                step=self._settings.step,
                seed=self._settings.seed,
                known=self._ways,
                conflicts=self._conflicts,
            )
        makespan = float(graph.rollout.makespan)
        critical = _critical_steps(graph)
        return RatedPlan(work, plan, motions, by_home, makespan, critical)


def _critical_steps(graph: DerivedTpg) -> tuple[int, ...]:
    """Return the steps with tasks that the makespan hangs on."""
    latest = latest_ends(graph.tpg, graph.rollout, flat=graph.flat)
    step_of = {task.index: task.step for task in graph.tpg.tasks}
    found: set[int] = set()
    for chain, end, late in zip(
        graph.tpg.chains, graph.rollout.end, latest, strict=True
    ):
        tasks = np.unique(chain.task[late - end < _TIGHT]).tolist()
        found |= {step_of[task] for task in tasks}
    return tuple(sorted(found))


_WORSE = 0.005
"""Share of the best makespan by which a plan may be worse and still be gone on from."""

_FAR = 0.05
"""Share by which a plan may be worse by way of HOME and still be looked at past HOME."""

_DRAWS = 200
"""Draws without a plan that is new after which the search ends."""


def improve_plan(
    rater: PlanRater,
    start: RatedPlan,
    *,
    seconds: float,
    tries: int,
    seed: int,
    progress: Progress = no_progress,
) -> RatedPlan:
    """Return the best plan found; the given one where none is better.

    Args:
        rater: rates plans.
        start: where to begin.
        seconds: how long to search; a plan found so depends on the machine. 0 for no limit.
        tries: most plans rated; 0 for no limit.
        seed: of the draws.
        progress: told how much is done, and of how much.
    """
    begin = time.monotonic()
    rng = np.random.default_rng([seed, 7])
    best = present = start
    seen = {(start.work.order, start.task_plan)}
    idle = done = 0
    while (not tries or done < tries) and idle < _DRAWS:
        spent = time.monotonic() - begin
        if seconds and spent >= seconds:
            break
        drawn = draw_neighbour(present.work, present.task_plan, present.critical, rng)
        if drawn is None or (drawn[0].order, drawn[1]) in seen:
            idle += 1
            continue
        work, plan = drawn
        idle, done = 0, done + 1
        seen.add((work.order, plan))
        progress(done if tries else spent, tries or seconds)
        rated = rater.rate(work, plan, present.by_home_s * (1.0 + _FAR))
        if rated is None or rated.makespan_s > best.makespan_s * (1.0 + _WORSE):
            continue
        present = rated
        if rated.makespan_s < best.makespan_s - 1e-9:
            best = rated
    progress(1, 1)
    return best
