"""``twin follow``: compare a run in progress with its plan, and forecast its completion time."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.commands.options import AsJson
from twin.host.guard import ExitCode, guarded

if TYPE_CHECKING:
    from twin.follow.follow import News
    from twin.follow.state import FollowedRun


@guarded
def follow(
    plan: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN", help="Folder with the plan, such as that of a run."
        ),
    ],
    events: Annotated[
        str,
        typer.Argument(
            metavar="EVENTS",
            help="Event log of the run: a file that grows, the address"
            " http://.../events.jsonl of the page of a run, or - for standard input.",
        ),
    ],
    every: Annotated[
        float,
        typer.Option(min=0.001, help="Time of the run between forecasts, in seconds."),
    ] = 2.0,
    samples: Annotated[
        int,
        typer.Option(
            min=1,
            max=100000,
            help="Number of simulated continuations for each forecast.",
        ),
    ] = 200,
    scenario: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Scenario with the durations and disturbances; default: that of "
            "the plan's folder.",
        ),
    ] = None,
    once: Annotated[
        bool, typer.Option("--once", help="Stop at the end of the file, do not wait.")
    ] = False,
    recording: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a recording for the Rerun viewer."),
    ] = None,
    view: Annotated[
        bool,
        typer.Option("--view", help="Open the Rerun viewer and show the run in it."),
    ] = False,
    web: Annotated[
        bool,
        typer.Option(
            "--web",
            help="Serve the viewer to a browser of this machine, as long as the run is"
            " followed.",
        ),
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Follow a run in progress: activities of the robots, and a forecast of its end.

    Flags every event that the plan forbids, and forecasts the end of the run by simulating the remaining work
    many times. Exits with code 1 if a forbidden event occurred or the run failed.
    """
    from twin.follow.follow import follow as follow_run
    from twin.follow.followed_folder import followed_execution, plan_history
    from twin.follow.forecast import Forecaster
    from twin.follow.log_lines import (
        lines_of_growing_file,
        lines_of_pipe,
        lines_of_server,
    )
    from twin.follow.state import FollowedRun

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
        lines = lines_of_pipe(sys.stdin.buffer)
    elif events.startswith("http://"):
        lines = lines_of_server(events)
    else:
        lines = lines_of_growing_file(Path(events), wait=not once)
    follow_run(lines, run, forecaster, listeners, every_s=every)
    bad = bool(run.violations) or run.outcome == "failed"
    return ExitCode.FAILED if bad else ExitCode.COMPLETED


def _viewer(*, web: bool) -> str:
    """Start a viewer, and return its stream."""
    from twin.rerun.viewer import live_viewer, web_viewer

    if not web:
        return live_viewer()
    address, page = web_viewer()
    typer.echo(f"viewer: {page}", err=True)
    return address


def _shown(run: FollowedRun, title: str, *, json: bool) -> Callable[[News], None]:
    """Return the output of news: JSON for programs, sentences, or a terminal display."""
    from twin.follow.display import TerminalDisplay, news_to_json, news_to_sentence

    words = news_to_json if json else news_to_sentence

    def write(news: News) -> None:
        if line := words(news):
            typer.echo(line)
            sys.stdout.flush()

    if json or not sys.stdout.isatty():
        return write
    from rich.console import Console

    return TerminalDisplay(run, title, Console())
