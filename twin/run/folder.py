"""The folder of a run: made before planning starts, filled as results come."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from planning.errors import OutputError

EVENTS = "events.jsonl"
TRAJECTORY = "trajectory.parquet"
OBJECTS = "objects.parquet"
RECORDING = "run.rrd"
GANTT = "gantt.png"
SUMMARY = "summary.json"
COMPARISON = "compare.json"
CHART = "compare.png"

_RESULTS = (EVENTS, TRAJECTORY, OBJECTS, RECORDING, GANTT, SUMMARY, COMPARISON, CHART)


def prepare_run_folder(out: Path | None, scenario_name: str) -> Path:
    """Return a folder that can be written to, made where it is missing.

    Called before anything that takes time, so that a long plan is not lost for want of a place
    to put it. Results of an earlier run in the folder are removed, plans are left.

    Args:
        out: the folder; by default ``logs/<scenario>-<UTC time>``.
        scenario_name: name of the scenario.

    Raises:
        OutputError: it cannot be made or written to.
    """
    folder = _new_log_folder(scenario_name) if out is None else out
    probe = folder / f".probe.{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
        for name in _RESULTS:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written to: {error}") from error
    return folder


@contextmanager
def run_folder(out: Path | None, scenario_name: str) -> Iterator[Path]:
    """Give a folder for results, made as by prepare_run_folder.

    When the work in it fails before there is any result, a folder made for it goes again.
    """
    existed = out is not None and out.exists()
    folder = prepare_run_folder(out, scenario_name)
    try:
        yield folder
    except BaseException:
        if not existed:
            with suppress(OSError):
                folder.rmdir()
        raise


def _new_log_folder(scenario_name: str) -> Path:
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    first = Path("logs") / f"{scenario_name}-{stamp}"
    folder, count = first, 1
    while folder.exists():
        count += 1
        folder = first.with_name(f"{first.name}-{count}")
    return folder
