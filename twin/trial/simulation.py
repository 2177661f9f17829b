"""From a scenario and its plan to a simulator."""

from __future__ import annotations

from pathlib import Path

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.engine.engine import Simulator
from twin.engine.messages import Messages
from twin.run.run_record import Policy
from twin.scenario.disturbance_models import scenario_disturbances
from twin.scenario.duration_models import skill_durations
from twin.scenario.sections.execution import ExecutionSection
from twin.scenario.sections.scenario import Scenario


def scenario_simulator(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    base: Path = Path(),
    *,
    policy: Policy | None = None,
) -> Simulator:
    """Return what executes a plan as a scenario says.

    Args:
        scenario: durations, disturbances, messages and policy are taken from it.
        tpg: the plan.
        base: where relative paths of the scenario start.
        policy: in place of the scenario's.

    Raises:
        ScenarioError: a file of measured times cannot be read.
    """
    execution = scenario.execution
    robots = tuple(robot.name for robot in scenario.cell.robots)
    return Simulator(
        tpg,
        skill_durations(scenario, base),
        policy=policy or execution.policy,
        messages=scenario_messages(execution),
        disturbances=scenario_disturbances(execution, robots, base),
    )


def scenario_messages(execution: ExecutionSection) -> Messages:
    """Return how robots and dispatcher talk according to a scenario."""
    return Messages.of_seconds(
        execution.queue_depth, execution.report_s, execution.release_s
    )
