"""Assumptions of a study for its report: times, speeds, disturbances, replications and versions."""

from __future__ import annotations

from collections.abc import Iterator

from twin.checks.finding import CheckContext
from twin.checks.robots import check_skill_times, check_speeds
from twin.durations.measured import Packaged
from twin.durations.model import DurationModel
from twin.host.versions import versions
from twin.planning.miss_probabilities import miss_probabilities
from twin.scenario.sections.execution import ExecutionSection, ReferenceDuration
from twin.studies.study import StudyResult
from twin.uncertainty.disturbances import MachineBreakdowns, Stalls


def assumptions(result: StudyResult) -> Iterator[tuple[str, str]]:
    """Yield the subject and the assumptions of a study."""
    request = result.request
    experiment, scenario = request.experiment, request.scenario
    yield "Times of skills", "; ".join(_skills(result)) or "none: there are no skills"
    if result.raised_skills:
        yield (
            "Too short for the joints",
            f"{result.raised_skills} skills of replication 0 are drawn shorter than the joints' speed"
            " limits allow, and take what these allow.",
        )
    yield "Times of motions", _motions(result)
    yield "Disturbances", "; ".join(_disturbances(scenario.execution)) or "none"
    misses = "; ".join(
        f"{name.replace('/', ' misses the place of ')} in {100 * p:.3g} % of attempts"
        for name, p in miss_probabilities(scenario, request.base).items()
    )
    if misses:
        yield "Repeatability of robots", misses
    messages = _messages(scenario.execution)
    if messages:
        yield "Messages", messages
    for key in experiment.variants[0]:
        values = dict.fromkeys(str(variant[key]) for variant in experiment.variants)
        yield f"Varied: {key}", ", ".join(values)
    counts = dict.fromkeys(str(cell.replications) for cell in result.summary.cells)
    how = "in mirrored pairs" if experiment.antithetic else "independent of each other"
    yield (
        "Replications",
        f"{' or '.join(counts)} of each policy and variant, {how}; all of them see the same draws,"
        f" seed {scenario.seed}",
    )
    yield (
        "Plan",
        f"that of the run in {request.plan}"
        if request.plan
        else f"made for this study, with {request.candidates} candidates for shortcuts",
    )
    yield "Made with", ", ".join(f"{k} {v}" for k, v in versions().items())


def warnings(subject: CheckContext) -> list[str]:
    """Return warnings of ``twin check`` about the assumed durations."""
    found = [*check_skill_times(subject), *check_speeds(subject)]
    return [f"{'.'.join(map(str, item.at))}: {item.message}" for item in found]


def _skills(result: StudyResult) -> Iterator[str]:
    """Yield the durations of the plan's skills, equal ones grouped."""
    execution = result.request.scenario.execution
    kinds = {task.kind for load in result.loads for task in load.tpg.tasks}
    located = execution.skill_models(result.request.base)
    packaged, reference, own = [], [], []
    for skill, section in execution.skills.items():
        if skill not in kinds:
            continue
        if isinstance(section, ReferenceDuration):
            reference.append(skill)
        elif isinstance(section, Packaged):
            packaged.append(f"{skill} {located[skill].mean:.2f} s")
        else:
            own.append(f"{skill} {located[skill].mean:.2f} s ({_model(section)})")
    if packaged:
        yield (
            "the packaged, synthetic times of a LEGO tool with force control:"
            f" {', '.join(packaged)} in the mean"
        )
    if own:
        yield f"as the scenario says: {', '.join(own)} in the mean"
    if reference:
        yield f"as long as their reference paths: {', '.join(reference)}"
    base = result.request.base
    tools = [
        f"{item.skill} of {item.object} {item.duration.located(base).mean:.2f} s"
        for item in result.request.scenario.tool_durations
        if item.skill in kinds
    ]
    timed = result.request.scenario.actuations
    acts = {
        f"{a.act} {timed[a.key].located(base).mean:.2f} s"
        for load in result.loads
        for task in load.tpg.tasks
        for a in task.actuations
        if task.kind not in located and a.key in timed
    }
    if acts:
        yield f"in parts: motions, and tools {', '.join(sorted(acts))} in the mean"
    if tools:
        yield f"as the racks of tools say: {', '.join(tools)} in the mean"
    if execution.skill_overrides:
        yield f"{len(execution.skill_overrides)} exceptions for robots or objects"


