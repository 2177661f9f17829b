"""``twin operate``: execute in the twin, with replanning after failures."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin.commands.options import (
    AsJson,
    Audited,
    AuditEngine,
    Quiet,
    Recording,
    ResultsFolder,
    ScenarioFile,
    Seed,
    Settings,
    TeamSize,
)
from twin.commands.run import values_of
from twin.commands.view import View
from twin.host.guard import guarded

if TYPE_CHECKING:
    from twin.operations.person import Question


@guarded
def operate(
    scenario: ScenarioFile,
    out: ResultsFolder = None,
    failures: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1,
            metavar="P",
            help="Probability that an attempt at any skill fails, a fifth of which "
            "lose the object; for skills without a rate in the scenario.",
        ),
    ] = None,
    recording: Recording = True,
    audit: Audited = True,
    audit_engine: AuditEngine = None,
    drivers: Annotated[
        Path | None,
        typer.Option(
            help="File with the driver of each robot, in place of simulated robots."
        ),
    ] = None,
    page: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65_535,
            metavar="PORT",
            help="With drivers, port of a page on this machine for people at the "
            "cell: state of the run, buttons, and the questions of "
            "recovery.ask; 0 for any free port.",
        ),
    ] = None,
    seed: Seed = None,
    shortcuts: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Maximum number of shortcuts tried on the first plan, in place of "
            "the scenario's.",
        ),
    ] = None,
    robots: TeamSize = None,
    settings: Settings = None,
    ask: Annotated[
        bool,
        typer.Option(
            "--ask",
            help="Ask at the keyboard, or on the page if there is one, before a "
            "step is abandoned; simulated time stops meanwhile, and the run "
            "cannot be resumed.",
        ),
    ] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Operate a cell in the twin: after failures the rest is replanned while the other robots continue.

    A skill that fails for good is retried, by another robot or with another object of its kind; infeasible
    steps are abandoned with all dependent ones, and the rest continues.
    """
    from twin.api.runs import released
    from twin.host.progress import report_nothing
    from twin.operations import api
    from twin.trial.loaded_scenario import load

    view = View(as_json, quiet)
    given: dict[str, Any] = {
        "robots": robots,
        "seed": seed,
        "planning.shortcut_candidates": shortcuts,
    }
    asks_here = ask and page is None

    def opened(address: str) -> None:
        if not view.silent:
            print(f"page: {address}", file=sys.stderr)  # noqa: T201

    with view.progress() as progress:
        chosen = load(scenario).varied(released(values_of(settings, given)))
        if ask and not asks_here and chosen.sections.execution.recovery.ask is None:
            chosen = chosen.varied({"recovery.ask": {}})
        done = api.operate(
            chosen,
            out=out,
            failures=failures,
            recording=recording,
            audit=audit,
            audit_engine=audit_engine,
            answer=_answer if asks_here else None,
            drivers=drivers,
            page=page,
            opened=opened,
            begun=view.announce_run,
            # A display of progress would write over the question.
            progress=report_nothing if asks_here else progress,
        )
    return view.show_run(done)


def _answer(question: Question) -> bool:
    """Ask a person at the terminal; an interrupt there interrupts the run."""
    try:
        return typer.confirm(str(question), err=True)
    except typer.Abort:
        raise KeyboardInterrupt from None
