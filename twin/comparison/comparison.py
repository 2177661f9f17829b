"""Comparison of all policies on one sequential plan (APEX-MR V-A, Figs. 7 and 8).

All policies of a seed share assignment, smoothed paths and drawn skill durations: they differ
in what waits for what, and in nothing else until shortcuts are taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from scheduling.build_nodes import build_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.comparison.bounds import straight_line_ratio, straight_line_s
from twin.durations import NANOSECONDS
from twin.host.progress import Report, StageWatch, report_nothing
from twin.planning.kind import PlannedMotions
from twin.planning.pipeline import (
    default_shortcuts,
    order_motions,
    plan_in_slots,
    plan_in_turns,
    planned_shortcuts,
    shorten,
)
from twin.run.run_record import Policy, Run
from twin.run.summary import lower_bound_s
from twin.scenario.sections.scenario import Scenario
from twin.trial.trial import execute

SEQUENTIAL = "sequential"
SYNCHRONOUS = "synchronous"
SYNCHRONOUS_TPG = "synchronous + TPG"
SYNCHRONOUS_SHORTCUT = "synchronous + TPG + shortcut"
ASYNCHRONOUS = "asynchronous"
ASYNCHRONOUS_SHORTCUT = "asynchronous + shortcut"

COMPARED = (
    SEQUENTIAL,
    SYNCHRONOUS,
    SYNCHRONOUS_TPG,
    SYNCHRONOUS_SHORTCUT,
    ASYNCHRONOUS,
    ASYNCHRONOUS_SHORTCUT,
)
"""Names of what is compared, in the order of tables and charts."""

SEEDS = "seeds"
"""Name of the stage that counts seeds, for progress displays."""

BASELINES = (SEQUENTIAL, SYNCHRONOUS)
"""Those that others are measured against."""


@dataclass(frozen=True)
class Measurement:
    """Measured figures of one policy with one seed.

    Attributes:
        makespan_s: end of the last node [s].
        wait_s: waits of all robots, each until its own last node is complete [s].
        planning_s: wall-clock seconds of each stage that the policy needs.
        straight_line_s: time of the robot with most to do if it never waited and all its
            transits were straight joint lines [s]; see ``comparison_bounds.straight_line_s``.
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


Rows = Mapping[int, Mapping[str, Measurement]]
"""Measurements of all policies, by seed and policy."""


def shortcut_budget(scenario: Scenario) -> int:
    """Return the default number of shortcut candidates: the scenario's, or by its size."""
    return planned_shortcuts(scenario) or default_shortcuts(scenario)


def compare_policies(
    scenario: Scenario,
    seeds: Sequence[int],
    *,
    candidates: int,
    base: Path = Path(),
    progress: Report = report_nothing,
) -> Rows:
    """Plan a scenario with every seed and execute the plan under every policy.

    Args:
        scenario: a checked scenario; its own policy, coordination and shortcuts do not matter.
        seeds: of plans and draws.
        candidates: shortcuts tried on each plan.
        base: where relative paths of the scenario start.
        progress: told how far each stage has come.

    Raises:
        TwinError: a seed cannot be planned; see ``plan_scenario``.
    """
    rows = {}
    for k, seed in enumerate(seeds):
        progress(SEEDS, k, len(seeds))
        rows[seed] = measure_policies(
            scenario, seed, candidates=candidates, base=base, progress=progress
        )
    progress(SEEDS, len(seeds), len(seeds))
    return rows


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
        scenario: a checked scenario.
        seed: of plan and draws, in place of the scenario's.
        candidates: shortcuts tried on each plan.
        base: where relative paths of the scenario start.
        progress: told how far each stage has come.

    Raises:
        TwinError: it cannot be planned; see ``plan_scenario``.
    """
    scenario = scenario.model_copy(update={"seed": seed})
    watch = StageWatch(progress)
    turns = plan_in_turns(scenario, base, watch)
    bench = _Bench(scenario, base, turns, candidates, progress)

    found = {}
    nodes = build_nodes(turns.motion_plan)
    found[SEQUENTIAL] = bench.measure(SEQUENTIAL, nodes, watch.seconds)

    in_slots = StageWatch(progress)
    slots = plan_in_slots(turns, in_slots)
    of_slots = {**watch.seconds, **in_slots.seconds}
    ordering = StageWatch(progress)
    tpg = order_motions(slots.motion_plan, ordering, slots.slot_of_task)
    # What waits for what in slots follows from the slots: no graph is part of this baseline.
    found[SYNCHRONOUS] = bench.measure(SYNCHRONOUS, tpg, of_slots)
    of_slots = {**of_slots, **ordering.seconds}
    found[SYNCHRONOUS_TPG] = bench.measure(SYNCHRONOUS_TPG, tpg, of_slots)
    found[SYNCHRONOUS_SHORTCUT] = bench.measure_shortened(
        SYNCHRONOUS_SHORTCUT, tpg, of_slots
    )

    ordering = StageWatch(progress)
    tpg = order_motions(turns.motion_plan, ordering)
    of_turns = {**watch.seconds, **ordering.seconds}
    found[ASYNCHRONOUS] = bench.measure(ASYNCHRONOUS, tpg, of_turns)
    found[ASYNCHRONOUS_SHORTCUT] = bench.measure_shortened(
        ASYNCHRONOUS_SHORTCUT, tpg, of_turns
    )
    return found


@dataclass(frozen=True)
class _Bench:
    """Executes plans of one seed and takes their measure."""

    scenario: Scenario
    base: Path
    turns: PlannedMotions
    candidates: int
    progress: Report

    def measure(
        self, name: str, tpg: TemporalPlanGraph, planning_s: Mapping[str, float]
    ) -> Measurement:
        """Execute a plan."""
        policy: Policy = "asynchronous"
        if name in BASELINES:
            policy = "sequential" if name == SEQUENTIAL else "synchronous"
        run = execute(self.scenario, tpg, self.base, policy)
        speeds = self.turns.settings.speeds
        merged = name in (SYNCHRONOUS_SHORTCUT, ASYNCHRONOUS_SHORTCUT)
        return Measurement(
            makespan_s=run.makespan_s,
            wait_s=total_wait_s(run),
            planning_s=dict(planning_s),
            straight_line_s=straight_line_s(tpg, run, speeds, past_home=merged),
            critical_path_s=lower_bound_s(tpg, run),
            straight_line_ratio=straight_line_ratio(tpg, run, speeds)
            if name in BASELINES
            else None,
            nodes=sum(len(chain) for chain in tpg.chains),
            type2_edges=len(tpg.edges),
        )

    def measure_shortened(
        self, name: str, tpg: TemporalPlanGraph, planning_s: Mapping[str, float]
    ) -> Measurement:
        """Take shortcuts and execute what comes of it."""
        watch = StageWatch(self.progress)
        shorter = shorten(
            tpg,
            self.turns.settings,
            watch,
            candidates=self.candidates,
            seed=self.scenario.seed,
        )
        return self.measure(name, shorter, {**planning_s, **watch.seconds})


def total_wait_s(run: Run) -> float:
    """Return the waits of all robots, each until its own last node is complete [s]."""
    return sum(run.wait_ns(k) for k in range(len(run.end_ns))) / NANOSECONDS
