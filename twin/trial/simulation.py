"""Execution model of a scenario: durations, policy, messages, disturbances."""

from __future__ import annotations

from pathlib import Path

from twin.engine.execution_model import ExecutionModel
from twin.engine.messages import Messages
from twin.run.run_record import Policy
from twin.scenario.disturbance_models import scenario_disturbances
from twin.scenario.duration_models import skill_durations
from twin.scenario.sections.scenario import Scenario


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
        disturbances=scenario_disturbances(execution, robots, base),
    )
