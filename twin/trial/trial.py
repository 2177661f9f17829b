"""One trial of a plan: execute it in the twin, keep what happened, let the audit judge it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planning.errors import OutputError, TwinError
from planning.files import read_file
from scheduling.graph.plan_files import plan_sha256, save_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.slowed_motions import overloads
from twin.audit.worlds.engine import Engine, engine_named
from twin.engine.engine import Simulator
from twin.host.atomic import write_json
from twin.host.pictures import save_png
from twin.host.progress import Report, report_nothing
from twin.recorders.motion_tables import write_motion
from twin.recorders.observers import JsonlRecorder, MemoryRecorder, Recorder
from twin.run.events import Event
from twin.run.folder import (
    EVENTS,
    GANTT,
    RECORDING,
    SUMMARY,
    TURNS,
    keep_new,
    set_aside,
)
from twin.run.gantt import gantt_figure
from twin.run.run_record import DeadlockError, Policy, Run
from twin.run.summary import summarise
from twin.run.throughput import line_summary
from twin.run.written import hashes_as_written
from twin.scenario.manifest import write_manifest
from twin.scenario.sections.scenario import Scenario
from twin.trial.saved_plan import SavedPlan, plan_variant
from twin.trial.simulation import doubts_about_stalls, scenario_execution

if TYPE_CHECKING:
    from twin.audit.audit import AuditReport
    from twin.planning.pipeline import Planned

SIMULATION, RECORDS = "simulation", "recording"
"""Names of the stages for progress displays."""


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


@dataclass(frozen=True)
class Origin:
    """Planning that a plan comes from, and doubts about its cell.

    Attributes:
        planned: how it was made, for the summary: which it is, seconds of the stages, and
            what to compare with, one task after another; by default the plan itself.
        warnings: what the check before planning found doubtful.
    """

    planned: Planned | SavedPlan | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Trial:
    """Result of a trial.

    Attributes:
        folder: of the files.
        run: the execution.
        summary: the content of ``summary.json``.
        events: what happened, in order.
    """

    folder: Path
    run: Run
    summary: Mapping[str, Any]
    events: Sequence[Event] = ()

    @property
    def passed(self) -> bool:
        """True if the run was completed and no audit found anything."""
        return has_passed(self.summary)


def has_passed(summary: Mapping[str, Any]) -> bool:
    """Tell whether the run of a summary was completed and no audit found anything."""
    audit = summary["audit"]
    return summary["outcome"] == "completed" and not (audit and audit["violations"])


def read_summary(folder: Path) -> dict[str, Any]:
    """Return the summary of a run that has come to its end.

    Raises:
        OutputError: there is none, or it is damaged.
    """
    path = folder / SUMMARY
    try:
        summary: dict[str, Any] = json.loads(read_file(path))
        has_passed(summary)
    except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
        raise OutputError(f"{path}: no summary of a run: {error!r}") from error
    return summary


def try_plan(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    folder: Path,
    *,
    base: Path = Path(),
    origin: Origin = Origin(),
    recording: bool = True,
    audit: bool | Engine = True,
    progress: Report = report_nothing,
) -> Trial:
    """Execute a plan once and write everything about it into a folder.

    Args:
        scenario: seed, policy, durations and disturbances are taken from it.
        tpg: the plan.
        folder: of the run, made by prepare_run_folder.
        base: where relative paths of the scenario start.
        origin: how the plan was made, and what is doubtful about the cell, for the summary.
        recording: write ``run.rrd``.
        audit: let the audit check what was executed; an engine says with what.
        progress: told how far each stage has come.

    Raises:
        IncompleteRunError: a file cannot be written.
        DeadlockError: no robot could go on.
    """
    about = prepare(scenario, tpg, base, origin, recording=recording, audit=audit)
    turns = None if origin.planned is None else origin.planned.turns
    set_aside(folder)
    with whole_or_failed(folder):
        write_manifest(folder, scenario, tpg.cell, base, run=asdict(about))
        save_plan(tpg, folder)
        if turns is not None:
            save_plan(turns, folder / TURNS)
        progress(SIMULATION, 0, 1)
        memory = MemoryRecorder()
        log = JsonlRecorder(folder / EVENTS)
        run = execute(scenario, tpg, base, recorders=(log, memory))
        log.require_whole()
        progress(SIMULATION, 1, 1)
        trial = conclude(scenario, tpg, folder, run, memory.events, about, progress)
    keep_new(folder)
    return trial


def prepare(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    base: Path,
    origin: Origin = Origin(),
    *,
    recording: bool = False,
    audit: bool | Engine = False,
) -> Preparation:
    """Return what is known before a run; see try_plan for the arguments."""
    planned = origin.planned
    turns = None if planned is None else planned.turns
    return Preparation(
        recording=recording,
        audit=audit,
        planning_s=dict(planned.planning_s if planned else {}),
        makespan_sequential_s=_sequential_s(scenario, turns or tpg, base),
        plan_sha256=plan_sha256(tpg),
        warnings=(
            *origin.warnings,
            *doubts_about_stalls(scenario, tpg),
            *overloads(tpg),
        ),
        plan=plan_variant(tpg) if planned is None else planned.variant,
        turns_sha256=None if turns is None else plan_sha256(turns),
        load_bound_s=None if planned is None else planned.load_bound_s,
        step_order=() if planned is None else planned.step_order,
    )


def figures(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    run: Run,
    about: Preparation,
    audit: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the figures of a run that has come to its end, with the keys of ``summary.json``.

    Args:
        scenario: what was executed.
        tpg: the plan.
        run: how it was executed.
        about: what was known before.
        audit: what the audit found, None where there was none.
    """
    from twin.planning.kind import assembly_kind

    completed = run.outcome == "completed"
    found = summarise(
        tpg,
        run,
        scenario=scenario.name,
        plan=about.plan,
        planning_s=about.planning_s,
        audit=audit,
        makespan_sequential_s=about.makespan_sequential_s if completed else None,
        warnings=about.warnings,
        line=line_summary(tpg, run, *assembly_kind(scenario.assembly).due()),
    )
    found["load_bound_s"] = about.load_bound_s
    found["step_order"] = list(about.step_order) or None
    return found


