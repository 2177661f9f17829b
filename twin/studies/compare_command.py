"""Command ``twin compare``: a scenario under every policy, with several seeds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.commands.options import AsJson, Quiet, ScenarioFile
from twin.commands.view import View
from twin.host.guard import guarded

if TYPE_CHECKING:
    from twin.studies.compare import Comparison


@guarded
def compare(
    scenario: ScenarioFile,
    seeds: Annotated[
        int, typer.Option(min=1, help="Number of seeds, counted from the scenario's.")
    ] = 4,
    shortcuts: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Maximum number tried on each plan, in place of the scenario's.",
        ),
    ] = None,
    reference_skills: Annotated[
        bool,
        typer.Option(
            "--reference-skills",
            help="Skills take as long as their reference paths, as in the simulations of the"
            " APEX-MR paper, in place of the scenario's durations.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for compare.json and compare.png; by default"
            " logs/<scenario>-<UTC time>.",
        ),
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Plan a scenario with several seeds and execute it under every policy.

    Sequential, synchronous and asynchronous, with and without shortcuts: all from the same paths, with the
    same skill durations. Writes makespans and wait times, lower bounds, and planning times by stage:
    ``compare.json`` and ``compare.png``.
    """
    from twin.studies import compare as comparison_api

    view = View(as_json, quiet)
    with view.progress() as progress:
        found = comparison_api.compare(
            scenario,
            seeds=seeds,
            shortcuts=shortcuts,
            reference_skills=reference_skills,
            out=out,
            progress=progress,
        )
    _show_comparison(found, view)


def _show_comparison(found: Comparison, view: View) -> None:
    from twin.studies.report.comparison_chart import print_comparison

    figures, folder, heading = found.figures, found.folder, found.heading
    view.output(
        figures,
        lambda: print_comparison(
            figures, folder, heading=heading, compiled=view.compiled
        ),
    )
