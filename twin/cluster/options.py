"""Command-line options of commands that can compute on a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Scheduler = Annotated[
    str | None,
    typer.Option(
        help="Address of a Dask scheduler whose workers do the work: tls://host:port."
        " Files that the scenario names must be in the same folder on their machines."
    ),
]
Certificates = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Folder with the certificates of the scheduler."),
]
Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure",
        help="Use a tcp:// scheduler on another machine, unprotected.",
    ),
]
