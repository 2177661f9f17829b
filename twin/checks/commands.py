"""Commands ``twin check`` (checks of a cell before planning) and ``twin robots`` (data sheets of robots and tools)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from planning.errors import RequestError
from twin.commands.options import AsJson, Quiet, ScenarioFile
from twin.commands.view import View
from twin.host.guard import ExitCode, guarded, print_error, print_json

if TYPE_CHECKING:
    from rich.table import Table

    from twin.checks.check import CheckReport
    from twin.checks.robot_sheet import PicturedThing


@guarded
def check(
    scenario: ScenarioFile,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the picture cell.png."),
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Check a cell before planning: overlaps, reach, HOME, grippers, tool frames and speeds.

    Errors make every plan impossible or false, and end the command with code 2; warnings do not.
    """
    from twin.checks import api

    view = View(as_json, quiet)
    with view.progress() as progress:
        found = api.check(scenario, progress=progress)
    report = found.report
    picture = None if out is None else found.draw(out)
    if view.as_json:
        drawn = None if picture is None else str(picture)
        print_json({**report.content(), "picture": drawn})
    else:
        if report.errors or (report.warnings and not view.quiet):
            shown = report.errors if view.quiet else report.findings
            print_error(report.excerpts(shown).report())
        if not view.quiet:
            for fit in report.fits:
                typer.echo(f"step {fit.step}: {fit.words}")
            for note in report.notes:
                typer.echo(note)
            typer.echo(f"{scenario}: {verdict(report)}")
            if picture is not None:
                typer.echo(f"picture: {picture}")
    return ExitCode.BAD_INPUT if report.errors else ExitCode.COMPLETED


def verdict(report: CheckReport) -> str:
    """Return the numbers of errors and warnings as text."""
    if not report.findings:
        return "nothing found"
    counts = (len(report.errors), "error"), (len(report.warnings), "warning")
    return ", ".join(f"{n} {word}{'s' * (n != 1)}" for n, word in counts if n)


@guarded
def robots(
    model: Annotated[
        str | None,
        typer.Argument(
            metavar="MODEL",
            help="A name of the list, the URDF, xacro or MJCF file of a robot or a tool, or a"
            " scenario, of which every robot is shown with its tool.",
        ),
    ] = None,
    hold: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=VALUE",
            help="Hold a joint at a value [rad or m], as 'joints' does in a scenario.",
        ),
    ] = None,
    flange: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="The link that is the flange."),
    ] = None,
    xacro: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE", help="An argument of a description in xacro."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for a picture of each."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the robot models that a scenario can name, or show what is in one.

    Of a robot: joints with limits, links and where they are at HOME, the flange and the tool frames.
    Of a tool: joints that can be held, links and where they are, from the flange.
    """
    if model is None:
        _print_list(as_json)
        return
    from twin.checks.robot_sheet import robot_sheets

    arguments = dict(text.partition("=")[::2] for text in xacro or [])
    sheets = robot_sheets(model, _values(hold or []), flange, arguments)
    pictures = {sheet.title: _draw(sheet.picture, out) for sheet in sheets}
    if as_json:
        print_json(
            [{**sheet.content(), "picture": pictures[sheet.title]} for sheet in sheets]
        )
        return
    for sheet in sheets:
        typer.echo(sheet.title)
        for line in sheet.words:
            typer.echo(f"  {line}")
        for heading, columns, rows in sheet.tables:
            typer.echo("")
            typer.echo(heading)
            _print_table(_table(columns, rows))
        if pictures[sheet.title]:
            typer.echo(f"picture: {pictures[sheet.title]}")
        typer.echo("")


def _values(texts: Sequence[str]) -> dict[str, float]:
    out = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            out[name] = float(value)
        except ValueError:
            name = ""
        if not name:
            raise RequestError(
                f"--hold {text}: JOINT=VALUE expected, such as finger=0.02"
            )
    return out


def _draw(picture: PicturedThing, folder: Path | None) -> str | None:
    if folder is None:
        return None
    from twin.checks.robot_sheet import save_picture

    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{picture.title.split()[0]}.png"
    save_picture(picture, path)
    return str(path)


def _print_list(as_json: bool) -> None:
    from planning.robots.registry import ROBOTS

    if as_json:
        rows: list[dict[str, Any]] = [
            {
                "name": entry.name,
                "joints": len(entry.home),
                "source": entry.source,
                "licence": entry.licence,
                "note": entry.note,
                "limits_source": entry.limits_source,
            }
            for entry in ROBOTS.values()
        ]
        print_json(rows)
        return
    table = [
        (e.name, str(len(e.home)), e.note, e.source, e.licence) for e in ROBOTS.values()
    ]
    heads = ("name", "joints", "what it is", "description from", "licence")
    _print_table(_table(heads, table))
    typer.echo(
        "Any other robot: give `model:` the path of its URDF, xacro or MJCF file; twin robots FILE shows what is"
        " in it."
    )


def _table(columns: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Table:
    """Return a table that wraps cells and never truncates them."""
    from rich.table import Table

    table = Table()
    for name in columns:
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def _print_table(table: Table) -> None:
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        # A file has no width limit, unless one is requested, and is read by programs.
        table.box, width = None, os.environ.get("COLUMNS", "")
        console = Console(width=int(width) if width.isdecimal() else 10_000)
    console.print(table, markup=False)
