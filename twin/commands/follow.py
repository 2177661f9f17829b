"""``twin follow``: state and forecast of a cell that is running."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from twin.commands.command import command
from twin.host.guard import COMPLETED, FAILED

if TYPE_CHECKING:
    from twin.follow.follow import RunListener
    from twin.follow.state import FollowedRun


def follow_events(
    plan: Path,
    events: Path,
    *,
    every: float = 2.0,
    samples: int = 200,
    scenario: Path | None = None,
    once: bool = False,
    recording: Path | None = None,
    view: bool = False,
    as_json: bool = False,
) -> int:
    """Follow a run in progress: what every robot does, and when it will all be done.

    Flags every event that the plan forbids, and forecasts the end of the run by drawing what is
    not done again and again. Ends with 1 when something forbidden happened or the run failed.

    Args:
        plan: folder with the plan, such as that of a run.
        events: event log of the run, a file that grows; - for standard input.
        every: time of the run between forecasts, in seconds.
        samples: futures that are drawn.
        scenario: scenario that durations and disturbances are taken from; default: that of
            the plan's folder.
        once: stop at the end of the file, do not wait.
        recording: write a recording for the Rerun viewer.
        view: open the Rerun viewer and show the run in it.
        as_json: print JSON lines: forecasts, violations, end.
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


follow = command(
    f"{__name__}:follow_events",
    every={"min": 0.001},
    scenario={"metavar": "FILE"},
    samples={"min": 1, "max": 100000},
    recording={"metavar": "FILE"},
)
