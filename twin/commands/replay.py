"""``twin replay``: look at a run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.host.guard import guarded

Folder = Annotated[
    Path, typer.Argument(help="Folder of a run, or a .rrd file.", metavar="RUN")
]
Stills = Annotated[
    list[float] | None,
    typer.Option(
        "--stills",
        help="Render a picture at this simulated time instead of opening the viewer, "
        "in seconds; may be given several times.",
        metavar="SECONDS",
    ),
]
Output = Annotated[
    Path | None,
    typer.Option("--out", help="Folder for the pictures.", metavar="DIR"),
]


@guarded
def replay(folder: Folder, stills: Stills = None, out: Output = None) -> None:
    """Open a run in the Rerun viewer, or render pictures of it."""
    from twin.run.replay import replay_run

    for picture in replay_run(folder, stills_s=tuple(stills or ()), out=out):
        typer.echo(picture)
