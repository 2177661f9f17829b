"""Planning of the rest of an assembly from a given world state, as a separate graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planning.cell.workcell import Workcell
from planning.motion.motion_cache import MotionCache
from planning.motion.motion_plan import MotionPlan
from planning.tasks.task import Task
from planning.worlds.onward import OnwardPlan, ReplanningState, plan_onward
from planning.worlds.world import (
    World,
    as_start_of,
    pending_windows,
    rebase_first_tasks,
)
from scheduling.build_nodes import build_nodes
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.ordering.reordering import reorder_tasks
from scheduling.planned_motions import PlannedMotions
from scheduling.shortcuts.shortcutting import shorten_tpg
from twin.host.progress import StageWatch
from twin.planning.time_parameterization import time_parameterize
from twin.scenario.sections.scenario import Scenario


def plan_from(
    motions: PlannedMotions,
    scenario: Scenario,
    cell: Workcell,
    now: ReplanningState,
    before: Sequence[Task],
    watch: StageWatch,
    *,
    candidates: int,
    known: MotionCache | None = None,
) -> tuple[OnwardPlan, TemporalPlanGraph]:
    """Plan the rest of an assembly from a world on.

    The graph is ordered and shortened by itself: the rest of the old plan only delays it.

    Args:
        motions: base motions of the first plan.
        scenario: its settings.
        cell: with the objects that have come up.
        now: where it begins.
        before: tasks of the plan so far; new ones are numbered after them.
        watch: measures the stages.
        candidates: shortcuts tried.
        known: cache of paths found before.

    Returns:
        Choices, tasks and motions, and their graph, which begins in the world.

    Raises:
        InfeasibleStepError: a step can no longer be done by anyone.
        TransitError: no collision-free path was found.
        PlanInvariantError: the plan breaks a guarantee, which is a fault of this program.
    """
    assert motions.work is not None
    with watch.stage("motion"):
        onward = plan_onward(cell, motions.work, motions.settings, now, known=known)
    tpg = graph_from_world(onward.motions, now.world, before, watch)
    if candidates and len(tpg.chains):
        with watch.stage("shortcut"):
            tpg = shorten_tpg(
                reorder_tasks(tpg),
                motions.settings.speeds,
                step=motions.settings.step,
                candidates=candidates,
                seed=scenario.seed,
            )
    return onward, time_parameterize(tpg, scenario, watch)


def graph_from_world(
    plan: MotionPlan, world: World, before: Sequence[Task], watch: StageWatch
) -> TemporalPlanGraph:
    """Return the graph of motions that begin in a world.

    Args:
        plan: plan of the new tasks, numbered after the world's.
        world: where it begins.
        before: see ``plan_from``.
        watch: measures the stage.
    """
    busy, first = frozenset(task.robot for task in plan.tasks), world.tasks
    inside = plan.dependencies[np.all(plan.dependencies >= first, axis=1)]
    begins = replace(
        plan,
        cell=as_start_of(plan.cell, world, busy),
        tasks=rebase_first_tasks(plan.tasks, world),
        dependencies=inside,
        windows=tuple(pending_windows(world, plan.windows)),
    )
    with watch.stage("tpg"):
        nodes = build_nodes(begins)
        whole = replace(nodes, tasks=(*before[:first], *nodes.tasks))
        return connect_nodes(DerivedTpg(whole))
