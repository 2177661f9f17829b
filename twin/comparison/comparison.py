"""Comparison of all policies on one sequential plan (APEX-MR V-A, Figs. 7 and 8).

All policies of a seed share assignment, smoothed paths and drawn skill durations: they differ
in what waits for what, and in nothing else until shortcuts are taken.

Lower bounds on the makespan: transits as straight joint lines, nobody ever in the way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import ScenarioError
from planning.motion.speed import SpeedModel
from planning.transforms import Array, Indices
from scheduling.build_tpg import build_nodes
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from twin.durations.model import NANOSECONDS
from twin.host.progress import Report, StageWatch, report_nothing
from twin.planning.pipeline import default_shortcuts, plan_in_turns, planned_shortcuts
from twin.planning.time_parameterization import timed
from twin.run.events import ExecutionRecord
from twin.run.policies import (
    NAMED_POLICIES,
    OPEN_LOOP,
    SEQUENTIAL,
    SYNCHRONOUS,
    WHOLE_PLANS,
)
from twin.run.summary import lower_bound_s
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario
from twin.trial.planning import CoordinatedPlans
from twin.trial.simulation import execute


def straight_line_s(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    speeds: Mapping[str, SpeedModel],
    *,
    past_home: bool = False,
) -> float:
    """Return the time that the busiest robot needs with straight transits and no waits [s].

    Its skills take as long as they did in the run, its transits are straight joint lines, the
    shortest there are, whatever is in the way.

    Args:
        tpg: what was executed.
        run: how.
        speeds: speed model of each robot.
        past_home: go straight from skill to skill or goal, past the ends of other transits
            such as HOME. Only this bounds a plan with shortcuts.
    """
    goals = [task.index for task in tpg.tasks if task.goal] if past_home else None
    totals = [
        float(_straight(chain, own, speeds[chain.robot], goals)[1].sum())
        for chain, own in zip(tpg.chains, run.duration_ns, strict=True)
    ]
    return max(totals, default=0.0)


def straight_line_ratio(
    tpg: TemporalPlanGraph, run: ExecutionRecord, speeds: Mapping[str, SpeedModel]
) -> float:
    """Return the makespan of a baseline over the one that straight transits would give it.

    Robots wait for each other as before: one task after another in a sequential run, everyone
    for everyone at the end of each slot in a synchronous one. A baseline near 1 is no slow
    one that is easily beaten.

    Args:
        tpg: what was executed; of a synchronous run, with the slots.
        run: how, sequentially or synchronously.
        speeds: speed model of each robot.
    """
    in_slots = run.policy == "synchronous"
    last = max((task.index for task in tpg.tasks), default=0)
    slot_of: Indices = np.arange(last + 1)
    if in_slots:
        slot_of[[task.index for task in tpg.tasks]] = tpg.slots
    longest = np.zeros(int(np.max(slot_of, initial=0)) + 1)
    for chain, own in zip(tpg.chains, run.duration_ns, strict=True):
        tasks, seconds = _straight(chain, own, speeds[chain.robot], None)
        spent = np.bincount(slot_of[tasks], seconds, minlength=len(longest))
        longest = np.maximum(longest, spent)
    straight = float(longest.sum())
    return run.makespan_s / straight if straight > 0 else 1.0


def _straight(
    chain: NodeChain,
    duration_ns: Indices,
    speed: SpeedModel,
    goals: Sequence[int] | None,
) -> tuple[Indices, Array]:
    """Return the stretches of a chain, each by the task it begins with, and their seconds.

    A stretch is a skill node, or the transit nodes of a task. With ``goals`` it is all transit
    nodes up to the next skill, or to the end of one of these tasks.
    """
    if len(chain) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0)
    ends = np.vstack([chain.start, chain.waypoints[chain.first[1:] - 1]])
    begins = chain.skill.copy()
    begins[0] = True
    begins[1:] |= chain.skill[:-1]
    changes = np.diff(chain.task) != 0
    if goals is not None:
        changes &= np.isin(chain.task[:-1], goals)
    begins[1:] |= changes
    cuts = np.append(np.flatnonzero(begins), len(chain))
    seconds = [
        float(duration_ns[a]) / NANOSECONDS
        if chain.skill[a]
        else speed.duration(ends[a], ends[b])
        for a, b in pairwise(cuts.tolist())
    ]
    return chain.task[cuts[:-1]], np.array(seconds)


COMPARED = tuple(name for name in NAMED_POLICIES if name != OPEN_LOOP)
"""Names of what is compared, in the order of tables and charts."""

SEEDS = "seeds"
"""Name of the stage that counts seeds, for progress displays."""

STAGES = ("sequence", "assignment", "motion", "synchronous", "tpg", "shortcut")
"""Stages of planning in the order they are gone through."""

TOTAL = "total"
"""Name of the sum of all stages."""

BASELINES = (SEQUENTIAL, SYNCHRONOUS)
"""Those that others are measured against; these alone are not executed asynchronously."""


@dataclass(frozen=True)
class Measurement:
    """Measured figures of one policy with one seed.

    Attributes:
        makespan_s: end of the last node [s].
        wait_s: waits of all robots, each until its own last node is complete [s].
        planning_s: seconds of each stage that the policy needs, by the wall clock where no other
            one was asked for.
        straight_line_s: time of the robot with most to do if it never waited and all its
            transits were straight joint lines [s]; see ``bounds.straight_line_s``.
        critical_path_s: longest path through the nodes and the dependencies of tasks alone [s].
        straight_line_ratio: of a baseline, its makespan over that with straight transits;
            None for the others.
        nodes, type2_edges: size of the graph that was executed.
    """

    makespan_s: float
    wait_s: float
    planning_s: Mapping[str, float]
    straight_line_s: float
    critical_path_s: float
    straight_line_ratio: float | None
    nodes: int
    type2_edges: int


Figure = dict[str, Any]
"""Keys mean, std and per_seed."""

Rows = Mapping[int, Mapping[str, Measurement]]
"""Measurements of all policies, by seed and policy."""


def shortcut_budget(scenario: Scenario) -> int:
    """Return the default number of shortcut candidates: the scenario's, or by its size."""
    return planned_shortcuts(scenario) or default_shortcuts(scenario)


