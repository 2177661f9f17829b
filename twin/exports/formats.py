"""Export formats of runs, found through the plug-in registry."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import signature
from pathlib import Path

from planning.errors import OutputError
from planning.files import replace_atomically
from twin.registry import EXPORTS
from twin.trial.run_result import RunResult

FOLDER = "exports"
"""Default folder of exports, inside the run folder."""


def exported_files(
    run: RunResult, name: str, *, nodes: bool = False, rate_hz: float | None = None
) -> Mapping[str, bytes]:
    """Return the content of each file of an export format, by file name.

    Args:
        run: the run.
        name: of the format.
        nodes: every node of the temporal plan graph, not one entry a task, where the format
            knows the difference.
        rate_hz: of the points of motions, where the format samples them; None for its own [Hz].

    Raises:
        OutputError: there is no such format, or the run lacks a file that it is made of.
    """
    if name not in EXPORTS:
        raise OutputError(f"unknown format {name!r}", choices=EXPORTS.names())
    write = EXPORTS.load(name)
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
        with replace_atomically(path) as temporary:
            temporary.write_bytes(data)
        written.append(path)
    return written
