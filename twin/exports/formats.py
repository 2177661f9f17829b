"""The formats that a run can be written in; each is imported when it is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from inspect import signature
from pathlib import Path

from planning.errors import OutputError
from twin.host.guard import replacing
from twin.trial.run_result import RunResult

_WRITERS = {
    "csv": "twin.exports.tables:csv_files",
    "parquet": "twin.exports.tables:parquet_files",
    "perfetto": "twin.exports.tables:perfetto_files",
    "joint-trajectory": "twin.exports.tables:joint_trajectory_files",
    "joint-csv": "twin.exports.tables:joint_csv_files",
    "mcap": "twin.exports.ros.mcap_file:mcap_files",
    "graphml": "twin.exports.graphs:graphml_files",
    "task-graph": "twin.exports.graphs:task_graph_files",
    "open-plan": "twin.exports.open_plan:open_plan_files",
    "ldraw": "twin.kinds.lego.ldraw:ldraw_files",
}
FORMATS = tuple(_WRITERS)

FOLDER = "exports"
"""Default folder of exports, in that of the run."""


def exported_files(
    run: RunResult, name: str, *, nodes: bool = False, rate_hz: float | None = None
) -> Mapping[str, bytes]:
    """Return the content of each file of a format by its name.

    Args:
        run: the run.
        name: of the format.
        nodes: every node of the temporal plan graph, not one entry a task, where the format
            knows the difference.
        rate_hz: of the points of motions, where the format samples them; None for its own [Hz].

    Raises:
        OutputError: there is no such format, or the run lacks a file that it is made of.
    """
    if name not in _WRITERS:
        raise OutputError(f"unknown format {name!r}", choices=FORMATS)
    module, function = _WRITERS[name].split(":")
    write = getattr(import_module(module), function)
    given = (
        {"nodes": nodes} if rate_hz is None else {"nodes": nodes, "rate_hz": rate_hz}
    )
    known = signature(write).parameters
    options = {key: value for key, value in given.items() if key in known}
    files: Mapping[str, bytes] = write(run, **options)
    return files


def export_run(
    run: RunResult,
    name: str,
    out: Path | None = None,
    *,
    nodes: bool = False,
    rate_hz: float | None = None,
) -> list[Path]:
    """Write a run in a format.

    Args:
        run: the run.
        name: of the format.
        out: a file for a format of one file, unless it is a folder that exists; a folder for one
            of several. By default the folder ``exports`` of the run.
        nodes, rate_hz: see exported_files.

    Returns:
        The files written.

    Raises:
        OutputError: as exported_files, or the files cannot be written.
    """
    content = exported_files(run, name, nodes=nodes, rate_hz=rate_hz)
    target = run.files / FOLDER if out is None else out
    single = out is not None and len(content) == 1 and not target.is_dir()
    written = []
    for file, data in content.items():
        path = target if single else target / file
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error}") from error
        with replacing(path) as temporary:
            temporary.write_bytes(data)
        written.append(path)
    return written
