"""One run of a plan: execution, output files and audit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path

from planning.errors import OutputError
from scheduling.graph.plan_files import plan_sha256, save_plan
from twin.host.atomic_files import save_png, write_json
from twin.host.progress import Report, report_nothing
from twin.recorders.observers import JsonlRecorder, MemoryRecorder
from twin.recorders.run_tables import write_motion
from twin.registry import FIGURES, RECORDERS
from twin.runs.events import Event
from twin.runs.folder import (
    EVENTS,
    FIRST,
    GANTT,
    PRODUCTS,
    SUMMARY,
    TURNS,
    recorded_hashes,
    replace_results,
)
from twin.runs.header import RunHeader
from twin.scenario.manifest import write_manifest
from twin.trial.auditor import load_auditor
from twin.trial.errors import IncompleteRunError
from twin.trial.executor import Executed, Executor, SimulatedExecutor
from twin.trial.header import line_orders, run_figures, run_header
from twin.trial.plan_result import PlanResult
from twin.trial.run_result import Resumed, RunResult

SIMULATION, RECORDS = "simulation", "recording"
"""Names of the stages for progress displays."""


_SIMULATED = SimulatedExecutor()


def write_plan(plan: PlanResult, folder: Path) -> None:
    """Write a plan with its scenario into a folder."""
    with replace_results(folder):
        _write_begun(plan, folder, run_header(plan))


def _write_begun(plan: PlanResult, folder: Path, header: RunHeader) -> None:
    """Write the manifest, the plan and its base motions."""
    case = plan.scenario
    write_manifest(
        folder, case.sections, plan.tpg.cell, case.folder, run=asdict(header)
    )
    save_plan(plan.tpg, folder)
    if header.operated:
        save_plan(plan.tpg, folder / FIRST)
    if plan.turns is not None:
        save_plan(plan.turns, folder / TURNS)


def run_plan_to_folder(
    plan: PlanResult,
    folder: Path,
    *,
    recording: bool = True,
    audit: bool | str = True,
    executor: Executor = _SIMULATED,
    progress: Report = report_nothing,
) -> RunResult:
    """Execute a plan once and write everything about it into a folder.

    Args:
        plan: plan to execute; seed, policy, durations and disturbances are its scenario's.
        folder: of the run, made by prepare_run_folder.
        recording: write recordings, such as ``run.rrd``.
        audit: whether to audit the run; a name selects the collision engine.
        executor: executes the plan. If it replans, the folder holds the executed plan and, next to
            it, the first one.
        progress: receives the progress of each stage.

    Raises:
        IncompleteRunError: a file cannot be written.
        DeadlockError: no robot could continue.
    """
    header = run_header(
        plan, recording=recording, audit=audit, execution=executor.entries
    )
    with replace_results(folder), fail_if_incomplete(folder):
        _write_begun(plan, folder, header)
        progress(SIMULATION, 0, 1)
        memory = MemoryRecorder()
        log = JsonlRecorder(folder / EVENTS)
        done = executor.execute(plan, folder, (log, memory), log.sync)
        log.require_whole()
        return conclude(done, folder, memory.events, header, progress)


@contextmanager
def fail_if_incomplete(folder: Path) -> Iterator[None]:
    """Raise IncompleteRunError for files that cannot be written.

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
    done: Executed,
    folder: Path,
    events: list[Event],
    header: RunHeader,
    progress: Report,
    known: int | None = None,
) -> RunResult:
    """Write all files of an executed run except its event log.

    Args:
        done: the executed plan.
        folder: of the run.
        events: of the run, in order.
        header: header of the run.
        progress: receives the progress of each stage.
        known: number of events that were in the log before the run was resumed; None where it was not.
    """
    progress(SIMULATION, 1, 1)
    plan, record = done.plan, done.record
    scenario, tpg = plan.scenario.sections, plan.tpg
    if header.operated:
        header = replace(header, plan_sha256=plan_sha256(tpg))
        if done.replanned:
            # The makespan of the first plan is no reference for a revised one.
            header = replace(
                header, makespan_sequential_s=None, makespan_asynchronous_s=None
            )
        save_plan(tpg, folder)
        base = plan.scenario.folder
        write_manifest(folder, scenario, tpg.cell, base, run=asdict(header))
    total = 3 + header.recording
    progress(RECORDS, 0, total)
    write_motion(folder, tpg, record)
    progress(RECORDS, 2, total)
    if "run" in FIGURES:
        gantt = FIGURES.load("run")(
            tpg, record, events, title=scenario.name, plan=header.plan
        )
        save_png(gantt, folder / GANTT)
    scrapped = done.summary.get("operation", {}).get("scrapped", ())
    if "products" in FIGURES:
        figure = FIGURES.load("products")
        orders = line_orders(plan, scrapped)
        chart = figure(tpg, record, *orders, title=scenario.name)
        if chart is not None:
            save_png(chart, folder / PRODUCTS)
    progress(RECORDS, 3, total)
    if header.recording:
        for record_run in RECORDERS.load_all().values():
            record_run(folder, tpg, record, events, scenario.name)
        progress(RECORDS, total, total)

    audit = None
    if header.audit and record.outcome != "aborted":
        engine = None if header.audit is True else str(header.audit)
        audit = load_auditor(engine).judge(
            scenario,
            folder,
            ordered=record.policy != "open-loop",
            # What is not wanted, or not any more, need not be in place.
            finished=done.finished,
            progress=progress,
        )
    summary = run_figures(plan, record, header, audit, scrapped) | dict(done.summary)
    summary["files"] = recorded_hashes(folder)
    write_json(folder / SUMMARY, summary)
    return RunResult(
        folder,
        plan=plan,
        history=events,
        record=record,
        resumed=None if known is None else Resumed(known, len(events) - known),
    )
