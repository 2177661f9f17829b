"""``twin robots``: the robots that a scenario can name, and what is in the description of one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from planning.errors import RequestError
from twin.commands.command import command
from twin.host.guard import print_json

if TYPE_CHECKING:
    from rich.table import Table

    from twin.check.robot_sheet import PicturedThing


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
    if not console.is_terminal:  # a file has room
        console = Console(width=10_000)
    console.print(table, markup=False)


robots = command(
    f"{__name__}:show_robots",
    hold={"metavar": "JOINT=VALUE"},
    flange={"metavar": "LINK"},
)
