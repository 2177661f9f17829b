"""``twin plan``: plan a scenario, or its remaining steps from an intermediate state of a run, and save the plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from planning.errors import RequestError
from twin.commands.options import AsJson, OptionalScenarioFile, Quiet
from twin.commands.view import View
from twin.host.guard import guarded, print_error, print_json

if TYPE_CHECKING:
    from twin.trial.plan_result import PlanResult


@guarded
def plan(
    scenario: OptionalScenarioFile = None,
    world: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="RUN@T",
            help="Start from an earlier run at a time, as runs/cliff@42: 42 s "
            "after its start. Every robot first continues until it is at rest "
            "outside of a skill; the plan starts from that state.",
        ),
    ] = None,
    out_of_service: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROBOT",
            help="Robot that is out of service from then on and stands still; may "
            "be given several times.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the plan; by default logs/<scenario>-<UTC time>.",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Value of any key, such as planning.shortcut_candidates=0; may be given"
            " several times. Values are words or JSON.",
        ),
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Plan a scenario, or the remaining work in the middle of a run, and write the plan.

    twin run SCENARIO --plan DIR executes it, twin verify DIR proves it, twin study --plan DIR replicates it.
    """
    from twin.api import runs
    from twin.commands.run import values_of
    from twin.runs.folder import run_folder
    from twin.trial.loaded_scenario import load
    from twin.trial.plan_result import scenario_of_run
    from twin.trial.run_moment import RunMoment
    from twin.trial.run_plan import write_plan

    moment = None
    if world is not None:
        moment = RunMoment.named(world)
    if scenario is not None:
        case = load(scenario)
    elif moment is not None:
        case = scenario_of_run(moment.run.files)
    else:
        raise RequestError("say what to plan: SCENARIO, or --from RUN@T")
    case = case.varied(values_of(settings))
    view = View(as_json, quiet)
    with view.progress() as progress, run_folder(out, case.name) as folder:
        made = runs.plan(
            case, world=moment, out_of_service=out_of_service or (), progress=progress
        )
        write_plan(made, folder)
    _show(made, folder, view)


def _show(made: PlanResult, folder: Path, view: View) -> None:
    """Print the remaining steps of a plan and its start."""
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
        from planning.tasks.task import TaskKind

        typer.echo(f"begins after {begun.after}")
        for item, robot in sorted(held.items()):
            typer.echo(f"  {robot} holds {item}")
        for task in (task for task in tpg.tasks if task.kind == TaskKind.GOES_ON):
            chain = tpg.chains[tpg.chain_index[task.robot]]
            typer.echo(f"  {task.robot}: {task.label} for {chain.duration[0]:.2f} s")
        for robot in begun.out:
            typer.echo(f"  {robot} is out")
    typer.echo(
        f"{folder}: {len(steps)} steps, {len(tpg.tasks)} tasks, {made.makespan_s:.2f} s at nominal durations"
    )
