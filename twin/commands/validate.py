"""``twin validate``, ``twin check`` and ``twin schema``: files, the cells in them, and what they may hold."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import twin
from planning.errors import ScenarioError
from twin.commands.options import AsJson, Quiet, ScenarioFile
from twin.host.guard import (
    BAD_INPUT,
    COMPLETED,
    describe,
    guarded,
    print_error,
    print_json,
)

if TYPE_CHECKING:
    from twin.check.check import CheckReport

Files = Annotated[list[Path], typer.Argument(help="Scenario files.", metavar="FILE...")]
Resolved = Annotated[
    bool,
    typer.Option("--resolved", help="Print each scenario with all defaults, as JSON."),
]
Picture = Annotated[
    Path | None,
    typer.Option("--out", help="Folder for the picture cell.png.", metavar="DIR"),
]


@guarded
def validate(files: Files, resolved: Resolved = False) -> int:
    """Check scenario files and report every problem in them."""
    from twin.planning.kind import assembly_kind

    code = COMPLETED
    for file in files:
        try:
            scenario = twin.load(file)
        except ScenarioError as error:
            print_error(describe(error))
            code = BAD_INPUT
            continue
        if resolved:
            print_json(scenario.resolved())
        else:
            supply = assembly_kind(scenario.sections.assembly).supply()
            typer.echo(
                f"{file}: ok ({len(scenario.robots)} robots, {scenario.steps} steps, {supply})"
            )
    return code


@guarded
def check(
    scenario: ScenarioFile,
    out: Picture = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Check a cell before planning: overlaps, reach, HOME, grippers, tool frames and speeds.

    Errors make every plan impossible or false and end with code 2; warnings do not.
    """
    from twin.host.progress import StageDisplay, compilation_shown

    silent = quiet or as_json
    with (
        StageDisplay(enabled=not silent) as progress,
        compilation_shown(progress, silent=silent),
    ):
        found = twin.check(scenario, progress=progress)
    report = found.report
    picture = None if out is None else found.draw(out)
    if as_json:
        drawn = None if picture is None else str(picture)
        print_json({**report.content(), "picture": drawn})
    else:
        if report.errors or (report.warnings and not quiet):
            shown = report.errors if quiet else report.findings
            print_error(report.excerpts(shown).report())
        if not quiet:
            typer.echo(f"{scenario}: {verdict(report)}")
            if picture is not None:
                typer.echo(f"picture: {picture}")
    return BAD_INPUT if report.errors else COMPLETED


def verdict(report: CheckReport) -> str:
    """Return in words how many errors and warnings there are."""
    if not report.findings:
        return "nothing found"
    counts = (len(report.errors), "error"), (len(report.warnings), "warning")
    return ", ".join(f"{n} {word}{'s' * (n != 1)}" for n, word in counts if n)


@guarded
def schema() -> None:
    """Print the JSON schema of scenario files, for editors."""
    from twin.scenario.file import scenario_schema

    print_json(scenario_schema())
