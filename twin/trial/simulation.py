"""Simulation of a plan: the execution model (durations, policy, disturbances), and one execution with it."""

from __future__ import annotations

from pathlib import Path

from planning.tasks.task import TaskKind
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.engine.model_holds import with_model_holds
from twin.planning.miss_probabilities import miss_probabilities
from twin.recorders.observers import Recorder
from twin.runs.execution_record import ExecutionRecord, Policy
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario
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
        policy: policy in place of the scenario's.
        antithetic: draw replications in mirrored pairs, see SkillDurations.

    Raises:
        ScenarioError: a file of measured times cannot be read.
    """
    execution = scenario.execution
    robots = tuple(robot.name for robot in scenario.cell.robots)
    disturbances = execution.disturbances(robots, base)
    misses = miss_probabilities(scenario, base)
    return ExecutionModel(
        durations=skill_durations(scenario, base, antithetic=antithetic),
        policy=policy or execution.policy,
        messages=Messages.of_seconds(
            execution.queue_depth, execution.report_s, execution.release_s
        ),
        disturbances=disturbances.with_misses("place-down", misses),
        hold=execution.windows.hold,
    )


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
    models, remove = execution.skill_models(folder), execution.recovery.remove
    if remove is not None:
        models[TaskKind.TAKEN_OUT] = remove.located(folder)
    return SkillDurations(
        models,
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
    """Execute a plan once, with random draws from the scenario's seed.

    Args:
        scenario: seed, durations and disturbances are taken from it.
        tpg: the plan.
        base: where relative paths of the scenario start.
        policy: how nodes are released; by default as the scenario says.
        recorders: receive every event.

    Raises:
        DeadlockError: no robot could continue.
    """
    model = scenario_execution(scenario, base, policy=policy)
    held = with_model_holds(tpg, model)
    return Simulator(held, model).run(seed=scenario.seed, recorders=recorders)