class IncompleteRunError(TwinError):
    """A run could not write what it promises; what it wrote is not to be relied on."""


@contextmanager
def whole_or_failed(folder: Path) -> Iterator[None]:
    """Turn whatever cannot be written into the failure of a run.

    The summary, which is written last, is there only if everything else is.

    Raises:
        IncompleteRunError: something could not be written.
    """
    try:
        yield
    except (OutputError, OSError) as error:
        with suppress(OSError):
            (folder / SUMMARY).unlink(missing_ok=True)
        raise IncompleteRunError(
            f"the run has failed, not all is written: {error}"
        ) from error


def conclude(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    folder: Path,
    run: Run,
    events: list[Event],
    about: Preparation,
    progress: Report,
) -> Trial:
    """Write everything about a run that has been simulated, besides its event log."""
    total = 3 + about.recording
    progress(RECORDS, 0, total)
    write_motion(folder, tpg, run)
    progress(RECORDS, 2, total)
    gantt = gantt_figure(tpg, run, events, title=scenario.name, plan=about.plan)
    save_png(gantt, folder / GANTT)
    progress(RECORDS, 3, total)
    if about.recording:
        from twin.recorders.rerun.recorder import write_recording

        write_recording(folder / RECORDING, tpg, run, events, name=scenario.name)
        progress(RECORDS, total, total)

    completed = run.outcome == "completed"
    ended = run.outcome != "aborted"
    audit = None
    if about.audit and ended:
        report = audit_execution(
            scenario,
            folder,
            ordered=run.policy != "open-loop",
            finished=completed,
            engine=None if about.audit is True else engine_named(str(about.audit)),
            progress=progress,
        )
        audit = report.content()
    summary = figures(scenario, tpg, run, about, audit)
    summary["files"] = hashes_as_written(folder)
    write_json(folder / SUMMARY, summary)
    return Trial(folder, run, summary, events)


def _sequential_s(
    scenario: Scenario, tpg: TemporalPlanGraph, base: Path
) -> float | None:
    """Return the makespan of one task at a time [s], None where that comes to no end."""
    try:
        baseline = execute(scenario, tpg, base, "sequential")
    except DeadlockError:
        return None
    return baseline.makespan_s if baseline.outcome == "completed" else None


def execute(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    base: Path,
    policy: Policy | None = None,
    *,
    recorders: tuple[Recorder, ...] = (),
) -> Run:
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


def audit_execution(
    scenario: Scenario,
    folder: Path,
    *,
    ordered: bool,
    finished: bool,
    engine: Engine | None = None,
    progress: Report = report_nothing,
) -> AuditReport:
    """Let the audit judge what was executed, by all that a scenario says of it.

    Args:
        scenario: says what is to stand where, and what holds it.
        folder: with the plan and the tables of the motion.
        ordered: whether the run had to keep the plan's type-2 edges, as all policies but
            open-loop do.
        finished: whether the run came to its end, so that all must be in place.
        engine: to measure with; by default PyBullet where it is installed, else coal.
        progress: told how far the audit has come.
    """
    from twin.audit.audit import audit_run
    from twin.planning.kind import assembly_kind

    return audit_run(
        folder,
        progress,
        ordered=ordered,
        wanted=assembly_kind(scenario.assembly).wanted(scenario.cell),
        finished=finished,
        engine=engine,
    )
