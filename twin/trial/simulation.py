"""How a plan is executed: durations, policy, messages, disturbances; what is known before and after."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from planning.errors import ScenarioError
from scheduling.graph.plan_files import plan_sha256
from scheduling.graph.task_edges import idle_robots
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.pace import overloads
from twin.audit.worlds.engines import Engine
from twin.durations.measured import packaged_timings
from twin.engine.bulk.bulk_engine import held_back
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.planning.idle_robots import IdleRobot
from twin.planning.kind import assembly_kind
from twin.reading.scenario_file import load_scenario
from twin.recorders.observers import Recorder
from twin.run.events import DeadlockError, ExecutionRecord, Policy
from twin.run.policies import SHORTENED
from twin.run.summary import Preparation, summarise
from twin.run.windows import window_doubts
from twin.scenario.manifest import MANIFEST, manifest_base, read_manifest
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult
from twin.uncertainty.skill_durations import SkillDurations
from twin.uncertainty.speed_override import unreached_speeds


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
    disturbances = execution.disturbances(robots, base)
    misses = assembly_kind(scenario.assembly).place_misses(scenario, base)
    return ExecutionModel(
        durations=skill_durations(scenario, base, antithetic=antithetic),
        policy=policy or execution.policy,
        messages=Messages.of_seconds(
            execution.queue_depth, execution.report_s, execution.release_s
        ),
        disturbances=disturbances.with_misses("place-down", misses),
        hold=execution.windows.hold,
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


def doubts_about_windows(
    scenario: Scenario, tpg: TemporalPlanGraph, base: Path
) -> tuple[str, ...]:
    """Return which windows of time a plan does not keep at nominal times, and by how much."""
    if not any(window.most is not None for window in tpg.windows):
        return ()
    model = scenario_execution(scenario, base)
    held = held_back(tpg, model)
    nominal = ExecutionModel(SkillDurations({}), model.policy, model.messages)
    try:
        run = Simulator(held, nominal).run(seed=scenario.seed)
    except DeadlockError:
        return ()
    return tuple(window_doubts(tpg, run, held=held is not tpg))


def _unreached_speeds(plan: PlanResult) -> tuple[str, ...]:
    """Return which speed factors the limits of robots do not allow; see ``unreached_speeds``."""
    case = plan.scenario
    disturbances = case.sections.execution.disturbances(case.robots, case.folder)
    return unreached_speeds(plan.tpg, disturbances, case.sections.seed)


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
        [item.located(folder) for item in given]
        for given in (
            assembly_kind(scenario.assembly).machine_durations(),
            scenario.tool_durations,
        )
    )
    return SkillDurations(
        execution.skill_models(folder),
        (*tools, *execution.skill_exceptions(folder), *machines),
        antithetic,
        {key: model.located(folder) for key, model in scenario.actuations.items()},
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
    held = held_back(tpg, model)
    return Simulator(held, model).run(seed=scenario.seed, recorders=recorders)


def prepare(
    plan: PlanResult,
    *,
    recording: bool = False,
    audit: bool | Engine = False,
    operated: bool = False,
) -> Preparation:
    """Return what is known before a run.

    Args:
        plan: what is to be executed.
        recording: whether ``run.rrd`` is wanted.
        audit: whether the audit is to check what was executed; an engine says with what.
        operated: whether what fails is planned anew.
    """
    known = {own.robot: own for own in plan.idle}
    idle = [known.get(k, IdleRobot(k, "unknown")) for k in idle_robots(plan.tpg)]
    # Of a plan of first steps, later ones may be for it.
    windowed = operated and plan.scenario.sections.execution.window is not None
    return Preparation(
        operated=operated,
        recording=recording,
        audit=audit,
        planning_s=dict(plan.planning_s),
        makespan_sequential_s=_makespan_s(plan, plan.turns or plan.tpg, "sequential"),
        plan_sha256=plan_sha256(plan.tpg),
        warnings=(
            *plan.warnings,
            *doubts_about_stalls(plan.scenario.sections, plan.tpg),
            *doubts_about_windows(
                plan.scenario.sections, plan.tpg, plan.scenario.folder
            ),
            *overloads(plan.tpg),
            *_unreached_speeds(plan),
            *(own.message for own in idle if not windowed),
        ),
        checks_off=plan.scenario.sections.checks_off,
        fits=plan.fits,
        idle={own.robot: own.content() for own in idle},
        plan=plan.name,
        turns_sha256=None if plan.turns is None else plan_sha256(plan.turns),
        load_bound_s=plan.load_bound_s,
        # What is left of the plan in turns beside one in slots does not say what waits for what.
        makespan_asynchronous_s=None
        if plan.turns is None or plan.name != SHORTENED
        else _makespan_s(plan, plan.turns, "asynchronous"),
    )


def _makespan_s(
    plan: PlanResult, tpg: TemporalPlanGraph, policy: Policy
) -> float | None:
    """Return the makespan of a plan under a policy [s], None where that comes to no end."""
    case = plan.scenario
    try:
        baseline = execute(case.sections, tpg, case.folder, policy)
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
    scenario = plan.scenario.sections
    due = assembly_kind(scenario.assembly).due()
    return summarise(plan.tpg, record, scenario.name, about, audit, *due)