def _model(model: DurationModel) -> str:
    """Return the fields of a distribution that are given."""
    fields = model.model_dump(mode="json", exclude_defaults=True)
    kind = fields.pop("kind", type(model).__name__.lower())
    given = ", ".join(f"{key} {value}" for key, value in fields.items())
    return f"{kind}, {given}" if given else str(kind)


def _motions(result: StudyResult) -> str:
    scenario = result.request.scenario
    model = scenario.speed_model
    if model == "limits":
        return (
            "planned and executed with each joint within its limits of speed, acceleration and jerk"
            " (speed_model limits)"
        )
    if model == "joint" or CheckContext(scenario, result.request.base).kind.space_time:
        speed = "each joint within its own speed limit (speed_model joint)"
    else:
        speed = (
            f"joint speeds that add up to {scenario.planning.l1_rad_s:g} rad/s, none beyond its own"
            " limit (speed_model l1)"
        )
    return f"planned with {speed}; joints have no limit of acceleration"


def _disturbances(own: ExecutionSection) -> Iterator[str]:
    """Yield descriptions of a scenario's disturbances."""
    if own.speed.factor is not None:
        yield f"speed factor of all robots {_model(own.speed.factor.model)}"
    for robot, factor in own.speed.robots.items():
        yield f"speed factor of {robot} {_model(factor.model)}"
    if own.jitter is not None:
        yield f"jitter of every node {_model(own.jitter)}"
    yield from _stalls(own.stalls, "a robot", "a robot")
    if own.breakdowns is not None:
        who = ", ".join(own.breakdowns.robots or ("every robot",))
        yield _breakdowns(own.breakdowns, who)
    for name, machine in own.machines.items():
        if machine.breakdowns is not None:
            yield _breakdowns(machine.breakdowns, name)
        yield from _stalls(machine.stalls, name, f"of {name}")
    for skill, failure in own.failures.items():
        yield (
            f"{100 * failure.probability:g} % of attempts at {skill} fail, {failure.retries}"
            " retries"
        )
        for part, own_share in failure.parts.items():
            yield f"{100 * own_share:.3g} % of attempts at {skill} with {part} fail"
    for stop in own.emergency_stops:
        who = stop.robot or "every robot"
        yield f"emergency stop of {who} at {stop.at_s:g} s for {stop.duration_s:g} s"
    for planned in own.planned_stops:
        who = ", ".join(planned.who or ("all",))
        again = "" if planned.every_s is None else f", every {planned.every_s:g} s"
        yield f"planned stop of {who} at {planned.at_s:g} s for {planned.duration_s:g} s{again}"
    if own.calendar is not None:
        for shift in own.calendar.shifts:
            days, who = ", ".join(shift.days), ", ".join(shift.who or ("all",))
            yield f"shift of {who} on {days} from {shift.start} to {shift.end}; begins {own.calendar.begins}"


def _stalls(stalls: Stalls, who: str, each: str) -> Iterator[str]:
    length = _model(stalls.model)
    if stalls.rate_per_h:
        yield f"{stalls.rate_per_h:g} stalls an hour of {who}'s work, each {length}"
    if stalls.count_per_robot:
        yield f"{stalls.count_per_robot} stalls {each}, each {length}"


def _breakdowns(breaks: MachineBreakdowns, who: str) -> str:
    if breaks.mtbf_s is not None and breaks.mttr_s is not None:
        return (
            f"breakdowns of {who} every {breaks.mtbf_s:g} s of {breaks.clock} time, repaired in"
            f" {breaks.mttr_s:g} s (means)"
        )
    return (
        f"breakdowns of {who} after {breaks.clock} time {_model(breaks.between)}, repaired in"
        f" {_model(breaks.repair)}"
    )


def _messages(own: ExecutionSection) -> str:
    if not (own.report_s or own.release_s):
        return ""
    ahead = "" if own.queue_depth is None else f", {own.queue_depth} nodes given ahead"
    return f"{own.report_s:g} s from a robot to the dispatcher, {own.release_s:g} s back{ahead}"
