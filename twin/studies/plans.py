"""Plans of a study for one or several cell layouts, and the workloads (simulation inputs) of its replications."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from planning.errors import RequestError, ScenarioError, TwinError, join_lines
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import is_driven
from scheduling.planned_motions import PlannedMotions
from twin.checks.check import check_scenario
from twin.document.validation import parse_document
from twin.engine.execution_model import ExecutionModel
from twin.engine.model_holds import with_model_holds
from twin.host.progress import Report
from twin.host.versions import versions
from twin.operations.replicated.operating import OperatingWorkload
from twin.planning.pipeline import default_shortcuts, planned_shortcuts
from twin.reading.checks import find_problems
from twin.runs.policies import (
    ASYNCHRONOUS,
    ASYNCHRONOUS_SHORTCUTS,
    AT_ONCE,
    IN_SLOTS,
    IN_TURNS,
    SEQUENTIAL,
    SHORTENED,
    SLOTS_SHORTENED,
    named_policies,
    plan_folder,
    policy_name,
)
from twin.scenario.manifest import file_hashes, scenario_sha256
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario, resolve_scenario
from twin.scenario.variations import Variant, apply_variation, layout_of
from twin.studies.folder import RefusedLayout, StudyRequest
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.timing_graph import timing_graph
from twin.studies.replications.workload import Workload
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_until_final
from twin.trial.simulation import scenario_execution
from twin.uncertainty.skill_durations import nominal_ns
from twin.uncertainty.stop_times import NEVER, draw_stops

Plans = Mapping[str, TemporalPlanGraph]
"""Plans by their names in twin.runs.policies; those of several layouts by plan_key."""

LAYOUTS = "layouts planned"
"""Name of the stage for progress displays."""


def default_policies(scenario: Scenario) -> tuple[str, ...]:
    """Return the default policies of a study: that of a run, and its baselines."""
    if scenario.planning.coordination == "synchronous":
        plan = SLOTS_SHORTENED if planned_shortcuts(scenario) else IN_SLOTS
    else:
        plan = SHORTENED if planned_shortcuts(scenario) else IN_TURNS
    own = policy_name(plan, scenario.execution.policy)
    if own not in named_policies():
        own = ASYNCHRONOUS
    return with_baselines(own)


def with_baselines(policy: str) -> tuple[str, ...]:
    """Return a policy after its default baselines.

    That is one task at a time; one with shortcuts is compared with the same motions without them, too.
    """
    plain = (ASYNCHRONOUS,) if policy == ASYNCHRONOUS_SHORTCUTS else ()
    return tuple(dict.fromkeys((SEQUENTIAL, *plain, policy)))


def shortcut_budget(scenario: Scenario) -> int:
    """Return the default number of shortcut candidates: the scenario's, or by its size."""
    return planned_shortcuts(scenario) or default_shortcuts(scenario)


def require_no_machines(scenario: Scenario) -> None:
    """Refuse plans in slots of a scenario with machines, with a ScenarioError."""
    if assembly_kind(scenario.assembly).machines():
        raise ScenarioError(
            "no plan in slots can wait for machines, sources and products: study the"
            " scenario with the policies sequential and asynchronous"
        )


def given_plans(given: PlanResult, policies: tuple[str, ...]) -> Plans:
    """Return the plans that policies need, from those of a run.

    Raises:
        RequestError: a policy needs another plan; names those that do not.
    """
    could = possible_policies(given)
    for policy in policies:
        if policy not in could:
            raise RequestError(
                f"policy {policy!r} needs the plan {named_policies()[policy].plan}, the given one is"
                f" {given.name}",
                choices=could,
            )
    there = _plans_of(given)
    return {
        name: there[name]
        for name in dict.fromkeys(named_policies()[policy].plan for policy in policies)
    }


def operated_policies(given: PlanResult) -> tuple[str, ...]:
    """Return the policies under which a plan can be replanned."""
    could = possible_policies(given)
    return tuple(p for p in could if named_policies()[p].release == "asynchronous")


