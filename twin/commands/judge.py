"""``twin judge``: what is wrong with a plan that somebody else made, and how it does under delays."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from twin.commands.command import View, command
from twin.host.guard import COMPLETED, FAILED, print_json

if TYPE_CHECKING:
    from twin.audit.violation import Violation
    from twin.host.progress import Report
    from twin.judge.judge import Judgement

_TOLD = 20
"""So many findings of one execution are printed."""


def judge_file(
    plan: Path,
    *,
    scenario: Path | None = None,
    seeds: int = 5,
    audit_engine: str | None = None,
    progress: Report,
) -> Judgement:
    """Judge a plan of any planner, handed in as an open plan.

    It is replayed at its own times, and under delays: collisions, limits of joints, what changes hands, places,
    order and waits, by an engine that shares nothing with a planner. Ends with 1 where anything is wrong.

    Args:
        plan: file of the plan, as docs/reference/formats.md describes it.
        scenario: its task, a scenario file or the name of one that comes with the program; by default the
            one that the plan names.
        seeds: executions under delays, with 0, 1, 2 and so on as their seeds.
        audit_engine: what distances are measured with, pybullet or coal; by default PyBullet where it is
            installed, else coal.
        progress: told how far it has come.
    """
    from twin.audit.worlds.engines import engine_named
    from twin.judge.judge import judge as judged

    engine = engine_named(audit_engine) if audit_engine else None
    return judged(plan, scenario, seeds=seeds, engine=engine, progress=progress)


def _show(found: Judgement, view: View) -> int:
    if view.as_json:
        print_json(found.content())
    elif not view.quiet:
        for violation in found.findings[:_TOLD]:
            typer.echo(told(violation))
        _echo_more(len(found.findings))
        for run in found.delayed:
            for violation in run.findings[:_TOLD]:
                typer.echo(f"with delays {run.seed}: {told(violation)}")
            _echo_more(len(run.findings))
        _echo_scores(found)
    return COMPLETED if found.clean else FAILED


def told(violation: Violation) -> str:
    """Return a finding in words: what, who, when, how much."""
    depth = f"overlap by {1e3 * violation.depth_m:.2f} mm, "
    depth = depth if violation.kind == "contact" else ""
    second = f" - {violation.second}" if violation.second else ""
    when = f"from {violation.t_start:.3f} s to {violation.t_end:.3f} s"
    if violation.t_start == violation.t_end:
        when = f"at {violation.t_start:.3f} s"
    return f"{violation.kind}: {violation.first}{second}: {when}: {depth}{violation.detail}"


def _echo_more(count: int) -> None:
    if count > _TOLD:
        typer.echo(f"... and {count - _TOLD} more")


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


judge = command(
    f"{__name__}:judge_file",
    _show,
    scenario={"metavar": "SCENARIO"},
    seeds={"min": 0, "max": 10_000},
)
