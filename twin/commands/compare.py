"""``twin compare``: one scenario under every policy, with the same paths and the same draws."""

from __future__ import annotations

from typing import Annotated

import typer

import twin
from twin.commands.options import AsJson, Out, Quiet, ScenarioFile, Shortcuts
from twin.host.guard import COMPLETED, guarded, print_json

Seeds = Annotated[
    int, typer.Option(min=1, help="How many seeds, counted from the scenario's.")
]
References = Annotated[
    bool,
    typer.Option(
        "--reference-skills",
        help="Skills take as long as their reference paths, as in the simulations of the"
        " APEX-MR paper, in place of the scenario's durations.",
    ),
]


@guarded
def compare(
    scenario: ScenarioFile,
    seeds: Seeds = 4,
    shortcuts: Shortcuts = None,
    reference_skills: References = False,
    out: Out = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Plan a scenario with several seeds and execute it under every policy.

    Sequential, synchronous and asynchronous, with and without shortcuts: all from the same
    paths, with the same skill durations. Shows makespan and wait with what no coordination
    can beat, and planning time by stage; leaves compare.json and compare.png.
    """
    from twin.host.progress import StageDisplay, compilation_shown

    silent = quiet or as_json
    with (
        StageDisplay(enabled=not silent) as progress,
        compilation_shown(progress, silent=silent) as compiled,
    ):
        found = twin.compare(
            twin.load(scenario),
            seeds=seeds,
            shortcuts=shortcuts,
            reference_skills=reference_skills,
            out=out,
            progress=progress,
        )
    if as_json:
        print_json(found.figures)
    elif not quiet:
        from twin.comparison.table import print_comparison

        print_comparison(
            found.figures, found.folder, heading=found.heading, compiled=compiled() > 0
        )
    return COMPLETED