def possible_policies(given: PlanResult) -> tuple[str, ...]:
    """Return the policies under which a run's plan can be studied."""
    there = _plans_of(given)
    # The sequential plan kept next to one in slots has tasks, but no type-2 edges.
    bare = {IN_TURNS} if given.name in (IN_SLOTS, SLOTS_SHORTENED) else set()
    return tuple(
        name
        for name, (plan, release) in named_policies().items()
        if plan in there and (plan not in bare or release == "sequential")
    )


def _plans_of(given: PlanResult) -> Plans:
    variant = IN_TURNS if given.name == AT_ONCE else given.name
    plans = {variant: given.tpg}
    return plans if given.turns is None else {IN_TURNS: given.turns, **plans}


def save_plans(plans: Plans, folder: Path) -> None:
    """Write every plan into a folder of its name."""
    for name, plan in plans.items():
        save_plan(plan, folder / plan_folder(name))


def load_plans(folder: Path, experiment: Experiment) -> Plans:
    """Return the plans of an experiment; OutputError when one is missing."""
    names = dict.fromkeys(
        plan_key(variant, named_policies()[policy].plan)
        for policy, variant in experiment.cells
    )
    return {name: load_plan(folder / plan_folder(name)) for name in names}


def plan_key(variant: Variant, plan: str) -> str:
    """Return the name of a plan among those of all layouts; its own where there is one layout."""
    layout = layout_of(variant)
    if not layout:
        return plan
    digest = hashlib.sha256(json.dumps(layout, sort_keys=True).encode()).hexdigest()
    return f"{digest[:12]}/{plan}"


def plan_hashes(plans: Plans) -> dict[str, str]:
    """Return a hash of every plan, by name."""
    return {name: plan_sha256(plan) for name, plan in plans.items()}


def workloads(
    scenario: Scenario,
    base: Path,
    plans: Plans,
    experiment: Experiment,
    motions: PlannedMotions | None = None,
) -> list[Workload]:
    """Return the work of every cell of an experiment.

    Args:
        scenario: the studied scenario.
        base: where relative paths of the scenario start.
        plans: of all layouts.
        experiment: policies and varied inputs.
        motions: base motions of the plans, with replanning.

    Raises:
        ScenarioError: a varied input does not fit the scenario.
    """
    graphs = {name: timing_graph(plan) for name, plan in plans.items()}
    hashes = plan_hashes(plans)
    files, packages = file_hashes(scenario, base), versions()
    loads = []
    for policy, variant in experiment.cells:
        own = apply_variation(scenario, variant)
        plan, release = named_policies()[policy]
        name = plan_key(variant, plan)
        model = scenario_execution(
            own, base, policy=release, antithetic=experiment.antithetic
        )
        reasons = tuple(own.execution.needs_event_engine())
        operated = None
        if motions is not None:
            fail = tuple(sorted(model.disturbances.failures))
            operated = OperatingWorkload(own, motions, plans[name], fail)
            reasons += tuple(own.execution.describe_unforeseen_events())
            if own.kind.rush_s():
                reasons += ("rush orders come in at times of the run's clock",)
        origin = {
            "scenario": scenario_sha256(resolve_scenario(own)),
            "plan": hashes[name],
            "policy": policy,
            "antithetic": experiment.antithetic,
            "files": files,
            "versions": packages,
            **({} if operated is None else {"operated": True}),
        }
        text = json.dumps(origin, sort_keys=True)
        made_from = hashlib.sha256(text.encode()).hexdigest()
        load = workload(plans[name], model, scenario.seed, graph=graphs[name])
        load = replace(load, reasons=reasons, made_from=made_from, operated=operated)
        known = bool(own.execution.emergency_stops) + own.execution.plans_stops
        if reasons and len(reasons) == known:  # nothing but stops at known times
            load = replace(load, bulk_until_ns=bulk_until_ns(load.tpg, model))
        loads.append(load)
    return loads


