"""Resuming a run that was killed.

Runs are deterministic: the same scenario, plan and seed give the same events. So a run is resumed by
executing it again from the start, comparing every event with the log, and writing the missing ones: the
files equal those of an uninterrupted run. Runs with drivers are continued from the log.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from planning.errors import OutputError
from twin.host.progress import Report, report_nothing
from twin.recorders.observers import (
    JsonlRecorder,
    MemoryRecorder,
)
from twin.runs.events import Event, EventCode, event_line, read_log
from twin.runs.folder import (
    EVENTS,
    SUMMARY,
    drop_earlier_results,
    require_recorded_hashes,
)
from twin.runs.header import RunHeader
from twin.scenario.manifest import (
    MANIFEST,
    manifest_base,
    read_manifest,
    require_same_files,
)
from twin.trial.errors import ResumeError
from twin.trial.executor import executor_of
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.run_plan import SIMULATION, conclude, fail_if_incomplete
from twin.trial.run_result import RunResult


def resume_run(
    folder: Path, *, base: Path | None = None, progress: Report = report_nothing
) -> RunResult:
    """Resume a simulated run from its log; a finished one is only read.

    Args:
        folder: of the run; its process must not be alive any more.
        base: where relative paths of the scenario start, where that has changed.
        progress: receives the progress of each stage.

    Raises:
        OutputError: the folder holds no run, or a file is damaged or cannot be written.
        ResumeError: an event differs from the log, as after an update of a package.
    """
    scenario, manifest = read_manifest(folder, "run to resume")
    try:
        header = RunHeader(**manifest["run"])
    except (KeyError, TypeError) as error:
        raise OutputError(
            f"{folder / MANIFEST}: does not say how to resume: {error}"
        ) from error
    path = folder / EVENTS
    log = read_log(path) if path.exists() else ()
    known = _before_interrupt(log)
    # The summary is written last, and the log ends with the end of the run.
    if (folder / SUMMARY).exists() and len(known) == len(log) and _has_ended(log):
        require_recorded_hashes(folder, (EVENTS,))
        return RunResult(folder)
    executor = executor_of(header, folder)
    progress(SIMULATION, 0, 1)
    start = base or manifest_base(folder, manifest)
    require_same_files(folder, manifest, scenario, start)
    plan = executor.plan_to_resume(LoadedScenario(scenario, start), folder, header)
    memory = MemoryRecorder()
    size = sum(len(line.encode()) for line in known)
    continuing = executor.continued(plan, folder, known)
    if continuing is not None:
        memory.events += map(Event.parse, known)
        with fail_if_incomplete(folder):
            recorder = JsonlRecorder(path, kept=size)
            done = continuing.execute(plan, folder, (recorder, memory), recorder.sync)
            recorder.require_whole()
            run = conclude(done, folder, memory.events, header, progress, len(known))
    else:
        done = executor.execute(plan, folder, (memory,), _no_sync)
        if done.record.outcome == "aborted":
            raise KeyboardInterrupt
        lines = [event_line(event) for event in memory.events]
        _require_agreement(path, known, lines, memory.events)
        with fail_if_incomplete(folder):
            recorder = JsonlRecorder(path, kept=size)
            for event in memory.events[len(known) :]:
                recorder.record(event)
            recorder.close()
            run = conclude(done, folder, memory.events, header, progress, len(known))
    drop_earlier_results(folder)
    return run


def _no_sync() -> None:
    """Do nothing: events are written once they agree with the log."""


def _has_ended(log: Sequence[str]) -> bool:
    """Return whether the last row of a log ends the whole run."""
    if not log:
        return False
    last = Event.parse(log[-1])
    return last.kind == "finished" and not last.robot


def _before_interrupt(log: Sequence[str]) -> Sequence[str]:
    """Return a log without the last rows, which an interrupt by the user wrote."""
    lines = list(log)
    if _has_ended(lines) and Event.parse(lines[-1]).code is EventCode.ABORTED:
        lines.pop()
        if lines and Event.parse(lines[-1]).code is EventCode.INTERRUPTED:
            lines.pop()
    return lines


def _require_agreement(
    path: Path, known: Sequence[str], lines: list[str], events: list[Event]
) -> None:
    for k, line in enumerate(known):
        if k >= len(lines):
            raise ResumeError(
                f"{path}:{k + 1}: the run ends after {len(lines)} events, the log continues",
                row=k + 1,
            )
        if line != lines[k]:
            event = events[k]
            raise ResumeError(
                f"{path}:{k + 1}: the log says {line.strip()}, but now"
                f" {event.robot or 'the run'} {event.kind} at"
                f" {event.t_ns / 1e9:.9f} s: {lines[k].strip()}",
                row=k + 1,
            )
