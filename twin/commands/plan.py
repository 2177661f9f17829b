"""``twin plan``: make a plan and write it, from the start or from the middle of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from planning.errors import RequestError
from twin.commands.command import View, command
from twin.host.guard import print_error, print_json

if TYPE_CHECKING:
    from twin.host.progress import Report
    from twin.trial.plan_result import PlanResult


class WrittenPlan(NamedTuple):
    """A plan, and the folder that it was written into."""

    plan: PlanResult
    folder: Path


def plan_into_folder(
    scenario: Path | None = None,
    *,
    world: str | None = None,
    out_of_service: Sequence[str] = (),
    out: Path | None = None,
    settings: Sequence[str] = (),
    progress: Report,
) -> WrittenPlan:
    """Plan a scenario, or what is left of it from the middle of a run, and write the plan.

    twin run SCENARIO --plan DIR executes it, twin verify DIR proves it, twin study --plan DIR replicates it.

    Args:
        scenario: file, or the name of one that comes with the program; by default that of the run.
        world: begin where the run in a folder was at a time, as runs/cliff@42: 42 s after its start. Robots go on
            to where they next are at rest and within no skill; the plan begins in the world there.
        out_of_service: robot that does nothing from then on, and stands where it is; may be given several
            times.
        out: folder for the plan; by default logs/<scenario>-<UTC time>.
        settings: value of any key, such as planning.shortcut_candidates=0; may be given several times.
            Values are words or JSON.
        progress: told how far each stage has come.
    """
    from twin.api import runs
    from twin.commands.run import values_of
    from twin.operate.plan_from_run import RunMoment
    from twin.run.folder import run_folder
    from twin.trial.loaded_scenario import load
    from twin.trial.plan_result import scenario_of_run
    from twin.trial.trial import write_plan

    moment = None if world is None else RunMoment.named(world)
    if scenario is not None:
        case = load(scenario)
    elif moment is not None:
        case = scenario_of_run(moment.run.files)
    else:
        raise RequestError("say what to plan: SCENARIO, or --from RUN@T")
    case = case.varied(values_of(settings))
    with run_folder(out, case.name) as folder:
        made = runs.plan(
            case, world=moment, out_of_service=out_of_service, progress=progress
        )
        write_plan(made, folder)
    return WrittenPlan(made, folder)


def _show(written: WrittenPlan, view: View) -> None:
    """Print what a plan has left to do, and where it begins."""
    made, folder = written
    tpg, begun = made.tpg, made.tpg.cell.begun
    steps = sorted({task.step for task in tpg.tasks})
    held = {h.object: h.holder for h in tpg.handlings if tpg.holds_before(h)}
    if view.as_json:
        print_json(
            {
                "folder": str(folder),
                "plan": made.name,
                "steps": steps,
                "tasks": len(tpg.tasks),
                "makespan_s": round(made.makespan_s, 9),
                "begins_after": None if begun is None else begun.after,
                "held": held,
                "idle": {own.robot: own.content() for own in made.idle},
                "out": [] if begun is None else list(begun.out),
            }
        )
        return
    if view.quiet:
        return
    for words in (*made.warnings, *(own.message for own in made.idle)):
        print_error(f"warning: {words}")
    if begun is not None:
        from planning.tasks.task import GOES_ON

        typer.echo(f"begins after {begun.after}")
        for item, robot in sorted(held.items()):
            typer.echo(f"  {robot} holds {item}")
        for task in (task for task in tpg.tasks if task.kind == GOES_ON):
            chain = tpg.chains[tpg.chain_index[task.robot]]
            typer.echo(f"  {task.robot}: {task.label} for {chain.duration[0]:.2f} s")
        for robot in begun.out:
            typer.echo(f"  {robot} is out")
    typer.echo(
        f"{folder}: {len(steps)} steps, {len(tpg.tasks)} tasks, {made.makespan_s:.2f} s at nominal durations"
    )


plan = command(
    f"{__name__}:plan_into_folder",
    _show,
    world={"names": ("--from",), "metavar": "RUN@T"},
    out_of_service={"names": ("--out-of-service",), "metavar": "ROBOT"},
)