def measure_policies(
    scenario: Scenario,
    seed: int,
    *,
    candidates: int,
    base: Path = Path(),
    progress: Report = report_nothing,
) -> dict[str, Measurement]:
    """Plan a scenario with one seed and execute the plan under every policy.

    Args:
        scenario: a checked scenario; its own policy, coordination and shortcuts do not matter.
        seed: of plan and draws, in place of the scenario's.
        candidates: shortcuts tried on each plan.
        base: where relative paths of the scenario start.
        progress: told how far each stage has come.

    Raises:
        TwinError: it cannot be planned; see ``plan_scenario``.
    """
    scenario = scenario.model_copy(update={"seed": seed})
    watch = StageWatch(progress)
    turns = plan_to_compare(scenario, base, watch)
    return measure_plans(turns, scenario, watch, candidates=candidates, base=base)


def plan_to_compare(
    scenario: Scenario, base: Path, watch: StageWatch
) -> PlannedMotions:
    """Plan what all policies share: who does what, and one task after another.

    Raises:
        TwinError: it cannot be planned, or not in slots; see ``plan_scenario``.
    """
    if assembly_kind(scenario.assembly).machines():
        raise ScenarioError(
            "no plan in slots can wait for machines, sources and products: study the"
            " scenario instead, with the policies sequential and asynchronous"
        )
    return plan_in_turns(scenario, base, watch)


