"""``twin run``, ``twin resume`` and ``twin replay``: execute in the twin, and look at what happened."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from planning.errors import ScenarioError
from twin.commands.command import View, command
from twin.host.guard import COMPLETED, FAILED, INTERRUPTED, print_error, print_json

if TYPE_CHECKING:
    from twin.api.runs import Check
    from twin.host.progress import Report
    from twin.trial.run_result import RunResult


def run_scenario(
    scenario: Path,
    *,
    seed: int | None = None,
    out: Path | None = None,
    plan: Path | None = None,
    policy: str | None = None,
    stalls: int | None = None,
    shortcuts: int | None = None,
    improve: float | None = None,
    robots: int | None = None,
    settings: Sequence[str] = (),
    audit: bool = True,
    audit_engine: str | None = None,
    recording: bool = True,
    view: View,
    progress: Report,
) -> RunResult:
    """Plan a scenario, execute it in the twin, check it, and show the figures.

    Args:
        scenario: file, or the name of one that comes with the program.
        seed: in place of the scenario's.
        out: folder for the results; default: logs/<scenario>-<UTC time>.
        plan: execute the plan in this folder of an earlier run.
        policy: asynchronous, sequential, synchronous or open-loop, in place of the scenario's.
        stalls: random standstills of each robot, in place of the scenario's.
        shortcuts: most shortcuts tried on each plan, in place of the scenario's.
        improve: seconds to search for better robots, objects, grips and supports, in place of the
            scenario's; what is found depends on the machine.
        robots: of the team, in place of the scenario's; without a team, the first M.
        settings: value of any key, such as cell.robots.left.base.xyz_m.0=0.7, or of one of the
            execution section, such as stalls.rate_per_h=60; may be given several times. Values
            are words or JSON.
        audit: check what was executed with code of its own.
        audit_engine: what the audit measures with, pybullet or coal; by default PyBullet where it
            is installed, else coal.
        recording: write run.rrd for the viewer.
        view: how to show.
        progress: told how far each stage has come.
    """
    from twin.api import runs
    from twin.trial.loaded_scenario import load
    from twin.trial.plan_result import read_plan

    given = {
        "robots": robots,
        "seed": seed,
        "planning.shortcut_candidates": shortcuts,
        "planning.improve_s": improve,
        "policy": policy,
        "stalls.count_per_robot": stalls,
    }
    values = {key: value for key, value in given.items() if value is not None}
    values |= _values(settings)

    def begun(check: Check, folder: Path) -> None:
        if not view.silent:
            _announce(check, folder)

    chosen = load(scenario).varied(runs.released(values))
    return runs.run(
        chosen if plan is None else read_plan(plan, chosen),
        out=out,
        recording=recording,
        audit=audit,
        audit_engine=audit_engine,
        begun=begun,
        progress=progress,
    )


def _values(settings: Sequence[str]) -> dict[str, Any]:
    """Return the keys that are set, and their values."""
    from twin.scenario.variations import parse_variation

    found = {}
    for text in settings:
        variation = parse_variation(text)
        if len(variation.values) > 1:
            raise ScenarioError(f"--set {text}: give one value")
        found[variation.key] = variation.values[0]
    return found


def _announce(check: Check, folder: Path) -> None:
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


def _show(done: RunResult, view: View) -> int:
    """Print the figures of a run."""
    from twin.run.folder import RECORDING
    from twin.run.summary import print_summary

    folder = done.files
    if view.as_json:
        print_json({"folder": str(folder), **done.summary})
    elif not view.quiet:
        recording = (folder / RECORDING).exists()
        compiled = view.compiled()
        print_summary(done.summary, folder, recording=recording, compiled=compiled)
    if done.outcome == "aborted":
        print_error(f"interrupted; what happened until then is in {folder}")
        return INTERRUPTED
    return COMPLETED if done.passed else FAILED


def resume_in_folder(
    logdir: Path, *, base: Path | None = None, progress: Report
) -> RunResult:
    """Go on with a simulated run from its event log, after its process was killed.

    The run is computed again from the start, compared with the log event by event, and brought
    to its end: the files are those of a run that was never killed.

    Args:
        logdir: folder of the run.
        base: where relative paths of the scenario start; default: where they did.
        progress: told how far each stage has come.
    """
    from twin.run.folder import locked
    from twin.trial.trial import resume_run

    with locked(logdir):
        return resume_run(logdir, base=base, progress=progress)


def _show_resumed(done: RunResult, view: View) -> int:
    """Print what was missing of a run, and its figures."""
    if not view.silent:
        words = "the run has come to its end already"
        if done.resumed is not None:
            agreed, added = done.resumed
            words = f"{agreed} events of the log happened again, {added} were missing"
        typer.echo(f"{done.folder}: {words}")
    return _show(done, view)


def replay_run(
    run: Path, *, stills: Sequence[float] = (), out: Path | None = None
) -> None:
    """Open a run in the Rerun viewer, or render pictures of it.

    Args:
        run: folder of a run, or a .rrd file.
        stills: render a picture at this simulated time instead of opening the viewer, in seconds;
            may be given several times.
        out: folder for the pictures; default: stills beside the recording.
    """
    from twin.api.comparisons import replay

    for picture in replay(run, stills=stills, out=out if stills else None):
        typer.echo(picture)


run = command(
    f"{__name__}:run_scenario",
    _show,
    plan={"metavar": "DIR"},
    stalls={"min": 0},
    improve={"min": 0},
    robots={"min": 1, "metavar": "M"},
    settings={"names": ("--set",), "metavar": "KEY=VALUE"},
)
resume = command(f"{__name__}:resume_in_folder", _show_resumed, base={"metavar": "DIR"})
replay = command(f"{__name__}:replay_run", stills={"metavar": "SECONDS"})
