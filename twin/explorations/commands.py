"""``twin explore``: search among designs of a cell."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.commands.options import (
    AsJson,
    Certificates,
    Insecure,
    OptionalScenarioFile,
    Quiet,
    Scheduler,
)
from twin.commands.view import View, count_columns
from twin.host.guard import guarded


@guarded
def explore(
    scenario: OptionalScenarioFile = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help="Key=low..high, key=a,b,c or key=order, for any key of the scenario; in"
            " place of what its section explore varies."
        ),
    ] = None,
    single_changes: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Search for nothing, but try changes of one key of a scenario that works"
            " (a base, a feeder, HOME, a grip, an order, a quicker tool), and tell the so"
            " many that gain most for their effort.",
        ),
    ] = None,
    sampler: Annotated[
        str | None,
        typer.Option(help="Tpe, cma-es, nsga-ii or random, in place of the section's."),
    ] = None,
    designs: Annotated[
        int | None,
        typer.Option(min=1, help="How many are tried, in place of the section's."),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            help="For how long more are tried, in place of the section's [s]."
        ),
    ] = None,
    replications: Annotated[
        int | None,
        typer.Option(
            "--replications",
            "-n",
            min=2,
            help="Of each design, in place of the section's.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0, help="Of all choices and draws, in place of the scenario's."
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Processes; by default one a core. With 1 the same seed finds the same.",
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Go on with the exploration in this folder; nothing is evaluated twice.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the results; by default logs/explore-<scenario>-<UTC time>.",
        ),
    ] = None,
    scheduler: Scheduler = None,
    certificates: Certificates = None,
    insecure: Insecure = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Search among designs of a cell for the best, and say what it is worth.

    What may be different, and what is looked for, is in the section explore of the scenario. Each design
    is checked, then reached for, planned, planned in full and replicated; what is refused says why.
    """
    from twin.cluster.commands import given_cluster
    from twin.explorations import api
    from twin.explorations.page_words import print_explored

    view = View(as_json, quiet)
    cluster = given_cluster(scheduler, certificates, insecure)
    with view.progress(count_columns) as progress:
        found = api.explore(
            scenario,
            vary=vary or (),
            single_changes=single_changes,
            sampler=sampler,
            designs=designs,
            seconds=seconds,
            replications=replications,
            seed=seed,
            workers=workers,
            cluster=cluster,
            resume=resume,
            out=out,
            progress=progress,
        )
    view.output(found.summary, lambda: print_explored(found.found, found.folder))
