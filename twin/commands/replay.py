"""``twin replay``: look at a run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planning.errors import OutputError
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
    from twin.run.folder import RECORDING
    from twin.run.viewer import open_viewer, render_stills

    recording = run if run.is_file() else run / RECORDING
    if not recording.is_file():
        reason = f"it has no {RECORDING}" if run.exists() else "no such file or folder"
        raise OutputError(f"{run}: nothing to replay, {reason}")
    if not stills:
        open_viewer(recording)
        return
    folder = out or recording.parent / "stills"
    for picture in render_stills(recording, stills, folder):
        typer.echo(picture)
