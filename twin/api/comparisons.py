"""``twin.compare``: one scenario under every policy, with the same paths and the same draws.

``twin.replay``: look at a run in the viewer, as pictures, or as a recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from planning.errors import OutputError, RequestError
from twin.comparison.chart import draw_comparison, mean, percent, spread
from twin.comparison.comparison import (
    SEEDS,
    comparison_figures,
    measure_policies,
    shortcut_budget,
)
from twin.host.guard import replacing, write_json
from twin.host.progress import Report, report_nothing
from twin.planning.build_workcell import build_workcell
from twin.run.folder import CHART, COMPARISON, RECORDING, new_results, run_folder
from twin.run.viewer import open_viewer, render_stills
from twin.scenario.manifest import write_manifest
from twin.scenario.sections.scenario import follow_references
from twin.trial.loaded_scenario import AnyScenario, LoadedScenario, PathOrName, load

if TYPE_CHECKING:
    import pyarrow as pa

    from twin.trial.loaded_scenario import PathOrName
    from twin.trial.run_result import RunResult


@dataclass(frozen=True)
class Comparison:
    """Every policy on one scenario.

    Attributes:
        scenario: what was planned and executed.
        heading: what was compared, in words.
        figures: by policy, the content of ``compare.json``.
        folder: of its files.
    """

    scenario: LoadedScenario
    heading: str
    figures: Mapping[str, Mapping[str, Any]]
    folder: Path

    @property
    def policies(self) -> pa.Table:
        """A row a policy: mean makespan, wait and planning time, and spreads over the seeds."""
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
        from twin.drawing.markup import shown, table, text

        head = ["policy", "makespan [s]", "of sequential", "wait [s]", "planning [s]"]
        rows = [
            [
                text(name),
                spread(row["makespan_s"]),
                percent(row["relative_makespan"]),
                spread(row["wait_s"]),
                mean(row["planning_s"]["total"]),
            ]
            for name, row in self.figures.items()
        ]
        return table(self.heading, head, rows) + shown(self.folder / CHART)


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
        progress: told how far each stage has come.

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
    with run_folder(None if out is None else Path(out), chosen.name) as folder:
        found = {}
        for k, seed in enumerate(numbers):
            progress(SEEDS, k, seeds)
            found[seed] = measure_policies(
                chosen, seed, candidates=candidates, base=base, progress=progress
            )
        progress(SEEDS, seeds, seeds)
        figures = comparison_figures(found)
        counted = f"{seeds} seed" + ("s" if seeds > 1 else "")
        heading = f"{chosen.name}: {counted}, {candidates} shortcuts tried"
        if reference_skills:
            heading += ", skills follow their reference paths"
        with new_results(folder):
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


STILLS = "stills"
"""Folder of pictures beside a recording."""


def replay(
    run: RunResult | PathOrName,
    *,
    stills: Sequence[float] = (),
    out: PathOrName | None = None,
) -> tuple[Path, ...]:
    """Look at a run again.

    Without stills and ``out`` this opens the viewer and returns once it is closed. Pictures need
    no display, but a Vulkan driver; a software one does.

    Args:
        run: a run, its folder, or an ``.rrd`` file.
        stills: render pictures at these simulated times instead [s].
        out: folder for the pictures, by default ``stills`` beside the recording; without stills,
            the ``.rrd`` file that is written instead of opening the viewer.

    Returns:
        The files that were written.

    Raises:
        OutputError: there is no recording, or a file cannot be written.
        ViewerError: the viewer or a display is missing; says what to do then.
        RequestError: pictures of a run without a folder need one.
    """
    with TemporaryDirectory() as name:
        if out is not None and not stills:
            return (_written(run, Path(out)),)
        recording = _recording(run, Path(name) / RECORDING)
        if not stills:
            open_viewer(recording)
            return ()
        if out is None and recording.parent == Path(name):
            raise RequestError("a run without a folder: say where pictures go by out")
        folder = recording.parent / STILLS if out is None else Path(out)
        return tuple(render_stills(recording, stills, folder))


def _written(run: RunResult | PathOrName, place: Path) -> Path:
    """Write the recording of a run to a place."""
    found = _recording(run, place)
    if found != place:
        with replacing(place) as temporary:
            temporary.write_bytes(found.read_bytes())
    return place


def _recording(run: RunResult | PathOrName, place: Path) -> Path:
    """Return the recording of a run; written to a place where there is none."""
    if not isinstance(run, str | PathLike):
        if run.record is not None and run.folder is None:
            from twin.recorders.rerun.recorder import write_recording

            write_recording(place, run.tpg, run.record, run.history, name=run.name)
            return place
        folder = Path() if run.folder is None else run.folder
    else:
        folder = Path(run)
    found = folder if folder.is_file() else folder / RECORDING
    if not found.is_file():
        reason = (
            f"it has no {RECORDING}" if folder.exists() else "no such file or folder"
        )
        raise OutputError(f"{folder}: nothing to replay, {reason}")
    return found
