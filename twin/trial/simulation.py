"""How a plan is executed: durations, policy, messages, disturbances; what is known before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planning.errors import ScenarioError
from scheduling.graph.plan_files import plan_sha256
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.slowed_motions import overloads
from twin.audit.worlds.engine import Engine
from twin.durations import packaged_timings
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.planning.kind import assembly_kind
from twin.recorders.observers import Recorder
from twin.run.run_record import DeadlockError, ExecutionRecord, Policy
from twin.run.summary import summarise
from twin.run.throughput import line_summary
from twin.scenario.file import load_scenario
from twin.scenario.manifest import MANIFEST, manifest_base, read_manifest
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult
from twin.uncertainty.skill_durations import SkillDurations


def scenario_execution(
    scenario: Scenario,
    base: Path = Path(),
    *,
    policy: Policy | None = None,
    antithetic: bool = False,
) -> ExecutionModel:
    """Return the execution model of a scenario.

    Args:
        scenario: durations, disturbances, messages and policy are taken from it.
        base: where relative paths of the scenario start.
        policy: in place of the scenario's.
        antithetic: draw replications in mirrored pairs, see SkillDurations.

    Raises:
        ScenarioError: a file of measured times cannot be read.
    """
    execution = scenario.execution
    robots = tuple(robot.name for robot in scenario.cell.robots)
    return ExecutionModel(
        durations=skill_durations(scenario, base, antithetic=antithetic),
        policy=policy or execution.policy,
        messages=Messages.of_seconds(
            execution.queue_depth, execution.report_s, execution.release_s
        ),
        disturbances=execution.disturbances(robots, base),
    )


def doubts_about_stalls(scenario: Scenario, tpg: TemporalPlanGraph) -> tuple[str, ...]:
    """Return what is said of stalls that are asked for and cannot all happen.

    A robot or machine stalls at most once a node, so that more stalls than nodes are not executed.
    """
    found = []
    for chain in tpg.chains:
        own, who = scenario.execution.stalls, "robot"
        if tpg.cell.is_machine(chain.robot):
            own, who = scenario.execution.of_machine(chain.robot).stalls, "machine"
        if own.count_per_robot > len(chain):
            found.append(
                f"stalls.count_per_robot is {own.count_per_robot}, but {who} {chain.robot!r} has"
                f" {len(chain)} nodes and stalls once at each of them"
            )
    return tuple(found)


def followed_execution(
    folder: Path, tpg: TemporalPlanGraph, scenario: Path | None = None
) -> tuple[str, ExecutionModel]:
    """Return the execution model of a followed run, and the name of its scenario.

    Args:
        folder: of the plan; its manifest says, where there is one.
        tpg: the plan.
        scenario: scenario file that says it instead.

    Raises:
        InvalidScenarioError: the scenario file is not valid.
        ScenarioError: it is for other robots.
        OutputError: the manifest is damaged.
    """
    if scenario is not None:
        found, base = load_scenario(scenario), scenario.parent
    elif (folder / MANIFEST).exists():
        found, content = read_manifest(folder, "run to follow")
        base = manifest_base(folder, content)
    else:
        return folder.name, ExecutionModel(SkillDurations(packaged_timings()))
    names = tuple(robot.name for robot in found.cell.robots)
    planned = tuple(robot.name for robot in tpg.cell.robots)
    if names != planned:
        raise ScenarioError(
            f"the plan in {folder} is for robots {', '.join(planned)}, scenario"
            f" {found.name!r} for {', '.join(names)}"
        )
    return found.name, scenario_execution(found, base)


def skill_durations(
    scenario: Scenario, folder: Path = Path(), *, antithetic: bool = False
) -> SkillDurations:
    """Return the durations of all skills, with the exceptions for robots and objects.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start, that of its file.
        antithetic: draw replications in mirrored pairs, see SkillDurations.

    Raises:
        ScenarioError: a file of measured times cannot be read.
    """
    execution = scenario.execution
    machines, tools = (
        [
            item.model_copy(update={"duration": item.duration.located(folder)})
            for item in given
        ]
        for given in (
            assembly_kind(scenario.assembly).machine_durations(),
            scenario.tool_durations,
        )
    )
    return SkillDurations(
        execution.skill_models(folder),
        (*tools, *execution.skill_exceptions(folder), *machines),
        antithetic,
    )


def execute(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    base: Path,
    policy: Policy | None = None,
    *,
    recorders: tuple[Recorder, ...] = (),
) -> ExecutionRecord:
    """Execute a plan once, with the draws that the scenario's seed names.

    Args:
        scenario: seed, durations and disturbances are taken from it.
        tpg: the plan.
        base: where relative paths of the scenario start.
        policy: how nodes are released; by default as the scenario says.
        recorders: told of every event.

    Raises:
        DeadlockError: no robot could go on.
    """
    model = scenario_execution(scenario, base, policy=policy)
    return Simulator(tpg, model).run(seed=scenario.seed, recorders=recorders)


@dataclass(frozen=True)
class Preparation:
    """Facts known before a run that its conclusion needs, also after a kill.

    Attributes:
        recording: whether ``run.rrd`` is wanted.
        audit: whether the audit is to check what was executed; an engine says with what.
        planning_s: wall-clock seconds of the planning stages.
        makespan_sequential_s: makespan of the plan in turns, one task after another [s].
        plan_sha256: hash of the plan.
        warnings: what the check before planning found doubtful.
        plan: which plan it is: a plan of twin.run.policies.
        turns_sha256: hash of the plan in turns, where it is another one.
        load_bound_s: makespan that no choice of who does what can beat, where it is known [s].
        step_order: numbers that the steps had before they were put into another order.
    """

    recording: bool
    audit: bool | Engine
    planning_s: Mapping[str, float]
    makespan_sequential_s: float | None
    plan_sha256: str
    plan: str
    turns_sha256: str | None
    warnings: Sequence[str] = ()
    load_bound_s: float | None = None
    step_order: Sequence[int] = ()


def prepare(
    plan: PlanResult, *, recording: bool = False, audit: bool | Engine = False
) -> Preparation:
    """Return what is known before a run.

    Args:
        plan: what is to be executed.
        recording: whether ``run.rrd`` is wanted.
        audit: whether the audit is to check what was executed; an engine says with what.
    """
    return Preparation(
        recording=recording,
        audit=audit,
        planning_s=dict(plan.planning_s),
        makespan_sequential_s=_sequential_s(plan),
        plan_sha256=plan_sha256(plan.tpg),
        warnings=(
            *plan.warnings,
            *doubts_about_stalls(plan.scenario.sections, plan.tpg),
            *overloads(plan.tpg),
        ),
        plan=plan.name,
        turns_sha256=None if plan.turns is None else plan_sha256(plan.turns),
        load_bound_s=plan.load_bound_s,
        step_order=plan.step_order,
    )


def _sequential_s(plan: PlanResult) -> float | None:
    """Return the makespan of one task at a time [s], None where that comes to no end."""
    case = plan.scenario
    tpg = plan.turns or plan.tpg
    try:
        baseline = execute(case.sections, tpg, case.folder, "sequential")
    except DeadlockError:
        return None
    return baseline.makespan_s if baseline.outcome == "completed" else None


def figures(
    plan: PlanResult,
    record: ExecutionRecord,
    about: Preparation,
    audit: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the figures of a run that has come to its end, with the keys of ``summary.json``.

    Args:
        plan: what was executed.
        record: how it was executed.
        about: what was known before.
        audit: what the audit found, None where there was none.
    """
    tpg, scenario = plan.tpg, plan.scenario.sections
    completed = record.outcome == "completed"
    found = summarise(
        tpg,
        record,
        scenario=scenario.name,
        plan=about.plan,
        planning_s=about.planning_s,
        audit=audit,
        makespan_sequential_s=about.makespan_sequential_s if completed else None,
        warnings=about.warnings,
        line=line_summary(tpg, record, *assembly_kind(scenario.assembly).due()),
    )
    found["load_bound_s"] = about.load_bound_s
    found["step_order"] = list(about.step_order) or None
    return found
