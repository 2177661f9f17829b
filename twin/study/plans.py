"""Plans that a study executes, and the workloads made of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.host.progress import Report, StageWatch
from twin.host.versions import versions
from twin.planning.pipeline import order_motions, plan_in_slots, plan_motions, shorten
from twin.scenario.manifest import file_hashes, scenario_sha256
from twin.scenario.sections.scenario import Scenario, resolved
from twin.scenario.variations import varied
from twin.study.replications.experiment import PLAN_OF_POLICY, Experiment
from twin.study.replications.workload import Workload, timing_graph
from twin.trial.simulation import scenario_execution

TURNS, SLOTS, SHORTENED = "turns", "slots", "shortened"

Plans = Mapping[str, TemporalPlanGraph]
"""Plans by the names that PLAN_OF_POLICY uses."""


def plan_for_study(
    scenario: Scenario,
    base: Path,
    policies: tuple[str, ...],
    *,
    candidates: int,
    progress: Report,
) -> Plans:
    """Make the plans that some policies need, all of the same motions.

    Args:
        scenario: a checked scenario.
        base: where relative paths in it start.
        policies: keys of PLAN_OF_POLICY.
        candidates: shortcuts tried, where a policy takes them.
        progress: told how far each stage has come.

    Raises:
        TwinError: the scenario cannot be planned; see plan_scenario.
    """
    needed = {PLAN_OF_POLICY[policy][0] for policy in policies}
    watch = StageWatch(progress)
    turns = plan_motions(scenario, base, watch)
    plans = {}
    if needed & {TURNS, SHORTENED}:
        plans[TURNS] = order_motions(turns.motion_plan, watch)
    if SHORTENED in needed:
        plans[SHORTENED] = shorten(
            plans[TURNS],
            turns.settings,
            watch,
            candidates=candidates,
            seed=scenario.seed,
        )
    if SLOTS in needed:
        slots = plan_in_slots(turns, watch)
        plans[SLOTS] = order_motions(slots.motion_plan, watch, slots.slot_of_task)
    return {name: plan for name, plan in plans.items() if name in needed}


def save_plans(plans: Plans, folder: Path) -> None:
    """Write every plan into a folder of its name."""
    for name, plan in plans.items():
        save_plan(plan, folder / name)


def load_plans(folder: Path, policies: tuple[str, ...]) -> Plans:
    """Return the plans that some policies need; OutputError when one is missing."""
    needed = dict.fromkeys(PLAN_OF_POLICY[policy][0] for policy in policies)
    return {name: load_plan(folder / name) for name in needed}


def workloads(
    scenario: Scenario, base: Path, plans: Plans, experiment: Experiment
) -> list[Workload]:
    """Return the work of every cell of an experiment.

    Raises:
        ScenarioError: a varied input does not fit the scenario.
    """
    graphs = {name: timing_graph(plan) for name, plan in plans.items()}
    hashes = {name: plan_sha256(plan) for name, plan in plans.items()}
    files, packages = file_hashes(scenario, base), versions()
    loads = []
    for policy, variant in experiment.cells:
        own = varied(scenario, variant)
        plan, release = PLAN_OF_POLICY[policy]
        model = scenario_execution(
            own, base, policy=release, antithetic=experiment.antithetic
        )
        reasons = tuple(own.execution.needs_event_engine())
        origin = {
            "scenario": scenario_sha256(resolved(own)),
            "plan": hashes[plan],
            "policy": policy,
            "antithetic": experiment.antithetic,
            "files": files,
            "versions": packages,
        }
        text = json.dumps(origin, sort_keys=True)
        made_from = hashlib.sha256(text.encode()).hexdigest()
        loads.append(Workload(graphs[plan], model, own.seed, reasons, made_from))
    return loads
