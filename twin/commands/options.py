"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ScenarioFile = Annotated[
    Path,
    typer.Argument(
        help="Scenario file, or the name of one that twin scenarios lists.",
        metavar="SCENARIO",
    ),
]
Seed = Annotated[
    int | None, typer.Option(min=0, help="Seed, in place of the scenario's.")
]
Improve = Annotated[
    float | None,
    typer.Option(
        min=0,
        help="Seconds to search for better robots, objects, grips and supports, in place of the"
        " scenario's; what is found depends on the machine.",
    ),
]
Shortcuts = Annotated[
    int | None,
    typer.Option(
        min=0, help="Most shortcuts tried on each plan, in place of the scenario's."
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(help="Folder for the results; default: logs/<scenario>-<UTC time>."),
]
AuditEngine = Annotated[
    str | None,
    typer.Option(
        metavar="ENGINE",
        help="What the audit measures with, pybullet or coal; by default PyBullet where it is"
        " installed, else coal.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON only.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
