"""``twin import``: create scenarios from files of other programs, a command per format."""

from __future__ import annotations

import typer

from twin.registry import IMPORTS

app = typer.Typer(
    no_args_is_help=True, help="Create scenarios from files of other programs."
)

for _name, _command in IMPORTS.load_all().items():
    app.command(_name)(_command)
