"""``twin run``: execute in the twin; and what is done with its folder then.

That is ``twin resume``, ``replay``, ``export`` and ``follow``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import typer

from planning.errors import OutputError, ScenarioError
from twin.commands.command import View, command
from twin.host.guard import COMPLETED, FAILED, INTERRUPTED, print_error, print_json

if TYPE_CHECKING:
    from twin.api.runs import Check
    from twin.follow.follow import News
    from twin.follow.state import FollowedRun
    from twin.host.progress import Report
    from twin.trial.run_result import RunResult


def run_scenario(
    scenario: Path,
    *,
    seed: int | None = None,
    plan: Path | None = None,
    policy: str | None = None,
    stalls: int | None = None,
    shortcuts: int | None = None,
    robots: int | None = None,
    settings: Sequence[str] = (),
    view: View,
    **options: Any,
) -> RunResult:
    """Plan a scenario, execute it in the twin, check it, and show the figures.

    Args:
        scenario: file, or the name of one that comes with the program.
        seed: in place of the scenario's.
        plan: execute the plan in this folder of an earlier run.
        policy: asynchronous, sequential, synchronous or open-loop, in place of the scenario's.
        stalls: random standstills of each robot, in place of the scenario's.
        shortcuts: most shortcuts tried on each plan, in place of the scenario's.
        robots: of the team, in place of the scenario's; without a team, the first M.
        settings: value of any key, such as cell.robots.left.base.xyz_m.0=0.7, or of one of the
            execution section, such as stalls.rate_per_h=60; may be given several times. Values
            are words or JSON.
        view: how to show.
        options: those of twin.run.
    """
    from twin.api import runs
    from twin.trial.loaded_scenario import load
    from twin.trial.plan_result import read_plan

    given = {
        "robots": robots,
        "seed": seed,
        "planning.shortcut_candidates": shortcuts,
        "policy": policy,
        "stalls.count_per_robot": stalls,
    }
    chosen = load(scenario).varied(runs.released(values_of(settings, given)))
    return runs.run(
        chosen if plan is None else read_plan(plan, chosen),
        begun=announcer(view),
        **options,
    )


def values_of(
    settings: Sequence[str], given: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, Any]:
    """Return the keys that are set, and their values, behind those of options that are given."""
    from twin.scenario.variations import parse_variation

    found = {key: value for key, value in given.items() if value is not None}
    for text in settings:
        variation = parse_variation(text)
        if len(variation.values) > 1:
            raise ScenarioError(f"--set {text}: give one value")
        found[variation.key] = variation.values[0]
    return found


def announcer(view: View) -> Callable[[Check, Path], None]:
    """Return what prints the warnings of a check, and what is run into which folder."""

    def begun(check: Check, folder: Path) -> None:
        from rich.console import Console

        if view.silent:
            return
        report, case = check.report, check.scenario
        if report.warnings:
            print_error(report.excerpts(report.warnings).report())
        console = Console(stderr=True, highlight=False)
        console.print(
            f"{case.name}: {len(case.robots)} robots, "
            f"{case.steps} steps, seed {case.sections.seed} -> {folder}"
        )

    return begun


def show_run(done: RunResult, view: View) -> int:
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


run = command(
    f"{__name__}:run_scenario",
    show_run,
    passes_to="twin.api.runs:run",
    stalls={"min": 0},
)


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
    return show_run(done, view)


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
    from twin.api.runs import replay

    for picture in replay(run, stills=stills, out=out if stills else None):
        typer.echo(picture)


resume = command(f"{__name__}:resume_in_folder", _show_resumed, base={"metavar": "DIR"})
replay = command(f"{__name__}:replay_run", stills={"metavar": "SECONDS"})


def export_files(
    run: Path,
    *,
    formats: Sequence[str] = (),
    out: Path | None = None,
    nodes: bool = False,
    rate_hz: float | None = None,
) -> None:
    """Write a run as tables, timeline, trajectories or graph for other programs.

    Args:
        run: folder of a run; for ldraw also a scenario file, without a run.
        formats: csv, parquet, perfetto, joint-trajectory, joint-csv, mcap, graphml,
            task-graph, open-plan or ldraw; may be given several times.
        out: file to write, or folder for several; default: RUN/exports.
        nodes: every node of the temporal plan graph, not one entry a task (graphml,
            perfetto).
        rate_hz: points a second of motions within limits, 125 to 1000; default: 250
            (joint-trajectory, joint-csv). Messages a second, 1 to 1000; default: 50 (mcap).
    """
    from twin.exports.formats import FORMATS, export_run
    from twin.trial.run_result import read_run

    names = list(dict.fromkeys(formats or []))
    unknown = [name for name in names if name not in FORMATS]
    if unknown or not names:
        what = f"unknown format {unknown[0]!r}" if unknown else "--format is missing"
        raise OutputError(f"--format: {what}" if unknown else what, choices=FORMATS)
    if out is not None and len(names) > 1:
        if out.is_file():
            raise OutputError(f"{out}: several formats need a folder, this is a file")
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{out}: cannot be made: {error.strerror}") from error
    if names == ["ldraw"] and run.is_file():
        typer.echo(_export_scenario(run, out))
        return
    found = read_run(run)
    for name in names:
        for path in export_run(found, name, out, nodes=nodes, rate_hz=rate_hz):
            typer.echo(path)


def _export_scenario(file: Path, out: Path | None) -> Path:
    """Write what a scenario builds as a model of LDraw; return the file."""
    from twin.host.guard import replacing
    from twin.kinds.lego.ldraw import ldraw_of_scenario
    from twin.scenario.manifest import load_scenario

    scenario = load_scenario(file)
    content = ldraw_of_scenario(scenario, file)
    path = out or Path(f"{scenario.name}.ldr")
    if path.is_dir():
        path /= f"{scenario.name}.ldr"
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return path


export = command(
    f"{__name__}:export_files",
    formats={"names": ("--format", "-f"), "metavar": "FORMAT"},
    out={"names": ("--out", "-o"), "metavar": "PATH"},
    rate_hz={"metavar": "HZ"},
)


def follow_events(
    plan: Path,
    events: str,
    *,
    every: float = 2.0,
    samples: int = 200,
    scenario: Path | None = None,
    once: bool = False,
    recording: Path | None = None,
    view: bool = False,
    web: bool = False,
    as_json: bool = False,
) -> int:
    """Follow a run in progress: what every robot does, and when it will all be done.

    Flags every event that the plan forbids, and forecasts the end of the run by drawing what is
    not done again and again. Ends with 1 when something forbidden happened or the run failed.

    Args:
        plan: folder with the plan, such as that of a run.
        events: event log of the run: a file that grows, the address http://.../events.jsonl of the page
            of a run, or - for standard input.
        every: time of the run between forecasts, in seconds.
        samples: futures that are drawn.
        scenario: scenario that durations and disturbances are taken from; default: that of
            the plan's folder.
        once: stop at the end of the file, do not wait.
        recording: write a recording for the Rerun viewer.
        view: open the Rerun viewer and show the run in it.
        web: serve the viewer to a browser of this machine, as long as the run is followed.
        as_json: print JSON lines: forecasts, violations, end.
    """
    from twin.follow.follow import follow as follow_run
    from twin.follow.follow import growing_file, piped, served
    from twin.follow.forecast import Forecaster
    from twin.follow.state import FollowedRun
    from twin.trial.plan_result import plan_history
    from twin.trial.simulation import followed_execution

    plans = plan_history(plan)
    tpg = plans.first
    name, model = followed_execution(plan, tpg, scenario)
    speed = model.disturbances.speed
    run = FollowedRun(tpg, model.policy, plans.version, plans.late, speed)
    forecaster = Forecaster(tpg, model, samples=samples)
    listeners = [_shown(run, name, json=as_json)]
    if recording is not None or view or web:
        from twin.follow.recording import LiveRecording

        viewer = _viewer(web=web) if view or web else None
        listeners.append(LiveRecording(run, recording, name=name, viewer=viewer))
    if events == "-":
        lines = piped(sys.stdin.buffer)
    elif events.startswith("http://"):
        lines = served(events)
    else:
        lines = growing_file(Path(events), wait=not once)
    follow_run(lines, run, forecaster, listeners, every_s=every)
    bad = bool(run.violations) or run.outcome == "failed"
    return FAILED if bad else COMPLETED


def _viewer(*, web: bool) -> str:
    """Start a viewer, and return where to send what it shows."""
    from twin.run.viewer import live_viewer, web_viewer

    if not web:
        return live_viewer()
    address, page = web_viewer()
    typer.echo(f"viewer: {page}", err=True)
    return address


def _shown(run: FollowedRun, title: str, *, json: bool) -> Callable[[News], None]:
    """Return what tells of news: JSON for programs, sentences, or a picture on a terminal."""
    from twin.follow.display import TerminalDisplay, as_json, as_sentence

    words = as_json if json else as_sentence

    def write(news: News) -> None:
        if line := words(news):
            typer.echo(line)
            sys.stdout.flush()

    if json or not sys.stdout.isatty():
        return write
    from rich.console import Console

    return TerminalDisplay(run, title, Console())


follow = command(
    f"{__name__}:follow_events",
    every={"min": 0.001},
    scenario={"metavar": "FILE"},
    samples={"min": 1, "max": 100000},
    recording={"metavar": "FILE"},
)
