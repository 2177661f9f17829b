"""Resuming a run whose process was killed.

Runs are deterministic: the same scenario, plan and seed give the same events. So a run is resumed
by running it again from the start, comparing every event with the log as far as that goes, and
writing what it does not hold yet: the same files, kill or none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from planning.errors import OutputError, TwinError
from twin.host.progress import Report, report_nothing
from twin.recorders.observers import JsonlRecorder, MemoryRecorder
from twin.run.events import Event, event_line, parse_event, read_log
from twin.run.folder import EVENTS, SUMMARY, keep_new
from twin.run.written import require_as_written
from twin.scenario.manifest import manifest_base, read_manifest, require_same_files
from twin.trial.saved_plan import plan_of_run
from twin.trial.trial import (
    SIMULATION,
    Preparation,
    Trial,
    conclude,
    execute,
    whole_or_failed,
)


class ResumeError(TwinError):
    """The resumed run differs from its log."""


@dataclass(frozen=True)
class Resumption:
    """Result of a resumed run.

    Attributes:
        agreed: events of the log, all of which happened again.
        added: events that were missing.
        trial: the run to its end; None where it had come to its end before.
    """

    agreed: int
    added: int
    trial: Trial | None


def resume_run(
    folder: Path, *, base: Path | None = None, progress: Report = report_nothing
) -> Resumption:
    """Resume a simulated run from its log.

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
        raise OutputError(f"{folder}: does not say how to resume: {error}") from error
    path = folder / EVENTS
    log = read_log(path) if path.exists() else ()
    known = _before_interrupt(log)
    # The summary is written last, and the log ends with the end of the run.
    if (folder / SUMMARY).exists() and len(known) == len(log) and _has_ended(log):
        require_as_written(folder, (EVENTS,))
        return Resumption(len(log), 0, None)
    tpg = plan_of_run(folder)
    progress(SIMULATION, 0, 1)
    memory = MemoryRecorder()
    start = base or manifest_base(folder, manifest)
    require_same_files(folder, manifest, scenario, start)
    run = execute(scenario, tpg, start, recorders=(memory,))
    if run.outcome == "aborted":
        raise KeyboardInterrupt
    lines = [event_line(event) for event in memory.events]
    _require_agreement(path, known, lines, memory.events)
    with whole_or_failed(folder):
        recorder = JsonlRecorder(path, kept=sum(len(line.encode()) for line in known))
        for event in memory.events[len(known) :]:
            recorder.record(event)
        recorder.close()
        progress(SIMULATION, 1, 1)
        trial = conclude(scenario, tpg, folder, run, memory.events, about, progress)
    keep_new(folder)
    return Resumption(len(known), len(lines) - len(known), trial)


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
