"""``twin follow``: state and forecast of a cell that is running."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.host.guard import COMPLETED, FAILED, guarded

if TYPE_CHECKING:
    from twin.follow.follow import RunListener
    from twin.follow.state import FollowedRun

PlanFolder = Annotated[
    Path,
    typer.Argument(help="Folder with the plan, such as that of a run.", metavar="PLAN"),
]
Events = Annotated[
    Path,
    typer.Argument(
        help="Event log of the run, a file that grows; - for standard input.",
        metavar="EVENTS",
    ),
]
Every = Annotated[
    float,
    typer.Option(min=0.001, help="Time of the run between forecasts, in seconds."),
]
Samples = Annotated[
    int, typer.Option(min=1, max=100_000, help="Futures that are drawn.")
]
ScenarioFile = Annotated[
    Path | None,
    typer.Option(
        help="Scenario that durations and disturbances are taken from; "
        "default: that of the plan's folder.",
        metavar="FILE",
    ),
]
Once = Annotated[
    bool, typer.Option("--once", help="Stop at the end of the file, do not wait.")
]
Recording = Annotated[
    Path | None,
    typer.Option(help="Write a recording for the Rerun viewer.", metavar="FILE"),
]
View = Annotated[
    bool, typer.Option("--view", help="Open the Rerun viewer and show the run in it.")
]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print JSON lines: forecasts, violations, end.")
]


@guarded
def follow(
    plan: PlanFolder,
    events: Events,
    every: Every = 2.0,
    samples: Samples = 200,
    scenario: ScenarioFile = None,
    once: Once = False,
    recording: Recording = None,
    view: View = False,
    as_json: AsJson = False,
) -> int:
    """Follow a run in progress: what every robot does, and when it will all be done.

    Flags every event that the plan forbids, and forecasts the end of the run by drawing what is
    not done again and again. Ends with 1 when something forbidden happened or the run failed.
    """
    from twin.follow.follow import follow as follow_run
    from twin.follow.forecast import Forecaster
    from twin.follow.state import FollowedRun
    from twin.trial.plan_result import plan_of_run
    from twin.trial.simulation import followed_execution

    tpg = plan_of_run(plan)
    name, model = followed_execution(plan, tpg, scenario)
    run = FollowedRun(tpg, model.policy)
    forecaster = Forecaster(tpg, model, samples=samples)
    listeners = [_shown(run, name, as_json=as_json)]
    if recording is not None or view:
        from twin.follow.recording import LiveRecording

        live = LiveRecording(tpg, recording, name=name, view=view, policy=model.policy)
        listeners.append(live)
    lines = _lines(events, wait=not once)
    follow_run(lines, run, forecaster, listeners, every_s=every)
    bad = bool(run.violations) or run.outcome == "failed"
    return FAILED if bad else COMPLETED


def _lines(events: Path, *, wait: bool) -> Iterator[str | None]:
    from twin.follow.follow import growing_file, piped

    if str(events) == "-":
        return piped(sys.stdin.buffer)
    return growing_file(events, wait=wait)


def _shown(run: FollowedRun, title: str, *, as_json: bool) -> RunListener:
    from twin.follow.display import JsonLines, PlainLines

    def write(line: str) -> None:
        typer.echo(line)
        sys.stdout.flush()

    if as_json:
        return JsonLines(write)
    if not sys.stdout.isatty():
        return PlainLines(write)
    from rich.console import Console

    from twin.follow.display import TerminalDisplay

    return TerminalDisplay(run, title, Console())
