"""Anytime search for a better plan, from the one that the integer program chose.

That program adds up distances; it does not see who waits for whom. Here a plan is worth the makespan of
its own graph, with its own motions, the best order of its tasks that is found, and transits smoothed
past HOME. A plan next to the present one is drawn, mostly where the makespan hangs on, and becomes the
present one unless it is clearly worse than the best so far (record-to-record travel, Dueck 1993).

Plans and what they are worth: the makespan of their graphs, in order and past HOME.

Plans next to another one: a step done in another way, steps that exchange their robots, or a step moved
past its neighbours, one after another.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from planning.cell.workcell import Workcell
from planning.errors import PlanInvariantError, TransitError
from planning.motion.known_motions import KnownMotions, MotionPlan
from planning.motion.sequential import MotionSettings, plan_sequential
from planning.progress import Progress, no_progress
from planning.tasks.assignment import (
    AssignmentProblem,
    StepChoice,
    TaskPlan,
    alternatives,
)
from planning.tasks.work import AssemblyWork, StepExpansions
from scheduling.build_tpg import build_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg, StretchConflicts
from scheduling.graph.dispatcher import latest_ends
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
                windows=work.windows,
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


def move_step(
    work: AssemblyWork, plan: TaskPlan, step: int, places: int
) -> tuple[AssemblyWork, TaskPlan] | None:
    """Return a plan in which a step is done later or sooner, None where it stays in its place.

    It is moved as far as that can be: each of the orders between is one to build in as well.

    Args:
        work: what the plan is a plan of.
        plan: the plan.
        step: that is moved, counted from 1.
        places: by how many places it is moved on at most, negative to move it up.
    """
    moved: tuple[AssemblyWork, TaskPlan] | None = None
    for k in range(abs(places)):
        at = step + k if places > 0 else step - k - 1
        further = exchange_steps(*(moved or (work, plan)), at)
        if further is None:
            break
        moved = further
    return moved


def exchange_steps(
    work: AssemblyWork, plan: TaskPlan, at: int
) -> tuple[AssemblyWork, TaskPlan] | None:
    """Return a plan in which a step and the next one are exchanged, None where that cannot be.

    Both are done as they were as far as that is possible in their new places.

    Args:
        work: what the plan is a plan of.
        plan: the plan.
        at: the first of the two, counted from 1.
    """
    if not 1 <= at < len(plan.choices):
        return None
    other = work.exchanged(at)
    if other is None:
        return None
    a, b = _at_step(plan[at + 1], at), _at_step(plan[at], at + 1)
    plan = plan.with_choice(a).with_choice(b)
    for wanted in (a, b):
        choice = _most_alike(other.problem, plan, wanted)
        if choice is None:
            return None
        plan = plan.with_choice(choice)
    return other, plan


def _at_step(choice: StepChoice, step: int) -> StepChoice:
    """Return a choice as one of another step."""
    support = choice.support and replace(choice.support, step=step)
    return StepChoice(replace(choice.primary, step=step), support)


def _most_alike(
    problem: AssignmentProblem, plan: TaskPlan, wanted: StepChoice
) -> StepChoice | None:
    """Return the way to do a step of a plan that differs least from what is wanted there."""
    # What is wanted may not be a way to do it: no way is taken for the present one.
    unlike = StepChoice(replace(wanted.primary, cost=-1.0), wanted.support)
    ways = alternatives(problem, plan.with_choice(unlike), wanted.step)

    def unalike(way: StepChoice) -> tuple[bool, bool, bool, bool, float]:
        a, b = way.primary, wanted.primary
        return (
            (a.robot, a.partner) != (b.robot, b.partner),
            a.object != b.object,
            a.grasp != b.grasp,
            (way.support and way.support.pose) != (b_support and b_support.pose),
            way.cost,
        )

    b_support = wanted.support
    return min(ways, key=unalike, default=None)


_CHEAPEST = 4
"""Of the ways to do a step that differ in the same, only so many are drawn from."""

_NEAR = 6
"""Steps whose robots are exchanged are less than this apart."""

_PLACES = 3
"""A step is moved by at most so many places."""

_MOVES = 6
"""So many steps are tried before no move is drawn."""

ROBOT, SUPPORT, OBJECT, GRASP, EXCHANGE, ORDER = range(6)

KINDS = (ROBOT, ROBOT, EXCHANGE, EXCHANGE, ORDER, ORDER, SUPPORT, OBJECT, GRASP)
"""What may change, each as likely as it stands here."""


def draw_neighbour(
    work: AssemblyWork,
    plan: TaskPlan,
    critical: Sequence[int],
    rng: np.random.Generator,
) -> tuple[AssemblyWork, TaskPlan] | None:
    """Return a plan next to another one, None where the draw leads nowhere.

    Args:
        work: what the plan is a plan of.
        plan: the plan.
        critical: steps that the makespan hangs on; four of five draws begin with one of them.
        rng: of the draws.

    Returns:
        The plan, and what it is a plan of: the same work, or one with its steps in another order.
    """
    kind = KINDS[int(rng.integers(len(KINDS)))]
    count = len(plan.choices)
    if critical and rng.random() < 0.8:
        step = int(critical[int(rng.integers(len(critical)))])
    else:
        step = 1 + int(rng.integers(count))
    if kind == ORDER:
        return _moved(work, plan, step, rng)
    change = _exchanged if kind == EXCHANGE else partial(_changed, kind=kind)
    found = change(work.problem, plan, step, rng)
    return None if found is None else (work, found)


def _moved(
    work: AssemblyWork, plan: TaskPlan, step: int, rng: np.random.Generator
) -> tuple[AssemblyWork, TaskPlan] | None:
    """Return a plan with a step moved, one way or the other; another step if it cannot be."""
    for _ in range(_MOVES):
        places = (1 + int(rng.integers(_PLACES))) * (1 if rng.random() < 0.5 else -1)
        for way in (places, -places):
            found = move_step(work, plan, step, way)
            if found is not None:
                return found
        step = 1 + int(rng.integers(len(plan.choices)))
    return None


def _exchanged(
    problem: AssignmentProblem, plan: TaskPlan, step: int, rng: np.random.Generator
) -> TaskPlan | None:
    count = len(plan.choices)
    near = [
        k
        for k in range(max(1, step - _NEAR + 1), min(count, step + _NEAR - 1) + 1)
        if plan[k].robot != plan[step].robot
    ]
    if not near:
        return None
    other = near[int(rng.integers(len(near)))]
    robots = {step: plan[other].robot, other: plan[step].robot}
    for one, robot in robots.items():
        found = _drawn(
            [c for c in alternatives(problem, plan, one) if c.robot == robot], rng
        )
        if found is None:
            return None
        plan = plan.with_choice(found)
    return plan


def _changed(
    problem: AssignmentProblem,
    plan: TaskPlan,
    step: int,
    rng: np.random.Generator,
    *,
    kind: int,
) -> TaskPlan | None:
    now = plan[step]
    found = _drawn(
        [c for c in alternatives(problem, plan, step) if _difference(now, c) == kind],
        rng,
    )
    return None if found is None else plan.with_choice(found)


def _difference(now: StepChoice, other: StepChoice) -> int:
    """Return the first thing in which two ways to do a step differ."""
    if now.robot != other.robot or now.primary.partner != other.primary.partner:
        return ROBOT
    if now.support != other.support:
        return SUPPORT
    return OBJECT if now.object != other.object else GRASP


def _drawn(choices: list[StepChoice], rng: np.random.Generator) -> StepChoice | None:
    """Return one of the cheapest choices."""
    if not choices:
        return None
    best = sorted(choices, key=lambda choice: choice.cost)[:_CHEAPEST]
    return best[int(rng.integers(len(best)))]
