"""Command ``twin replay``: opens the recording of a run, or renders pictures of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.host.guard import guarded


@guarded
def replay(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Folder of a run, or a .rrd file.")
    ],
    stills: Annotated[
        list[float] | None,
        typer.Option(
            metavar="SECONDS",
            help="Render a picture at this simulated time instead of opening the viewer,"
            " in seconds; may be given several times.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the pictures; default: stills beside the recording.",
        ),
    ] = None,
) -> None:
    """Open a run in the Rerun viewer, or render pictures of it."""
    from twin.rerun import api

    for picture in api.replay(run, stills=stills or (), out=out if stills else None):
        typer.echo(picture)
