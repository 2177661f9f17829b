"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_SCENARIO = typer.Argument(
    metavar="SCENARIO",
    help="Scenario file, or the name of one that twin scenarios lists.",
)
ScenarioFile = Annotated[Path, _SCENARIO]
OptionalScenarioFile = Annotated[Path | None, _SCENARIO]

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON only.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]

ResultsFolder = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder for the results; by default logs/<scenario>-<UTC time>.",
    ),
]
Seed = Annotated[
    int | None, typer.Option(min=0, help="Seed, in place of the scenario's.")
]
Shortcuts = Annotated[
    int | None,
    typer.Option(
        min=0,
        help="Maximum number of shortcuts tried on each plan, in place of the "
        "scenario's.",
    ),
]
TeamSize = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="M",
        help="Number of robots of the team, in place of the scenario's; without a "
        "team, the first M.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Value of any key, such as cell.robots.left.base.xyz_m.0=0.7, or of one of the"
        " execution section, such as stalls.rate_per_h=60; may be given several times."
        " Values are words or JSON.",
    ),
]
Recording = Annotated[bool, typer.Option(help="Write run.rrd for the viewer.")]
Audited = Annotated[
    bool,
    typer.Option(help="Audit the executed run, by code independent of the planner."),
]
AuditEngine = Annotated[
    str | None,
    typer.Option(
        metavar="ENGINE",
        help="Collision engine of the audit, pybullet or coal; by default PyBullet "
        "where it is installed, else coal.",
    ),
]
