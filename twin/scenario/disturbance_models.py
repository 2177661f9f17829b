"""Disturbances of a scenario, and the engine that they take."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from planning.errors import ScenarioError
from twin.scenario.document.yaml_text import KeyPath
from twin.scenario.sections.execution import ExecutionSection
from twin.uncertainty.disturbances import Disturbances


def scenario_disturbances(
    execution: ExecutionSection, robots: tuple[str, ...], folder: Path = Path()
) -> Disturbances:
    """Return the disturbances of a scenario.

    Args:
        execution: the section of a checked scenario.
        robots: all robots of the cell.
        folder: where relative paths in the scenario start, that of its file.

    Raises:
        ScenarioError: a file of measured times cannot be read, or there is no such robot.
    """
    for _, name in named_robots(execution):
        if name not in robots:
            raise ScenarioError(f"disturbances: no robot {name!r}", choices=robots)
    return execution.located(folder)


def named_robots(execution: ExecutionSection) -> Iterator[tuple[KeyPath, str]]:
    """Yield the robots that disturbances happen to, each with its key in the section."""
    for name in execution.speed.robots:
        yield ("speed", "robots", name), name
    if execution.breakdowns is not None:
        for i, name in enumerate(execution.breakdowns.robots or ()):
            yield ("breakdowns", "robots", i), name
    for i, stop in enumerate(execution.emergency_stops):
        if stop.robot is not None:
            yield ("emergency_stops", i, "robot"), stop.robot


def needs_event_engine(execution: ExecutionSection) -> list[str]:
    """Return why only the event engine can run a scenario, empty if any engine can.

    Completion times are longest paths in the graph only if messages take no time (then the
    depth of the queues makes no difference) and nothing happens at times of the run's clock.
    Policies and tasks that fail for good are left to the caller.
    """
    reasons = []
    for key, own, value in (
        ("report_latency_s", execution.report_latency_s, execution.report_s),
        ("release_latency_s", execution.release_latency_s, execution.release_s),
    ):
        name = "latency_s" if own is None else key
        reason = f"{name} is {value:g}: messages take time"
        if value > 0 and reason not in reasons:
            reasons.append(reason)
    if execution.emergency_stops:
        reasons.append("emergency_stops happen at times of the run's clock")
    if execution.breakdowns is not None and execution.breakdowns.clock == "run":
        reasons.append("breakdowns happen at times of the run's clock")
    return reasons