def bulk_until_ns(tpg: TemporalPlanGraph, model: ExecutionModel) -> int:
    """Return the begin of the first stop if the plan ends before it as planned, else 0 [ns]."""
    stops = draw_stops(tpg, model.disturbances, seed=0) or ()
    first = min((own.stop_after(0)[0] for own in stops), default=NEVER)
    return first if earliest_times(tpg, nominal_ns(tpg)).makespan < first else 0


def workload(
    plan: TemporalPlanGraph,
    model: ExecutionModel,
    seed: int,
    *,
    graph: TemporalPlanGraph | None = None,
) -> Workload:
    """Return the work of replicating a plan.

    Args:
        plan: with its paths.
        model: execution model, with disturbances.
        seed: names the draws.
        graph: its timing graph, where that is there already.
    """
    graph = timing_graph(plan) if graph is None else graph
    if is_driven(graph) and model.disturbances.at_absolute_times:
        graph = plan  # whom the clock stops in a skill brakes along its path
    held = with_model_holds(graph, model)
    return Workload(held, model, seed, free=None if held is graph else graph)


def distinct(variants: Iterable[Variant]) -> list[Variant]:
    """Return some variants, each once, in order of their first."""
    return list({json.dumps(variant): variant for variant in variants}.values())


def plans_of_layouts(
    request: StudyRequest, progress: Report
) -> tuple[StudyRequest, Plans]:
    """Plan every layout of a study; return infeasible ones separately with the reason.

    Where nothing is varied that a plan depends on there is one layout, and it must have a plan.

    Returns:
        The request with the variants that can be planned, and the layouts that cannot; and the plans of
        all layouts, by plan_key.

    Raises:
        TwinError: the only layout cannot be planned.
        RequestError: there are several, and none can.
    """
    experiment = request.experiment
    wanted = distinct(map(layout_of, experiment.variants))
    if not any(wanted):
        plans = _planned(request, {}, progress)
        return request, {plan_key({}, k): p for k, p in plans.items()}
    found: dict[str, Plans] = {}
    refused = []
    for number, layout in enumerate(wanted):
        progress(LAYOUTS, number, len(wanted))
        try:
            found[json.dumps(layout)] = _planned(request, layout, progress)
        except TwinError as error:
            refused.append(RefusedLayout(layout, join_lines(str(error))))
    progress(LAYOUTS, len(wanted), len(wanted))
    if not found:
        said = "; ".join(f"{words(item.layout)}: {item.reason}" for item in refused)
        raise RequestError(f"no layout can be planned: {said}")
    kept = tuple(v for v in experiment.variants if json.dumps(layout_of(v)) in found)
    plans = {
        plan_key(layout, name): plan
        for layout in distinct(map(layout_of, kept))
        for name, plan in found[json.dumps(layout)].items()
    }
    experiment = replace(experiment, variants=kept)
    return replace(request, experiment=experiment, refused=tuple(refused)), plans


def words(layout: Variant) -> str:
    """Return the values of a layout in one line."""
    return ", ".join(f"{key} = {value}" for key, value in layout.items())


def _planned(request: StudyRequest, layout: Variant, progress: Report) -> Plans:
    """Plan one layout for every policy; problems of its cell raise an error."""
    scenario = apply_variation(request.scenario, layout)
    if layout:
        for message in _errors(scenario, request.base):
            raise RequestError(message)
    names = request.experiment.policies
    wanted = {named_policies()[policy].plan for policy in names}
    if wanted & {IN_SLOTS, SLOTS_SHORTENED}:
        require_no_machines(scenario)
    candidates = request.candidates
    case = LoadedScenario(scenario, request.base)
    made = plan_until_final(
        case, progress=progress, wanted=wanted, candidates=candidates
    )
    return made.plans


def _errors(scenario: Scenario, base: Path) -> Iterator[str]:
    """Yield what makes every plan of a layout impossible or false."""
    for _, message in find_problems(scenario, base):
        yield message
        return
    # Its positions are of no file: only messages are shown.
    text = json.dumps(resolve_scenario(scenario))
    document = parse_document(base / f"{scenario.name}.yaml", text)
    report = check_scenario(scenario, document, base)
    if report.errors:
        yield "; ".join(item.message for item in report.errors)
