"""``twin export``: a run in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planning.errors import OutputError
from twin.host.guard import guarded

Run = Annotated[
    Path,
    typer.Argument(
        help="Folder of a run; for ldraw also a scenario file, without a run.",
        metavar="RUN",
    ),
]
Names = Annotated[
    list[str] | None,
    typer.Option(
        "--format",
        "-f",
        help="csv, parquet, perfetto, joint-trajectory, joint-csv, mcap, graphml, dot, "
        "task-graph, mermaid or ldraw; may be given several times.",
        metavar="FORMAT",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        help="File to write, or folder for several; default: RUN/exports.",
        metavar="PATH",
    ),
]
Nodes = Annotated[
    bool,
    typer.Option(
        "--nodes",
        help="Every node of the temporal plan graph, not one entry a task "
        "(graphml, dot, perfetto).",
    ),
]

Rate = Annotated[
    float | None,
    typer.Option(
        "--rate-hz",
        help="Points a second of motions within limits, 125 to 1000; default: 250 "
        "(joint-trajectory, joint-csv). Messages a second, 1 to 1000; default: 50 (mcap).",
        metavar="HZ",
    ),
]


@guarded
def export(
    run: Run,
    formats: Names = None,
    out: Out = None,
    nodes: Nodes = False,
    rate_hz: Rate = None,
) -> None:
    """Write a run as tables, timeline, trajectories or graph for other programs."""
    from twin.exports.formats import FORMATS, export_run
    from twin.trial.run_result import read_run

    names = list(dict.fromkeys(formats or []))
    unknown = [name for name in names if name not in FORMATS]
    if unknown or not names:
        what = f"unknown format {unknown[0]!r}" if unknown else "--format is missing"
        raise OutputError(f"--format: {what}" if unknown else what, choices=FORMATS)
    if out is not None and len(names) > 1:
        if out.is_file():
            raise OutputError(f"{out}: several formats need a folder, this is a file")
        out.mkdir(parents=True, exist_ok=True)
    if names == ["ldraw"] and run.is_file():
        typer.echo(_export_scenario(run, out))
        return
    found = read_run(run)
    for name in names:
        for path in export_run(found, name, out, nodes=nodes, rate_hz=rate_hz):
            typer.echo(path)


def _export_scenario(file: Path, out: Path | None) -> Path:
    """Write what a scenario builds as a model of LDraw; return the file."""
    from twin.exports.ldraw import ldraw_of_scenario
    from twin.host.atomic import replacing
    from twin.scenario.file import load_scenario
    from twin.scenario.sections.lego import LegoSection

    scenario = load_scenario(file)
    if not isinstance(scenario.assembly, LegoSection):
        raise OutputError(f"{file}: only a LEGO assembly is a model of LDraw")
    path = out or Path(f"{scenario.name}.ldr")
    if path.is_dir():
        path /= f"{scenario.name}.ldr"
    content = ldraw_of_scenario(scenario.assembly, scenario.name)
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return path
