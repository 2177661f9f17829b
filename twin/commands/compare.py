"""``twin compare``: one scenario under every policy, with the same paths and the same draws."""

from __future__ import annotations

from typing import Annotated

import typer

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
    from twin.host.atomic import write_json
    from twin.host.progress import StageDisplay, compilation_shown
    from twin.planning.build_workcell import build_workcell
    from twin.run.folder import (
        CHART,
        COMPARISON,
        keep_new,
        run_folder,
        set_aside,
    )
    from twin.scenario.file import load_scenario
    from twin.scenario.manifest import write_manifest

    chosen = load_scenario(scenario)
    numbers = range(chosen.seed, chosen.seed + seeds)
    silent = quiet or as_json
    with (
        StageDisplay(enabled=not silent) as progress,
        compilation_shown(progress, silent=silent) as compiled,
        run_folder(out, chosen.name) as folder,
    ):
        from twin.comparison.chart import draw_comparison
        from twin.comparison.comparison import (
            SEEDS,
            comparison_figures,
            measure_policies,
            shortcut_budget,
        )
        from twin.scenario.sections.scenario import follow_references

        if reference_skills:
            chosen = follow_references(chosen)
        candidates = shortcut_budget(chosen) if shortcuts is None else shortcuts
        base, found = scenario.parent, {}
        for k, seed in enumerate(numbers):
            progress(SEEDS, k, seeds)
            found[seed] = measure_policies(
                chosen, seed, candidates=candidates, base=base, progress=progress
            )
        progress(SEEDS, seeds, seeds)
        figures = comparison_figures(found)
        set_aside(folder)
        write_manifest(
            folder,
            chosen,
            build_workcell(chosen, base),
            base,
            seeds=list(numbers),
            shortcut_candidates=candidates,
        )
        counted = f"{seeds} seed" + ("s" if seeds > 1 else "")
        heading = f"{chosen.name}: {counted}, {candidates} shortcuts tried"
        if reference_skills:
            heading += ", skills follow their reference paths"
        draw_comparison(folder / CHART, {chosen.name: figures}, heading)
        write_json(folder / COMPARISON, figures)
        keep_new(folder)
    if as_json:
        print_json(figures)
    elif not quiet:
        from twin.comparison.table import print_comparison

        print_comparison(figures, folder, heading=heading, compiled=compiled() > 0)
    return COMPLETED
