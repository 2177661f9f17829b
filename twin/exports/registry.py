"""The formats that a run can be written in, found without importing any of them."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from planning.errors import OutputError
from twin.exports.exporter import Exporter, ExportOptions
from twin.exports.recorded_run import RecordedRun
from twin.host.atomic import replacing

FOLDER = "exports"
"""Where exports of a run go by default, in its folder."""


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes:
        about: what it is, in a few words.
        files: names of the files it consists of.
        module, exporter: where its exporter is.
    """

    about: str
    files: tuple[str, ...]
    module: str
    exporter: str


_TABLES = ("events", "trajectory", "objects")

FORMATS: dict[str, Format] = {
    "csv": Format(
        "tables for spreadsheets",
        tuple(f"{name}.csv" for name in _TABLES),
        "twin.exports.csv",
        "CsvExporter",
    ),
    "parquet": Format(
        "tables for pandas, Polars, DuckDB",
        tuple(f"{name}.parquet" for name in _TABLES),
        "twin.exports.parquet",
        "ParquetExporter",
    ),
    "perfetto": Format(
        "timeline for ui.perfetto.dev",
        ("trace.json",),
        "twin.exports.perfetto",
        "PerfettoExporter",
    ),
    "joint-trajectory": Format(
        "motions for controllers, as trajectory_msgs/JointTrajectory",
        ("joint_trajectories.json",),
        "twin.exports.joint_trajectory",
        "JointTrajectoryExporter",
    ),
    "graphml": Format(
        "temporal plan graph for yEd, Gephi, networkx",
        ("tpg.graphml",),
        "twin.exports.graphs",
        "GraphmlExporter",
    ),
    "dot": Format(
        "temporal plan graph for Graphviz",
        ("tpg.dot",),
        "twin.exports.graphs",
        "DotExporter",
    ),
    "mermaid": Format(
        "Gantt chart for Markdown pages",
        ("gantt.mmd",),
        "twin.exports.mermaid",
        "MermaidExporter",
    ),
}


def exporter(name: str) -> Exporter:
    """Return the exporter of a format.

    Raises:
        OutputError: there is no such format; lists those there are.
    """
    if name not in FORMATS:
        raise OutputError(f"unknown format {name!r}", choices=tuple(FORMATS))
    found: Exporter = getattr(
        import_module(FORMATS[name].module), FORMATS[name].exporter
    )()
    return found


def export_run(
    run: RecordedRun,
    name: str,
    out: Path | None = None,
    options: ExportOptions = ExportOptions(),  # noqa: B008 - frozen
) -> list[Path]:
    """Write a run in a format.

    Args:
        run: the run.
        name: of the format.
        out: a file for a format of one file, unless it is a folder that exists; a folder for one
            of several. By default the folder ``exports`` of the run.
        options: choices that some formats know.

    Returns:
        The files written.

    Raises:
        OutputError: there is no such format, the run lacks a file that the format is made of,
            or the files cannot be written.
    """
    content = exporter(name).export(run, options)
    target = run.folder / FOLDER if out is None else out
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
