"""``twin run``: execute in the twin; ``twin resume``: complete a run whose process was killed.

A plan is made by ``twin/trial/planning.py`` and executed by ``twin/engine/execution.py``, whose dispatcher
clears nodes for robots.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import typer

from planning.errors import ScenarioError
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
    Shortcuts,
    TeamSize,
)
from twin.commands.view import View
from twin.host.guard import guarded


@guarded
def run(
    scenario: ScenarioFile,
    out: ResultsFolder = None,
    recording: Recording = True,
    audit: Audited = True,
    audit_engine: AuditEngine = None,
    seed: Seed = None,
    plan: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Execute the plan in this folder of an earlier run."
        ),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            help="Asynchronous, sequential, synchronous or open-loop, in place of the scenario's."
        ),
    ] = None,
    stalls: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Random standstills of each robot, in place of the scenario's.",
        ),
    ] = None,
    shortcuts: Shortcuts = None,
    robots: TeamSize = None,
    settings: Settings = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Plan a scenario, execute it in the twin, audit the run, and print its figures."""
    from twin.api import runs
    from twin.trial.loaded_scenario import load
    from twin.trial.plan_result import read_plan

    view = View(as_json, quiet)
    given = {
        "robots": robots,
        "seed": seed,
        "planning.shortcut_candidates": shortcuts,
        "policy": policy,
        "stalls.count_per_robot": stalls,
    }
    with view.progress() as progress:
        chosen = load(scenario).varied(runs.released(values_of(settings, given)))
        done = runs.run(
            chosen if plan is None else read_plan(plan, chosen),
            out=out,
            recording=recording,
            audit=audit,
            audit_engine=audit_engine,
            begun=view.announce_run,
            progress=progress,
        )
    return view.show_run(done)


@guarded
def resume(
    logdir: Annotated[
        Path, typer.Argument(metavar="LOGDIR", help="Folder of the run.")
    ],
    base: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Where relative paths of the scenario start; default: where they did.",
        ),
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Resume a simulated run from its event log after its process was killed.

    The run is computed again from the start, compared with the log event by event, and completed: the files
    are those of an uninterrupted run.
    """
    from twin.runs.folder import lock_folder
    from twin.trial.resume import resume_run

    view = View(as_json, quiet)
    with view.progress() as progress, lock_folder(logdir):
        done = resume_run(logdir, base=base, progress=progress)
    if not view.silent:
        words = "the run has come to its end already"
        if done.resumed is not None:
            agreed, added = done.resumed
            words = f"{agreed} events of the log happened again, {added} were missing"
        typer.echo(f"{done.folder}: {words}")
    return view.show_run(done)


def values_of(
    settings: Sequence[str] | None,
    given: Mapping[str, Any] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return the values by key of the given options, then of ``--set``.

    Raises:
        ScenarioError: a setting has no value, or several.
    """
    from twin.scenario.variations import Variation

    found = {key: value for key, value in given.items() if value is not None}
    for text in settings or ():
        variation = Variation.parse(text)
        if len(variation.values) > 1:
            raise ScenarioError(f"--set {text}: give one value")
        found[variation.key] = variation.values[0]
    return found
