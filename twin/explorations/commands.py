"""``twin explore``: search for the best design of a robot cell."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.cluster.options import Certificates, Insecure, Scheduler
from twin.commands.options import AsJson, OptionalScenarioFile, Quiet
from twin.commands.view import View
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
            help="Instead of a search, evaluate changes of single keys of a "
            "working scenario (a base, a feeder, HOME, a grip, an order, a "
            "quicker tool), and report this many with the greatest gain per "
            "effort.",
        ),
    ] = None,
    sampler: Annotated[
        str | None,
        typer.Option(help="Tpe, cma-es, nsga-ii or random, in place of the section's."),
    ] = None,
    designs: Annotated[
        int | None,
        typer.Option(
            min=1, help="Number of designs to evaluate, in place of the section's."
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            help="Time in which new designs are tried, in place of the section's [s]."
        ),
    ] = None,
    replications: Annotated[
        int | None,
        typer.Option(
            "--replications",
            "-n",
            min=2,
            help="Replications of each design, in place of the section's.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0, help="Seed of all choices and draws, in place of the scenario's."
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Worker processes; by default one per core. With 1, the same seed "
            "gives the same result.",
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Resume the exploration in this folder; nothing is evaluated twice.",
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
    """Search the designs of a cell for the best ones, and estimate their gains.

    The section explore of the scenario has the varied keys and the goals. Each design is evaluated in rungs:
    check, reach, plan, full plan, replications; a refused design is listed with the reason.
    """
    from twin.cluster.commands import given_cluster
    from twin.explorations import api
    from twin.explorations.page_words import print_explored

    view = View(as_json, quiet)
    cluster = given_cluster(scheduler, certificates, insecure)
    with view.progress(items=True) as progress:
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
