"""``twin init`` and ``twin scenarios``: something that works, to begin with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.commands.options import AsJson, Quiet
from twin.host.guard import guarded, print_json

Target = Annotated[
    Path,
    typer.Argument(help="Folder, or YAML file, for the new scenario.", metavar="PATH"),
]
Source = Annotated[
    str | None,
    typer.Option(
        "--from",
        help="Scenario to begin with, one that twin scenarios lists; by default two arms with"
        " grippers that put five parts into a tray.",
        metavar="NAME",
    ),
]


@guarded
def init(path: Target, source: Source = None, quiet: Quiet = False) -> None:
    """Begin a scenario of one's own with one that works; nothing is overwritten."""
    from twin.scenario.shipped import TEMPLATE, begin_scenario

    file = begin_scenario(path, source or TEMPLATE)
    if quiet:
        return
    typer.echo(f"{file}: a copy of {source or TEMPLATE}. Try")
    for command in ("check", "run", "study"):
        typer.echo(f"  twin {command} {file}")


@guarded
def scenarios(as_json: AsJson = False) -> None:
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
