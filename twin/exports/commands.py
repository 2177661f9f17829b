"""``twin export``: export a run to the file formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planning.errors import OutputError
from twin.host.guard import guarded


@guarded
def export(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN",
            help="Folder of a run; for ldraw also a scenario file, without a run.",
        ),
    ],
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            "-f",
            metavar="FORMAT",
            help="Csv, parquet, perfetto, joint-trajectory, joint-csv, mcap, graphml,"
            " task-graph, open-plan or ldraw; may be given several times.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="PATH",
            help="File to write, or folder for several; default: RUN/exports.",
        ),
    ] = None,
    nodes: Annotated[
        bool,
        typer.Option(
            "--nodes",
            help="Every node of the temporal plan graph, not one entry a task (graphml,"
            " perfetto).",
        ),
    ] = False,
    rate_hz: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Points a second of motions within limits, 125 to 1000; default: 250"
            " (joint-trajectory, joint-csv). Messages a second, 1 to 1000; default: 50"
            " (mcap).",
        ),
    ] = None,
) -> None:
    """Write a run as tables, timeline, trajectories or graph for other programs."""
    from twin.exports.formats import export_run
    from twin.registry import EXPORTS
    from twin.trial.run_result import read_run

    names = list(dict.fromkeys(formats or []))
    unknown = [name for name in names if name not in EXPORTS]
    if unknown or not names:
        what = f"unknown format {unknown[0]!r}" if unknown else "--format is missing"
        raise OutputError(
            f"--format: {what}" if unknown else what, choices=EXPORTS.names()
        )
    if out is not None and len(names) > 1:
        if out.is_file():
            raise OutputError(f"{out}: several formats need a folder, this is a file")
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{out}: cannot be made: {error.strerror}") from error
    if names == ["ldraw"] and run.is_file():
        typer.echo(_export_scenario(run, out))
        return
    found = read_run(run)
    for name in names:
        for path in export_run(found, name, out, nodes=nodes, rate_hz=rate_hz):
            typer.echo(path)


def _export_scenario(file: Path, out: Path | None) -> Path:
    """Write the structure of a scenario as an LDraw model; return the file."""
    from planning.files import replace_atomically
    from twin.kinds.lego.ldraw import ldraw_of_scenario
    from twin.reading.scenario_file import load_scenario

    scenario = load_scenario(file)
    content = ldraw_of_scenario(scenario, file)
    path = out or Path(f"{scenario.name}.ldr")
    if path.is_dir():
        path /= f"{scenario.name}.ldr"
    with replace_atomically(path) as temporary:
        temporary.write_bytes(content)
    return path