def measure_plans(
    turns: PlannedMotions,
    scenario: Scenario,
    watch: StageWatch,
    *,
    candidates: int,
    base: Path = Path(),
    policies: Sequence[str] = COMPARED,
) -> dict[str, Measurement]:
    """Execute a plan under some policies.

    Args:
        turns: one task after another.
        scenario: that it was planned of; its joint planning is that of the plans in slots.
        watch: that measured what was planned so far; its clock measures what is left to plan.
        candidates: shortcuts tried on each plan.
        base: where relative paths of the scenario start.
        policies: their names.

    Raises:
        TwinError: it cannot be planned; see ``plan_scenario``.
    """

    def fresh() -> StageWatch:
        return StageWatch(watch.report, clock=watch.clock)

    plans = CoordinatedPlans(turns, scenario, fresh, candidates=candidates)
    found = {}
    for name in policies:
        plan, release = NAMED_POLICIES[name]
        seconds = {**watch.seconds, **plans.seconds(plan)}
        if name == SEQUENTIAL:  # no graph is part of this baseline: nothing to wait for
            tpg = timed(build_nodes(turns.motion_plan), scenario, StageWatch())
        else:
            tpg = plans[plan]
        run = execute(scenario, tpg, base, release)
        speeds, ratio = turns.settings.speeds, None
        if name in BASELINES:
            # What waits for what in slots follows from the slots.
            del seconds["tpg"]
            ratio = straight_line_ratio(tpg, run, speeds)
        found[name] = Measurement(
            makespan_s=run.makespan_s,
            wait_s=sum(map(run.wait_ns, range(len(tpg.chains)))) / NANOSECONDS,
            planning_s=seconds,
            straight_line_s=straight_line_s(
                tpg, run, speeds, past_home=plan in WHOLE_PLANS
            ),
            critical_path_s=lower_bound_s(tpg, run),
            straight_line_ratio=ratio,
            nodes=sum(len(chain) for chain in tpg.chains),
            type2_edges=len(tpg.edges),
        )
    return found


def comparison_figures(rows: Rows) -> dict[str, dict[str, Any]]:
    """Return the figures of every policy, with the keys of ``compare.json``.

    Each figure is {mean, std, per_seed}, std being the sample standard deviation, null with
    one seed. Relative figures are those of a seed over the sequential plan's of the same seed.
    """
    first = [row[SEQUENTIAL] for row in rows.values()]
    return {
        name: {
            **_policy_figures([row[name] for row in rows.values()], first),
            "seeds": list(rows),
        }
        for name in next(iter(rows.values()))
    }


def figure(values: Sequence[float | None]) -> Figure | None:
    """Return mean and spread of values a seed, None where one is missing."""
    known = [value for value in values if value is not None]
    if not known or len(known) < len(values):
        return None
    return {
        "mean": float(np.mean(known)),
        "std": float(np.std(known, ddof=1)) if len(known) > 1 else None,
        "per_seed": [float(value) for value in known],
    }


def _policy_figures(
    own: Sequence[Measurement], first: Sequence[Measurement]
) -> dict[str, Any]:
    def each(value: Callable[[Measurement], float | None]) -> Figure | None:
        return figure([value(m) for m in own])

    def relative(value: Callable[[Measurement], float]) -> Figure | None:
        pairs = [(value(m), value(f)) for m, f in zip(own, first, strict=True)]
        return figure([a / b if b > 0 else None for a, b in pairs])

    return {
        "makespan_s": each(lambda m: m.makespan_s),
        "wait_s": each(lambda m: m.wait_s),
        "planning_s": _planning([m.planning_s for m in own]),
        "relative_makespan": relative(lambda m: m.makespan_s),
        "relative_wait": relative(lambda m: m.wait_s),
        "straight_line_s": each(lambda m: m.straight_line_s),
        "critical_path_s": each(lambda m: m.critical_path_s),
        "straight_line_ratio": each(lambda m: m.straight_line_ratio),
        "nodes": each(lambda m: m.nodes),
        "type2_edges": each(lambda m: m.type2_edges),
    }


def _planning(rows: Sequence[Mapping[str, float]]) -> dict[str, Figure | None]:
    stages = [s for s in STAGES if any(s in row for row in rows)]
    out = {s: figure([row.get(s, 0.0) for row in rows]) for s in stages}
    return {**out, TOTAL: figure([sum(row.values()) for row in rows])}
