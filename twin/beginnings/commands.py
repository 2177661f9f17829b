"""``twin init``: create a new scenario from a working template."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.commands.options import Quiet
from twin.host.guard import guarded
from twin.registry import HOOKS


@guarded
def init(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="PATH", help="Folder, or YAML file, for the new scenario."
        ),
    ],
    source: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="NAME",
            help="Scenario to start from: one that twin scenarios lists, or a "
            "design found by twin explore, EXPLORED#3 for the third best; by "
            "default two arms with grippers that put five parts into a tray.",
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write a new scenario from a working one; existing files are not overwritten."""
    from twin.beginnings.beginning import TEMPLATE, create_scenario

    file = None
    if source is not None and "design" in HOOKS:
        file = HOOKS.load("design")(path, source)
    file = file or create_scenario(path, source or TEMPLATE)
    if quiet:
        return
    typer.echo(f"{file}: a copy of {source or TEMPLATE}. Try")
    for step in ("check", "run", "study"):
        typer.echo(f"  twin {step} {file}")
