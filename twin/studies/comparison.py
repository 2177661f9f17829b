"""Comparison of policies: a study with one plan and one replication per seed (APEX-MR V-A, Figs. 7 and 8).

All policies of a seed share the assignment, the smoothed paths and the drawn skill durations. Two lower bounds are
reported for each makespan: one for straight transits without waits, and one from the longest path of dependent tasks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from planning.motion.speed import SpeedModel
from planning.transforms import Array, Indices
from scheduling.build_nodes import build_nodes
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from twin.durations.nanoseconds import NANOSECONDS
from twin.host.progress import StageWatch
from twin.planning.pipeline import require_sequential
from twin.planning.time_parameterization import time_parameterize
from twin.runs.execution_record import ExecutionRecord
from twin.runs.policies import (
    NAMED_POLICIES,
    OPEN_LOOP,
    SEQUENTIAL,
    SYNCHRONOUS,
    WHOLE_PLANS,
)
from twin.runs.summary import lower_bound_s
from twin.scenario.sections.scenario import Scenario
from twin.studies.plans import require_no_machines
from twin.trial.planning import CoordinatedPlans
from twin.trial.simulation import execute

COMPARED = tuple(name for name in NAMED_POLICIES if name != OPEN_LOOP)
"""Compared policies, in the order of tables and charts."""

SEEDS = "seeds"
"""Name of the stage that counts seeds, for progress displays."""

STAGES = (
    "sequence",
    "assignment",
    "motion",
    "assignment_search",
    "synchronous",
    "tpg",
    "shortcut",
)
"""Stages of planning, in their order."""

TOTAL = "total"
"""Name of the sum of all stages."""

BASELINES = (SEQUENTIAL, SYNCHRONOUS)
"""Policies that are not executed asynchronously."""

_RELATIVE = {"relative_makespan": "makespan_s", "relative_wait": "wait_s"}
"""Figures over those of the sequential plan with the same seed."""

Figure = dict[str, Any]
"""Keys mean, std and per_seed."""

Rows = Mapping[int, Mapping[str, "Measurement"]]
"""Measurements of all policies, by seed and policy."""


@dataclass(frozen=True)
class Measurement:
    """Figures of one policy with one seed.

    Attributes:
        makespan_s: end of the last node [s].
        wait_s: waits of all robots, each until its own last node is complete [s].
        planning_s: seconds of each stage that the policy needs, by the clock that measured it.
        straight_line_s: see the function of this name [s].
        critical_path_s: longest path through the nodes and the dependencies of tasks alone [s].
        straight_line_ratio: of a baseline, see the function of this name; None for the others.
        nodes, type2_edges: size of the executed graph.
    """

    makespan_s: float
    wait_s: float
    planning_s: Mapping[str, float]
    straight_line_s: float
    critical_path_s: float
    straight_line_ratio: float | None
    nodes: int
    type2_edges: int


def require_comparable(scenario: Scenario) -> None:
    """Refuse a scenario that has no plan in slots.

    Raises:
        ScenarioError: it has machines, or is planned in space and time.
    """
    require_no_machines(scenario)
    require_sequential(scenario)


def measure_policies(
    turns: PlannedMotions,
    scenario: Scenario,
    watch: StageWatch,
    *,
    candidates: int,
    base: Path = Path(),
    policies: Sequence[str] = COMPARED,
) -> dict[str, Measurement]:
    """Execute the plans of all policies from the same motions, with the same draws.

    Args:
        turns: motions, one task after another.
        scenario: planned scenario; its seed names the draws.
        watch: that measured the planning so far; its clock measures the rest.
        candidates: shortcuts tried on each plan.
        base: folder where relative paths of the scenario start.
        policies: names of policies.

    Raises:
        TwinError: it cannot be planned; see ``plan_scenario``.
    """

    def fresh() -> StageWatch:
        return StageWatch(watch.report, clock=watch.clock)

    plans = CoordinatedPlans(turns, scenario, fresh, candidates=candidates)
    speeds, found = turns.settings.speeds, {}
    for name in policies:
        plan, release = NAMED_POLICIES[name]
        seconds = {**watch.seconds, **plans.seconds(plan)}
        if name == SEQUENTIAL:  # this baseline needs no edges
            tpg = time_parameterize(
                build_nodes(turns.motion_plan), scenario, StageWatch()
            )
        else:
            tpg = plans[plan]
        run = execute(scenario, tpg, base, release)
        ratio = None
        if name in BASELINES:
            del seconds["tpg"]  # the edges between slots follow from the slots
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
            nodes=sum(map(len, tpg.chains)),
            type2_edges=len(tpg.edges),
        )
    return found


def comparison_figures(rows: Rows) -> dict[str, dict[str, Any]]:
    """Return the figures of every policy over all seeds, the content of ``compare.json``."""
    first = [row[SEQUENTIAL] for row in rows.values()]
    return {
        name: {
            **_policy_figures([row[name] for row in rows.values()], first),
            "seeds": list(rows),
        }
        for name in next(iter(rows.values()))
    }


def _policy_figures(
    own: Sequence[Measurement], first: Sequence[Measurement]
) -> dict[str, Any]:
    """Return the figures of a policy; ``first`` are the measurements of the sequential one."""
    found: dict[str, Any] = {}
    for key in (field.name for field in fields(Measurement)):
        values = [getattr(one, key) for one in own]
        if key == "planning_s":
            stages = [s for s in STAGES if any(s in spent for spent in values)]
            found[key] = {s: figure([p.get(s, 0.0) for p in values]) for s in stages}
            found[key][TOTAL] = figure([sum(p.values()) for p in values])
            for name, of in _RELATIVE.items():
                pairs = [(getattr(a, of), getattr(b, of)) for a, b in zip(own, first, strict=True)]  # fmt: skip
                found[name] = figure([a / b if b > 0 else None for a, b in pairs])
        else:
            found[key] = figure(values)
    return found


def figure(values: Sequence[float | None]) -> Figure | None:
    """Return mean, sample standard deviation and values by seed; None where a value is missing."""
    known = [float(value) for value in values if value is not None]
    if not known or len(known) < len(values):
        return None
    std = float(np.std(known, ddof=1)) if len(known) > 1 else None
    return {"mean": float(np.mean(known)), "std": std, "per_seed": known}


def straight_line_s(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    speeds: Mapping[str, SpeedModel],
    *,
    past_home: bool = False,
) -> float:
    """Return the time of the busiest robot with straight transits and no waits [s].

    Skills take as long as in the run; transits are straight joint lines without obstacles.

    Args:
        tpg: executed graph.
        run: its execution.
        speeds: speed model of each robot.
        past_home: go straight from skill to skill or goal. Only this bounds a plan with shortcuts.
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
    """Return the makespan of a baseline over its makespan with straight transits.

    Waits are kept: one task after another in a sequential run, until the end of each slot in a
        synchronous one. A ratio near 1 shows that detours do not slow the baseline.

    Args:
        tpg: executed graph; of a synchronous run, with the slots.
        run: its sequential or synchronous execution.
        speeds: speed model of each robot.
    """
    last = max((task.index for task in tpg.tasks), default=0)
    slot_of: Indices = np.arange(last + 1)
    if run.policy == "synchronous":
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
    """Return the first task of each stretch of a chain, and the seconds of each stretch.

    A stretch is a skill node, or the transit nodes of a task. With ``goals`` it is all transit
    nodes up to the next skill, or to the end of one of these tasks.
    """
    if len(chain) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0)
    ends = np.vstack([chain.start, chain.waypoints[chain.first[1:] - 1]])
    changes = np.diff(chain.task) != 0
    if goals is not None:
        changes &= np.isin(chain.task[:-1], goals)
    begins = chain.skill.copy()
    begins[0] = True
    begins[1:] |= chain.skill[:-1] | changes
    cuts = np.append(np.flatnonzero(begins), len(chain))
    seconds = [
        float(duration_ns[a]) / NANOSECONDS
        if chain.skill[a]
        else speed.duration(ends[a], ends[b])
        for a, b in pairwise(cuts.tolist())
    ]
    return chain.task[cuts[:-1]], np.array(seconds)
