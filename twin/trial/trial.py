"""One trial of a plan: execute it into a folder, let the audit judge it; resume it after a kill.

Runs are deterministic: the same scenario, plan and seed give the same events. So a run is resumed
by running it again from the start, comparing every event with the log as far as that goes, and
writing what it does not hold yet: the same files, kill or none.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from planning.errors import OutputError, TwinError
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from twin.audit.worlds.engines import Engine, engine_named
from twin.durations.model import NANOSECONDS
from twin.host.guard import write_json
from twin.host.pictures import save_png
from twin.host.progress import Report, report_nothing
from twin.operate.operation import Operation, operate
from twin.operate.person import Says
from twin.recorders.observers import (
    JsonlRecorder,
    MemoryRecorder,
    Recorder,
    write_motion,
)
from twin.run.events import Event, ExecutionRecord, event_line, parse_event, read_log
from twin.run.folder import (
    EVENTS,
    FIRST,
    GANTT,
    MEASURED,
    RECORDING,
    SUMMARY,
    TURNS,
    VERSIONS,
    hashes_as_written,
    keep_new,
    new_results,
    require_as_written,
)
from twin.run.gantt import gantt_figure
from twin.run.summary import Preparation
from twin.scenario.manifest import (
    MANIFEST,
    manifest_base,
    read_manifest,
    require_same_files,
    write_manifest,
)
from twin.scenario.sections.scenario import Scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult, plan_of_run
from twin.trial.planning import plan_to_operate
from twin.trial.run_result import Resumed, RunResult
from twin.trial.simulation import execute, figures, prepare, scenario_execution
from twin.uncertainty.disturbances import Disturbances

if TYPE_CHECKING:
    from twin.audit.audit import AuditReport
    from twin.engine.execution import Ports
    from twin.live.session import Session

SIMULATION, RECORDS = "simulation", "recording"
"""Names of the stages for progress displays."""


class IncompleteRunError(TwinError):
    """A run could not write what it promises; what it wrote is not to be relied on."""


class ResumeError(TwinError):
    """The resumed run differs from its log."""


def write_plan(plan: PlanResult, folder: Path) -> None:
    """Write a plan with its scenario into a folder that it can be read back from."""
    with new_results(folder):
        _write_begun(plan, folder, prepare(plan))


def _write_begun(plan: PlanResult, folder: Path, about: Preparation) -> None:
    """Write the manifest, the plan, and what it was made of."""
    case = plan.scenario
    write_manifest(folder, case.sections, plan.tpg.cell, case.folder, run=asdict(about))
    save_plan(plan.tpg, folder)
    if about.operated:
        save_plan(plan.tpg, folder / FIRST)
    if plan.turns is not None:
        save_plan(plan.turns, folder / TURNS)


def try_plan(
    plan: PlanResult,
    folder: Path,
    *,
    recording: bool = True,
    audit: bool | Engine = True,
    operated: bool = False,
    says: Says | None = None,
    session: Session | None = None,
    progress: Report = report_nothing,
) -> RunResult:
    """Execute a plan once and write everything about it into a folder.

    Args:
        plan: what is executed; seed, policy, durations and disturbances are its scenario's.
        folder: of the run, made by prepare_run_folder.
        recording: write ``run.rrd``.
        audit: let the audit check what was executed; an engine says with what.
        operated: plan anew what fails; the plan in the folder is then all that was executed, and the
            first one is beside it.
        says: answers for a person who is asked then; see twin.operate.
        session: drivers that move the robots, of a plan that is operated; else they are simulated.
        progress: told how far each stage has come.

    Raises:
        IncompleteRunError: a file cannot be written.
        DeadlockError: no robot could go on.
    """
    about = prepare(plan, recording=recording, audit=audit, operated=operated)
    about = replace(
        about,
        answered=says is not None,
        session=None if session is None else session.content(),
    )
    with new_results(folder), whole_or_failed(folder):
        _write_begun(plan, folder, about)
        progress(SIMULATION, 0, 1)
        memory = MemoryRecorder()
        log = JsonlRecorder(folder / EVENTS)
        live = None
        if session is not None:
            live = session.execution(plan.tpg.cell, log.sync, folder / MEASURED)
        done = _executed(plan, about, folder, (log, memory), says, live)
        log.require_whole()
        return _conclude(done, folder, memory.events, about, progress)


@dataclass(frozen=True)
class _Executed:
    """What was executed, and how.

    Attributes:
        plan: with all that was planned on the way.
        record: when everything happened.
        operation: what failed and what was made of it; None where nothing is planned anew.
    """

    plan: PlanResult
    record: ExecutionRecord
    operation: Operation | None = None


def _executed(
    plan: PlanResult,
    about: Preparation,
    folder: Path,
    recorders: Sequence[Recorder],
    says: Says | None = None,
    live: Ports | None = None,
) -> _Executed:
    """Execute a plan, and plan anew what fails where that is asked for; each version is kept in the folder."""
    scenario, base = plan.scenario.sections, plan.scenario.folder
    if not about.operated:
        record = execute(scenario, plan.tpg, base, recorders=tuple(recorders))
        return _Executed(plan, record)
    model = scenario_execution(scenario, base)
    if live is not None:
        # What happens is what drivers report.
        model = replace(model, disturbances=Disturbances())
    done = operate(
        scenario,
        plan.motions,
        plan.tpg,
        model,
        seed=scenario.seed,
        recorders=recorders,
        says=says,
        ports=live,
        keep=lambda number, tpg: save_plan(tpg, folder / VERSIONS / str(number)),
    )
    return _Executed(replace(plan, tpg=done.tpg), done.record, done)


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


def _conclude(
    done: _Executed,
    folder: Path,
    events: list[Event],
    about: Preparation,
    progress: Report,
    known: int | None = None,
) -> RunResult:
    """Write everything about a run that has been simulated, besides its event log; so many events were known."""
    progress(SIMULATION, 1, 1)
    plan, record = done.plan, done.record
    scenario, tpg = plan.scenario.sections, plan.tpg
    if done.operation is not None:
        about = replace(about, plan_sha256=plan_sha256(tpg))
        if done.operation.versions:
            # What the first plan takes otherwise is no measure of what was executed.
            about = replace(
                about, makespan_sequential_s=None, makespan_asynchronous_s=None
            )
        save_plan(tpg, folder)
        base = plan.scenario.folder
        write_manifest(folder, scenario, tpg.cell, base, run=asdict(about))
    total = 3 + about.recording
    progress(RECORDS, 0, total)
    write_motion(folder, tpg, record)
    progress(RECORDS, 2, total)
    gantt = gantt_figure(tpg, record, events, title=scenario.name, plan=about.plan)
    save_png(gantt, folder / GANTT)
    progress(RECORDS, 3, total)
    if about.recording:
        from twin.recorders.rerun.recorder import write_recording

        write_recording(folder / RECORDING, tpg, record, events, name=scenario.name)
        progress(RECORDS, total, total)

    audit = None
    if about.audit and record.outcome != "aborted":
        report = audit_execution(
            scenario,
            folder,
            ordered=record.policy != "open-loop",
            # What is not wanted, or not any more, need not be in place.
            finished=(
                record.outcome == "completed"
                if done.operation is None
                else done.operation.finished
            ),
            engine=None if about.audit is True else engine_named(str(about.audit)),
            progress=progress,
        )
        audit = report.content()
    summary = figures(plan, record, about, audit)
    if done.operation is not None:
        summary["operation"] = done.operation.content()
    summary["files"] = hashes_as_written(folder)
    write_json(folder / SUMMARY, summary)
    return RunResult(
        folder,
        plan=plan,
        history=events,
        record=record,
        resumed=None if known is None else Resumed(known, len(events) - known),
    )


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


def resume_run(
    folder: Path, *, base: Path | None = None, progress: Report = report_nothing
) -> RunResult:
    """Resume a simulated run from its log; one that has come to its end is read.

    Args:
        folder: of the run; its process must not be alive any more.
        base: where relative paths of the scenario start, where that has changed.
        progress: told how far each stage has come.

    Raises:
        OutputError: the folder holds no run, or a file is damaged or cannot be written.
        ResumeError: an event is not what the log says, as after an update of a package.
    """
    scenario, manifest = read_manifest(folder, "run to resume")
    try:
        about = Preparation(**manifest["run"])
    except (KeyError, TypeError) as error:
        raise OutputError(
            f"{folder / MANIFEST}: does not say how to resume: {error}"
        ) from error
    path = folder / EVENTS
    log = read_log(path) if path.exists() else ()
    known = _before_interrupt(log)
    # The summary is written last, and the log ends with the end of the run.
    if (folder / SUMMARY).exists() and len(known) == len(log) and _has_ended(log):
        require_as_written(folder, (EVENTS,))
        return RunResult(folder)
    if about.answered:
        raise ResumeError(
            f"{folder}: somebody answered at the keyboard while it ran, and may answer otherwise now: run it again"
        )
    progress(SIMULATION, 0, 1)
    memory = MemoryRecorder()
    start = base or manifest_base(folder, manifest)
    require_same_files(folder, manifest, scenario, start)
    plan = _plan_to_resume(folder, LoadedScenario(scenario, start), about)
    if about.session is not None:
        return _go_on(plan, folder, about, known, progress)
    done = _executed(plan, about, folder, (memory,))
    if done.record.outcome == "aborted":
        raise KeyboardInterrupt
    lines = [event_line(event) for event in memory.events]
    _require_agreement(path, known, lines, memory.events)
    with whole_or_failed(folder):
        recorder = JsonlRecorder(path, kept=sum(len(line.encode()) for line in known))
        for event in memory.events[len(known) :]:
            recorder.record(event)
        recorder.close()
        run = _conclude(done, folder, memory.events, about, progress, len(known))
    keep_new(folder)
    return run


def _go_on(
    plan: PlanResult,
    folder: Path,
    about: Preparation,
    known: Sequence[str],
    progress: Report,
) -> RunResult:
    """Go on with a run whose robots are moved by drivers, from what they and the log say of it.

    Raises:
        ResumeError: something was planned anew in it.
    """
    from twin.live.measured import history_of
    from twin.live.session import Session

    assert about.session is not None
    events = [parse_event(line) for line in known]
    try:
        history = history_of(plan.tpg, events)
    except TwinError as error:
        raise ResumeError(f"{folder}: {error}") from None
    session = Session.of(folder.name, about.session)
    stood_s = max(time.time() - (folder / EVENTS).stat().st_mtime, 0.0)
    history.since_ns += round(stood_s * session.drivers.pace * NANOSECONDS)
    memory = MemoryRecorder()
    memory.events += events
    with whole_or_failed(folder):
        size = sum(len(line.encode()) for line in known)
        log = JsonlRecorder(folder / EVENTS, kept=size)
        live = session.execution(plan.tpg.cell, log.sync, folder / MEASURED, history)
        done = _executed(plan, about, folder, (log, memory), None, live)
        log.require_whole()
        run = _conclude(done, folder, memory.events, about, progress, len(known))
    keep_new(folder)
    return run


def _plan_to_resume(
    folder: Path, case: LoadedScenario, about: Preparation
) -> PlanResult:
    """Return the plan with which a run began.

    Raises:
        ResumeError: what was planned anew on the way needs what the plan was made of, and that is made
            again; it is another one now.
    """
    if not about.operated:
        return PlanResult(case, plan_of_run(folder), about.plan, folder=folder)
    plan = plan_to_operate(case)
    if plan_sha256(plan.tpg) != plan_sha256(load_plan(folder / FIRST)):
        raise ResumeError(f"{folder / FIRST}: planned again, it is another plan")
    return plan


def _has_ended(log: Sequence[str]) -> bool:
    """Tell whether the last row of a log is the end of the whole run."""
    if not log:
        return False
    last = parse_event(log[-1])
    return last.kind == "finished" and not last.robot


def _before_interrupt(log: Sequence[str]) -> Sequence[str]:
    """Return a log without the last rows of a run that the user broke off."""
    lines = list(log)
    if lines and '"finished"' in lines[-1]:
        last = parse_event(lines[-1])
        if not last.robot and last.detail == "aborted":
            lines.pop()
            if lines and '"stopped"' in lines[-1] and not parse_event(lines[-1]).robot:
                lines.pop()
    return lines


def _require_agreement(
    path: Path, known: Sequence[str], lines: list[str], events: list[Event]
) -> None:
    for k, line in enumerate(known):
        if k >= len(lines):
            raise ResumeError(
                f"{path}:{k + 1}: the run ends after {len(lines)} events, the log goes on"
            )
        if line != lines[k]:
            event = events[k]
            raise ResumeError(
                f"{path}:{k + 1}: the log says {line.strip()}, but now"
                f" {event.robot or 'the run'} {event.kind} at"
                f" {event.t_ns / 1e9:.9f} s: {lines[k].strip()}"
            )
