"""``twin replay``: look at a run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import twin
from twin.host.guard import guarded

Folder = Annotated[
    Path, typer.Argument(help="Folder of a run, or a .rrd file.", metavar="RUN")
]
Stills = Annotated[
    list[float] | None,
    typer.Option(
        help="Render a picture at this simulated time instead of opening the viewer, "
        "in seconds; may be given several times.",
        metavar="SECONDS",
    ),
]
Output = Annotated[
    Path | None,
    typer.Option(
        help="Folder for the pictures; default: stills beside the recording.",
        metavar="DIR",
    ),
]


@guarded
def replay(run: Folder, stills: Stills = None, out: Output = None) -> None:
    """Open a run in the Rerun viewer, or render pictures of it."""
    written = twin.replay(run, stills=stills or (), out=out if stills else None)
    for picture in written:
        typer.echo(picture)
