"""``twin run`` and ``twin resume``: plan, execute in the twin, check, and show the figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import twin
from planning.errors import ScenarioError
from twin.commands.options import (
    AsJson,
    AuditEngine,
    Improve,
    Out,
    Quiet,
    ScenarioFile,
    Seed,
    Shortcuts,
)
from twin.host.guard import (
    COMPLETED,
    FAILED,
    INTERRUPTED,
    guarded,
    print_error,
    print_json,
)

Plan = Annotated[
    Path | None,
    typer.Option(
        help="Execute the plan in this folder of an earlier run.", metavar="DIR"
    ),
]
PolicyName = Annotated[
    str | None,
    typer.Option(
        help="asynchronous, sequential, synchronous or open-loop, in place of the "
        "scenario's."
    ),
]
Stalls = Annotated[
    int | None,
    typer.Option(
        min=0, help="Random standstills of each robot, in place of the scenario's."
    ),
]
Robots = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="M",
        help="Robots of the team, in place of the scenario's; without a team, the first M.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Value of any key, such as cell.robots.left.base.xyz_m.0=0.7, or of one of the "
        "execution section, such as stalls.rate_per_h=60; may be given several times. Values "
        "are words or JSON.",
        metavar="KEY=VALUE",
    ),
]
Audit = Annotated[
    bool,
    typer.Option(
        "--audit/--no-audit", help="Check what was executed with code of its own."
    ),
]
Recording = Annotated[
    bool,
    typer.Option("--recording/--no-recording", help="Write run.rrd for the viewer."),
]


@guarded
def run(
    scenario: ScenarioFile,
    seed: Seed = None,
    out: Out = None,
    plan: Plan = None,
    policy: PolicyName = None,
    stalls: Stalls = None,
    shortcuts: Shortcuts = None,
    improve: Improve = None,
    robots: Robots = None,
    settings: Settings = None,
    audit: Audit = True,
    audit_engine: AuditEngine = None,
    recording: Recording = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Plan a scenario, execute it in the twin, check it, and show the figures."""
    from twin.api.runs import released
    from twin.host.progress import StageDisplay, compilation_shown

    given = {
        "robots": robots,
        "seed": seed,
        "planning.shortcut_candidates": shortcuts,
        "planning.improve_s": improve,
        "policy": policy,
        "stalls.count_per_robot": stalls,
    }
    values = {key: value for key, value in given.items() if value is not None}
    values |= _values(settings or [])
    silent = quiet or as_json

    def begun(check: twin.Check, folder: Path) -> None:
        if not silent:
            _announce(check, folder)

    with (
        StageDisplay(enabled=not silent) as progress,
        compilation_shown(progress, silent=silent) as compiled,
    ):
        chosen = twin.load(scenario).varied(released(values))
        done = twin.run(
            chosen if plan is None else twin.read_plan(plan, chosen),
            out=out,
            recording=recording,
            audit=audit,
            audit_engine=audit_engine,
            begun=begun,
            progress=progress,
        )
    if as_json:
        print_json({"folder": str(done.folder), **done.summary})
    elif not quiet:
        from twin.run.summary import print_summary

        assert done.folder is not None
        print_summary(
            done.summary, done.folder, recording=recording, compiled=compiled() > 0
        )
    if done.outcome == "aborted":
        print_error(f"interrupted; what happened until then is in {done.folder}")
        return INTERRUPTED
    return COMPLETED if done.passed else FAILED


def _values(settings: list[str]) -> dict[str, Any]:
    """Return the keys that are set, and their values."""
    from twin.scenario.variations import parse_variation

    found = {}
    for text in settings:
        variation = parse_variation(text)
        if len(variation.values) > 1:
            raise ScenarioError(f"--set {text}: give one value")
        found[variation.key] = variation.values[0]
    return found


def _announce(check: twin.Check, folder: Path) -> None:
    """Print the warnings of a check, and what is run into which folder."""
    from rich.console import Console

    report, case = check.report, check.scenario
    if report.warnings:
        print_error(report.excerpts(report.warnings).report())
    console = Console(stderr=True, highlight=False)
    console.print(
        f"{case.name}: {len(case.robots)} robots, "
        f"{case.steps} steps, seed {case.sections.seed} -> {folder}"
    )


Folder = Annotated[Path, typer.Argument(help="Folder of the run.", metavar="LOGDIR")]
Base = Annotated[
    Path | None,
    typer.Option(
        help="Where relative paths of the scenario start; default: where they did.",
        metavar="DIR",
    ),
]


@guarded
def resume(
    folder: Folder, base: Base = None, as_json: AsJson = False, quiet: Quiet = False
) -> int:
    """Go on with a simulated run from its event log, after its process was killed.

    The run is computed again from the start, compared with the log event by event, and brought
    to its end: the files are those of a run that was never killed.
    """
    from twin.host.progress import StageDisplay
    from twin.run.folder import locked
    from twin.trial.trial import resume_run

    silent = quiet or as_json
    with locked(folder), StageDisplay(enabled=not silent) as progress:
        done = resume_run(folder, base=base, progress=progress)
    summary = done.summary
    if as_json:
        print_json({"folder": str(folder), **summary})
    elif not quiet:
        from twin.run.folder import RECORDING
        from twin.run.summary import print_summary

        if done.resumed is None:
            typer.echo(f"{folder}: the run has come to its end already")
        else:
            typer.echo(
                f"{folder}: {done.resumed.agreed} events of the log happened again,"
                f" {done.resumed.added} were missing"
            )
        print_summary(summary, folder, recording=(folder / RECORDING).exists())
    return COMPLETED if done.passed else FAILED
