"""``twin import``: scenarios from the files of other programs."""

from __future__ import annotations

import typer

from twin.commands.imports.apex_mr import apex_mr
from twin.commands.imports.brick_models import bricks, ldraw

app = typer.Typer(
    no_args_is_help=True, help="Make scenarios from the files of other programs."
)
app.command("apex-mr")(apex_mr)
app.command("bricks")(bricks)
app.command("ldraw")(ldraw)
