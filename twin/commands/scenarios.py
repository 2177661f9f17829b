"""Files of scenarios: ``twin init``, ``scenarios``, ``validate``, ``check`` and ``schema``.

``twin robots``: the robots that a scenario can name, and what is in the description of one.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from planning.errors import RequestError, ScenarioError
from twin.commands.command import View, command
from twin.host.guard import BAD_INPUT, COMPLETED, describe, print_error, print_json

if TYPE_CHECKING:
    from rich.table import Table

    from twin.api.runs import Check
    from twin.check.check import CheckReport
    from twin.check.robot_sheet import PicturedThing


def begin(path: Path, *, source: str | None = None, quiet: bool = False) -> None:
    """Begin a scenario of one's own with one that works; nothing is overwritten.

    Args:
        path: folder, or YAML file, for the new scenario.
        source: scenario to begin with, one that twin scenarios lists, or a design that twin explore has
            found, EXPLORED#3 for the third best; by default two arms with grippers that put five parts
            into a tray.
    """
    from twin.scenario.shipped import TEMPLATE, begin_scenario

    if source is not None and _names_design(source):
        from twin.explore.folder import begin_design

        file = begin_design(path, source)
    else:
        file = begin_scenario(path, source or TEMPLATE)
    if quiet:
        return
    typer.echo(f"{file}: a copy of {source or TEMPLATE}. Try")
    for step in ("check", "run", "study"):
        typer.echo(f"  twin {step} {file}")


def _names_design(source: str) -> bool:
    """Tell whether a design of an exploration is meant, without a look at what finds them."""
    return "#" in source or (Path(source) / "journal.jsonl").is_file()


def list_scenarios(*, as_json: bool = False) -> None:
    """List the scenarios that come with the program; every command takes their names."""
    from rich.console import Console
    from rich.table import Table

    from planning.files import read_file
    from twin.scenario.document.yaml_text import read_yaml
    from twin.scenario.shipped import shipped_scenarios

    rows = []
    for name, path in shipped_scenarios().items():
        data = read_yaml(path, read_file(path).decode("utf-8")).data
        kind = data["assembly"]["kind"]
        about = data.get("description", "")
        rows.append(
            {"name": name, "kind": kind, "description": about, "file": str(path)}
        )
    if as_json:
        print_json(rows)
        return
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("name", "kind", "description"):
        table.add_column(heading, no_wrap=heading != "description")
    for row in sorted(rows, key=lambda row: (row["kind"], row["name"])):
        table.add_row(row["name"], row["kind"], row["description"])
    Console(highlight=False).print(table)
    typer.echo("twin run NAME runs one, twin init PATH --from NAME copies it.")


def validate_files(files: Sequence[Path], *, resolved: bool = False) -> int:
    """Check scenario files and report every problem in them.

    Args:
        files: scenario files.
        resolved: print each scenario with all defaults, as JSON.
    """
    from twin.scenario.sections.kind import assembly_kind
    from twin.trial.loaded_scenario import load

    code = COMPLETED
    for file in files:
        try:
            scenario = load(file)
        except ScenarioError as error:
            print_error(describe(error))
            code = BAD_INPUT
            continue
        if resolved:
            print_json(scenario.resolved())
        else:
            supply = assembly_kind(scenario.sections.assembly).supply()
            typer.echo(
                f"{file}: ok ({len(scenario.robots)} robots, {scenario.steps} steps, {supply})"
            )
    return code


def _show_check(found: Check, view: View) -> int:
    """Print what a check found, and draw the cell where that is wanted."""
    report, out = found.report, view.given["out"]
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
            typer.echo(f"{view.given['scenario']}: {verdict(report)}")
            if picture is not None:
                typer.echo(f"picture: {picture}")
    return BAD_INPUT if report.errors else COMPLETED


def verdict(report: CheckReport) -> str:
    """Return in words how many errors and warnings there are."""
    if not report.findings:
        return "nothing found"
    counts = (len(report.errors), "error"), (len(report.warnings), "warning")
    return ", ".join(f"{n} {word}{'s' * (n != 1)}" for n, word in counts if n)


def print_schema() -> None:
    """Print the JSON schema of scenario files, for editors."""
    from twin.scenario.manifest import scenario_schema

    print_json(scenario_schema())


init = command(f"{__name__}:begin", source={"names": ("--from",), "metavar": "NAME"})
scenarios = command(f"{__name__}:list_scenarios")
validate = command(f"{__name__}:validate_files", files={"metavar": "FILE..."})
check = command(
    "twin.api.runs:check",
    _show_check,
    out={
        "type": "Path | None",
        "metavar": "DIR",
        "help": "Folder for the picture cell.png.",
    },
)
schema = command(f"{__name__}:print_schema")


def show_robots(
    model: str | None = None,
    *,
    hold: Sequence[str] = (),
    flange: str | None = None,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """List the robot models that a scenario can name, or show what is in one.

    Of a robot: joints with limits, links and where they are at HOME, the flange and the tool frames.
    Of a tool: joints that can be held, links and where they are, from the flange.

    Args:
        model: a name of the list, the URDF or MJCF file of a robot or a tool, or a
            scenario, of which every robot is shown with its tool.
        hold: hold a joint at a value [rad or m], as 'joints' does in a scenario.
        flange: the link that is the flange.
        out: folder for a picture of each.
    """
    if model is None:
        _print_list(as_json)
        return
    from twin.check.robot_sheet import sheets_of

    sheets = sheets_of(model, _values(hold or []), flange)
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
    from twin.check.robot_sheet import save_picture

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
        "Any other robot: give `model:` the path of its URDF or MJCF file; twin robots FILE shows what is"
        " in it."
    )


def _table(columns: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Table:
    """Return a table whose cells are folded where there is no room, and never cut."""
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
        # A file has room, unless a width is asked for, and is read by programs.
        table.box, width = None, os.environ.get("COLUMNS", "")
        console = Console(width=int(width) if width.isdecimal() else 10_000)
    console.print(table, markup=False)


robots = command(
    f"{__name__}:show_robots",
    hold={"metavar": "JOINT=VALUE"},
    flange={"metavar": "LINK"},
)
