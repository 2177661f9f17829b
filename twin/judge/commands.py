"""``twin judge``: report violations of a plan from another planner, and its performance under delays."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.commands.options import AsJson, Quiet
from twin.commands.view import View
from twin.host.guard import ExitCode, guarded, print_json

if TYPE_CHECKING:
    from twin.audits.case import Violation
    from twin.judge.judge import Judgement

_MOST_PRINTED = 20
"""Largest number of violations that are printed per execution."""


@guarded
def judge(
    plan: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN",
            help="File of the plan, as docs/reference/formats.md describes it.",
        ),
    ],
    scenario: Annotated[
        Path | None,
        typer.Option(
            metavar="SCENARIO",
            help="Scenario of the plan, a file or the name of one that comes with "
            "the program; by default the one that the plan names.",
        ),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(
            min=0,
            max=10_000,
            help="Number of executions under delays, with the seeds 0, 1, 2 and so on.",
        ),
    ] = 5,
    audit_engine: Annotated[
        str | None,
        typer.Option(
            metavar="ENGINE",
            help="Collision engine for distances, pybullet or coal; by default "
            "PyBullet where it is installed, else coal.",
        ),
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Judge a plan of any planner, given as an open plan.

    It is replayed at its own times and under delays, and checked for collisions, joint limits, handovers,
    places, order and waits, by an engine that shares no code with the planner. Exits with code 1 if there are
    violations.
    """
    from twin.audits.worlds.engines import engine_named
    from twin.judge import judge as judging

    view = View(as_json, quiet)
    with view.progress() as progress:
        engine = engine_named(audit_engine) if audit_engine else None
        found = judging.judge(
            plan, scenario, seeds=seeds, engine=engine, progress=progress
        )
    if view.as_json:
        print_json(found.content())
    elif not view.quiet:
        for violation in found.findings[:_MOST_PRINTED]:
            typer.echo(describe_violation(violation))
        _echo_more(len(found.findings))
        for run in found.delayed:
            for violation in run.findings[:_MOST_PRINTED]:
                typer.echo(f"with delays {run.seed}: {describe_violation(violation)}")
            _echo_more(len(run.findings))
        _echo_scores(found)
    return ExitCode.COMPLETED if found.clean else ExitCode.FAILED


def describe_violation(violation: Violation) -> str:
    """Return the line of a finding: its kind, what takes part, when, and by how much."""
    depth = f"overlap by {1e3 * violation.depth_m:.2f} mm, "
    depth = depth if violation.kind == "contact" else ""
    second = f" - {violation.second}" if violation.second else ""
    when = f"from {violation.t_start:.3f} s to {violation.t_end:.3f} s"
    if violation.t_start == violation.t_end:
        when = f"at {violation.t_start:.3f} s"
    return f"{violation.kind}: {violation.first}{second}: {when}: {depth}{violation.detail}"


def _echo_more(count: int) -> None:
    if count > _MOST_PRINTED:
        typer.echo(f"... and {count - _MOST_PRINTED} more")


def _echo_scores(found: Judgement) -> None:
    from rich.console import Console
    from rich.table import Table

    seconds = "{:.2f} s".format
    rows = [
        ("task", found.scenario),
        ("planner", found.planner or "not said"),
        ("goes by", "what waits for what" if found.waits else "the clock"),
        ("planned", seconds(found.planned_s)),
    ]
    if found.mean_s is not None and found.p95_s is not None:
        rows += [
            (f"mean of {len(found.delayed)} with delays", seconds(found.mean_s)),
            ("P95 with delays", seconds(found.p95_s)),
            ("contacts with delays", str(found.contacts)),
        ]
    if found.planning_cpu_s is not None:
        rows.append(("planning, processor time", seconds(found.planning_cpu_s)))
    rows.append(("findings in the plan itself", str(len(found.findings))))
    table = Table(show_header=False, box=None)
    for row in rows:
        table.add_row(*row)
    Console().print(table)
