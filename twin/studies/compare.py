"""Function ``twin.compare``: executes a scenario under every policy, with the same paths and random draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.host.arguments import checks_arguments
from twin.host.atomic_files import write_json
from twin.host.progress import Report, StageWatch, report_nothing
from twin.planning.build_workcell import build_workcell
from twin.planning.pipeline import plan_motions
from twin.runs.folder import replace_results, run_folder
from twin.scenario.manifest import write_manifest
from twin.scenario.sections.execution import ReferenceDuration
from twin.scenario.sections.scenario import Scenario
from twin.studies.comparison import (
    SEEDS,
    comparison_figures,
    measure_policies,
    require_comparable,
)
from twin.studies.plans import shortcut_budget
from twin.studies.report.comparison_chart import draw_comparison, mean, percent, spread
from twin.trial.loaded_scenario import AnyScenario, LoadedScenario, PathOrName, load

if TYPE_CHECKING:
    import pyarrow as pa

COMPARISON, CHART = "compare.json", "compare.png"
"""Files of a comparison."""


@dataclass(frozen=True)
class Comparison:
    """Every policy on one scenario.

    Attributes:
        scenario: the planned and executed scenario.
        heading: title of the comparison.
        figures: by policy, the content of ``compare.json``.
        folder: of its files.
    """

    scenario: LoadedScenario
    heading: str
    figures: Mapping[str, Mapping[str, Any]]
    folder: Path

    def __repr__(self) -> str:
        """Return a one-line description."""
        size = f"{len(self.figures)} policies"
        return f"<comparison of {self.scenario.name!r}: {size}, in {self.folder}>"

    @property
    def policies(self) -> pa.Table:
        """Table with one row per policy: means and spreads of makespan, wait and planning time over seeds."""
        import pyarrow as pa

        rows = self.figures.items()

        def column(of: Callable[[Mapping[str, Any]], Any], part: str) -> pa.Array:
            found = [of(row) for _, row in rows]
            return pa.array([v and v[part] for v in found], pa.float64())

        return pa.table(
            {
                "policy": pa.array([name for name, _ in rows], pa.string()),
                "makespan_s": column(lambda row: row["makespan_s"], "mean"),
                "makespan_std_s": column(lambda row: row["makespan_s"], "std"),
                "relative_makespan": column(lambda r: r["relative_makespan"], "mean"),
                "wait_s": column(lambda row: row["wait_s"], "mean"),
                "planning_s": column(lambda row: row["planning_s"]["total"], "mean"),
            }
        )

    def _repr_html_(self) -> str:
        from twin.host.cards import run_picture
        from twin.studies.report.markup import escape_text, table

        head = ["policy", "makespan [s]", "of sequential", "wait [s]", "planning [s]"]
        rows = [
            [
                escape_text(name),
                spread(row["makespan_s"]),
                percent(row["relative_makespan"]),
                spread(row["wait_s"]),
                mean(row["planning_s"]["total"]),
            ]
            for name, row in self.figures.items()
        ]
        return table(self.heading, head, rows) + run_picture(self.folder / CHART)


@checks_arguments
def compare(
    scenario: AnyScenario,
    *,
    seeds: int = 4,
    shortcuts: int | None = None,
    reference_skills: bool = False,
    out: PathOrName | None = None,
    progress: Report = report_nothing,
) -> Comparison:
    """Plan a scenario with several seeds and execute it under every policy.

    Sequential, synchronous and asynchronous, with and without shortcuts: all from the same
    paths, with the same skill durations. Leaves makespan and wait with what no coordination can
    beat, and planning time by stage: ``compare.json`` and ``compare.png``.

    Args:
        scenario: a scenario, or the path of its file.
        seeds: how many, counted from the scenario's.
        shortcuts: most that are tried on each plan, in place of the scenario's.
        reference_skills: skills take as long as their reference paths, as in the simulations of the
            APEX-MR paper, in place of the scenario's durations.
        out: folder for ``compare.json`` and ``compare.png``; by default
            ``logs/<scenario>-<UTC time>``.
        progress: receives the progress of each stage.

    Raises:
        OutputError: the folder cannot be written to.
        TwinError: the scenario cannot be planned; see ``twin.plan``.
    """
    loaded = load(scenario)
    chosen, base = loaded.sections, loaded.folder
    if reference_skills:
        chosen = follow_references(chosen)
    candidates = shortcut_budget(chosen) if shortcuts is None else shortcuts
    numbers = range(chosen.seed, chosen.seed + seeds)
    with run_folder(out, chosen.name) as folder:
        found = {}
        require_comparable(chosen)
        for k, seed in enumerate(numbers):
            progress(SEEDS, k, seeds)
            own = chosen.model_copy(update={"seed": seed})
            turns = plan_motions(own, base, watch := StageWatch(progress))
            found[seed] = measure_policies(
                turns, own, watch, candidates=candidates, base=base
            )
        progress(SEEDS, seeds, seeds)
        figures = comparison_figures(found)
        counted = f"{seeds} seed" + ("s" if seeds > 1 else "")
        heading = f"{chosen.name}: {counted}, {candidates} shortcuts tried"
        if reference_skills:
            heading += ", skills follow their reference paths"
        with replace_results(folder):
            write_manifest(
                folder,
                chosen,
                build_workcell(chosen, base),
                base,
                seeds=list(numbers),
                shortcut_candidates=candidates,
            )
            draw_comparison(folder / CHART, {chosen.name: figures}, heading)
            write_json(folder / COMPARISON, figures)
    return Comparison(loaded, heading, figures, folder)


def follow_references(scenario: Scenario) -> Scenario:
    """Return a scenario in which every skill but processes lasts as long as its reference path.

    That is how APEX-MR V-A executes skills in simulation: without force control, the same each time.
    """
    reference = ReferenceDuration(kind="reference")
    own = scenario.execution.skills
    skills = {
        name: own[name] if name in scenario.processes else reference for name in own
    }
    execution = scenario.execution.model_copy(
        update={"skills": skills, "skill_overrides": ()}
    )
    return scenario.model_copy(update={"execution": execution})
