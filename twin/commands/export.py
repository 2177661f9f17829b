"""``twin export``: a run in the formats of other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import typer

from planning.errors import OutputError
from twin.commands.command import command


def export_files(
    run: Path,
    *,
    formats: Sequence[str] = (),
    out: Path | None = None,
    nodes: bool = False,
    rate_hz: float | None = None,
) -> None:
    """Write a run as tables, timeline, trajectories or graph for other programs.

    Args:
        run: folder of a run; for ldraw also a scenario file, without a run.
        formats: csv, parquet, perfetto, joint-trajectory, joint-csv, mcap, graphml, dot,
            task-graph or ldraw; may be given several times.
        out: file to write, or folder for several; default: RUN/exports.
        nodes: every node of the temporal plan graph, not one entry a task (graphml, dot,
            perfetto).
        rate_hz: points a second of motions within limits, 125 to 1000; default: 250
            (joint-trajectory, joint-csv). Messages a second, 1 to 1000; default: 50 (mcap).
    """
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
    from twin.host.guard import replacing
    from twin.scenario.manifest import load_scenario
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


export = command(
    f"{__name__}:export_files",
    formats={"names": ("--format", "-f"), "metavar": "FORMAT"},
    out={"names": ("--out", "-o"), "metavar": "PATH"},
    rate_hz={"metavar": "HZ"},
)
