"""From the execution section of a scenario to the disturbances that can be drawn from."""

from __future__ import annotations

from pathlib import Path

from planning.errors import ScenarioError
from twin.durations import DurationModel, Fixed, Lognormal, Uniform
from twin.scenario.duration_models import duration_model
from twin.scenario.sections.disturbances import (
    FactorSection,
    FixedFactor,
    StallsSection,
    UniformFactor,
)
from twin.scenario.sections.durations import DurationSection
from twin.scenario.sections.execution import ExecutionSection
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    RandomStalls,
    SkillFailure,
    StallRate,
)


def scenario_disturbances(
    execution: ExecutionSection, robots: tuple[str, ...], folder: Path = Path()
) -> Disturbances:
    """Return what may go wrong according to a scenario.

    Args:
        execution: the section of a checked scenario.
        robots: all robots of the cell.
        folder: where relative paths in the scenario start, that of its file.

    Raises:
        ScenarioError: a file of measured times cannot be read, or there is no such robot.
    """
    broken = execution.breakdowns
    named = [*execution.speed.robots, *((broken and broken.robots) or ())]
    named += [stop.robot for stop in execution.emergency_stops if stop.robot]
    for name in named:
        if name not in robots:
            raise ScenarioError(f"disturbances: no robot {name!r}", choices=robots)
    return Disturbances(
        speed=_speeds(execution, robots),
        jitter=_model(execution.jitter, folder),
        stalls=_counted_stalls(execution.stalls, folder),
        stall_rate=_stall_rate(execution.stalls, folder),
        breakdowns=None
        if broken is None
        else Breakdowns(broken.mtbf_s, broken.mttr_s, broken.clock, broken.robots),
        failures={
            skill: SkillFailure(
                section.probability,
                section.retries,
                _model(section.retry, folder),
            )
            for skill, section in execution.failures.items()
        },
        emergency_stops=tuple(
            EmergencyStop(stop.robot, stop.at_s, stop.duration_s)
            for stop in execution.emergency_stops
        ),
    )


def needs_event_engine(execution: ExecutionSection) -> list[str]:
    """Say why only the event engine can run a scenario; nothing when any engine can.

    Completion times are longest paths in the graph only if messages take no time (then the
    depth of the queues makes no difference) and nothing happens at times of the run's clock.
    Policies and tasks that fail for good are left to the caller.
    """
    reasons = []
    latencies = {
        "report_latency_s": execution.report_latency_s,
        "release_latency_s": execution.release_latency_s,
    }
    for key, own in latencies.items():
        value = execution.latency_s if own is None else own
        if value > 0:
            name = "latency_s" if own is None else key
            reason = f"{name} is {value:g}: messages take time"
            if reason not in reasons:
                reasons.append(reason)
    if execution.emergency_stops:
        reasons.append("emergency_stops happen at times of the run's clock")
    if execution.breakdowns is not None and execution.breakdowns.clock == "run":
        reasons.append("breakdowns happen at times of the run's clock")
    return reasons


def _speeds(
    execution: ExecutionSection, robots: tuple[str, ...]
) -> dict[str, DurationModel]:
    found: dict[str, DurationModel] = {}
    for robot in robots:
        section = execution.speed.robots.get(robot, execution.speed.factor)
        if section is not None:
            found[robot] = _factor(section)
    return found


def _factor(section: FactorSection) -> DurationModel:
    """Return the distribution of a factor: the models do not care what their unit is."""
    if isinstance(section, FixedFactor):
        return Fixed(section.value)
    if isinstance(section, UniformFactor):
        return Uniform(section.low, section.high)
    return Lognormal(section.median, section.p95)


def _model(section: DurationSection | None, folder: Path) -> DurationModel | None:
    return None if section is None else duration_model(section, folder)


def _counted_stalls(section: StallsSection, folder: Path) -> RandomStalls | None:
    if section.count_per_robot == 0:
        return None
    low, high = section.duration_s
    model = _model(section.duration, folder)
    return RandomStalls(section.count_per_robot, (low, high), model)


def _stall_rate(section: StallsSection, folder: Path) -> StallRate | None:
    if section.rate_per_h == 0:
        return None
    model = _model(section.duration, folder) or Uniform(*section.duration_s)
    return StallRate(section.rate_per_h, model)
