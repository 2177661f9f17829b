"""``twin run``: plan a scenario, execute it in the twin, check it, and show the figures."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from planning.errors import ScenarioError
from twin.host.guard import COMPLETED, FAILED, INTERRUPTED, guarded, print_error

if TYPE_CHECKING:
    from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
    from twin.host.progress import Report
    from twin.scenario.sections.scenario import Scenario

File = Annotated[Path, typer.Argument(help="Scenario file.", metavar="SCENARIO")]
Seed = Annotated[
    int | None, typer.Option(min=0, help="Seed, in place of the scenario's.")
]
Out = Annotated[
    Path | None,
    typer.Option(help="Folder for the results; default: logs/<scenario>-<UTC time>."),
]
Plan = Annotated[
    Path | None,
    typer.Option(
        help="Execute the plan in this folder of an earlier run.", metavar="DIR"
    ),
]
PolicyName = Annotated[
    str | None,
    typer.Option(
        help="asynchronous, sequential, synchronous or open-loop, in place of the "
        "scenario's."
    ),
]
Stalls = Annotated[
    int | None,
    typer.Option(
        min=0, help="Random standstills of each robot, in place of the scenario's."
    ),
]
Shortcuts = Annotated[
    int | None,
    typer.Option(
        "--shortcuts",
        min=0,
        help="Shortcuts tried on the plan, in place of the scenario's.",
    ),
]
Robots = Annotated[
    int | None,
    typer.Option(
        "--robots",
        min=1,
        metavar="M",
        help="Robots of the team, in place of the scenario's; without a team, the first M.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Value of a key of the execution section, such as stalls.rate_per_h=60; may be "
        "given several times. Values are words or JSON.",
        metavar="KEY=VALUE",
    ),
]
Audit = Annotated[
    bool,
    typer.Option("--audit/--no-audit", help="Check what was executed with PyBullet."),
]
Recording = Annotated[
    bool,
    typer.Option("--recording/--no-recording", help="Write run.rrd for the viewer."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the summary as JSON only.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]

_Plan: TypeAlias = (
    "tuple[TemporalPlanGraph, dict[str, float], TemporalPlanGraph | None]"
)
"""A plan, the seconds it took, and what to compare it with where that is another plan."""


@guarded
def run(
    scenario: File,
    seed: Seed = None,
    out: Out = None,
    plan: Plan = None,
    policy: PolicyName = None,
    stalls: Stalls = None,
    shortcuts: Shortcuts = None,
    robots: Robots = None,
    settings: Settings = None,
    audit: Audit = True,
    recording: Recording = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Plan a scenario, execute it in the twin, check it, and show the figures."""
    from twin.host.kernel_cache import kernels_are_cached
    from twin.host.progress import StageDisplay
    from twin.run.folder import prepare_run_folder
    from twin.scenario.file import load_scenario

    chosen = _changed(load_scenario(scenario), seed, policy, stalls, shortcuts, robots)
    chosen = _with_settings(chosen, settings or [], scenario.parent)
    silent = quiet or as_json
    with StageDisplay(enabled=not silent) as progress:
        base = scenario.parent
        saved = None if plan is None else _saved_plan(plan, chosen, base)
        existed = out is not None and out.exists()
        folder = prepare_run_folder(out, chosen.name)
        compiles = saved is None and not kernels_are_cached()
        if not silent:
            _announce(chosen, folder, compiles=compiles)
        try:
            tpg, planning_s, turns = saved or _planned(chosen, base, progress)
        except BaseException:
            if not existed:
                _remove_if_empty(folder)
            raise
        from twin.trial.trial import Keep, try_plan

        trial = try_plan(
            chosen,
            tpg,
            folder,
            base=base,
            planning_s=planning_s,
            turns=turns,
            keep=Keep(recording=recording, audit=audit),
            progress=progress,
        )
    if as_json:
        typer.echo(json.dumps({"folder": str(folder), **trial.summary}, indent=2))
    elif not quiet:
        from twin.run.table import print_summary

        print_summary(trial.summary, folder, recording=recording, compiled=compiles)
    if trial.run.outcome == "aborted":
        print_error(f"interrupted; what happened until then is in {folder}")
        return INTERRUPTED
    return COMPLETED if trial.passed else FAILED


def _changed(
    scenario: Scenario,
    seed: int | None,
    policy: str | None,
    stalls: int | None,
    shortcuts: int | None,
    robots: int | None,
) -> Scenario:
    """Return the scenario with what the options say in place of what the file says."""
    from twin.run.run_record import POLICIES
    from twin.scenario.sections.cell import choose_robots
    from twin.scenario.sections.scenario import resolved

    content: dict[str, Any] = resolved(scenario)
    if robots is not None:
        choose_robots(content["cell"], robots)
    execution = content["execution"]
    if policy is not None and policy not in POLICIES:
        raise ScenarioError(f"--policy: unknown policy {policy!r}", choices=POLICIES)
    if seed is not None:
        content["seed"] = seed
    if policy is not None:
        execution["policy"] = policy
    if stalls is not None:
        execution["stalls"]["count_per_robot"] = stalls
    if shortcuts is not None:
        content["planning"]["shortcut_candidates"] = shortcuts
    return _checked(content)


def _checked(content: dict[str, Any]) -> Scenario:
    from pydantic import ValidationError

    from twin.scenario.sections.scenario import Scenario

    try:
        return Scenario.model_validate_json(json.dumps(content))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(entry) for entry in first["loc"])
        raise ScenarioError(f"{where}: {first['msg']}") from None


def _with_settings(scenario: Scenario, settings: list[str], base: Path) -> Scenario:
    """Return the scenario with some keys of its execution section set."""
    from twin.scenario.disturbance_models import scenario_disturbances
    from twin.scenario.sections.scenario import resolved
    from twin.scenario.variations import parse_variation, varied

    variant: dict[str, Any] = {}
    for text in settings:
        variation = parse_variation(text)
        if len(variation.values) > 1:
            raise ScenarioError(f"--set {text}: give one value")
        variant[variation.key] = variation.values[0]
    if not variant:
        return scenario
    chosen = _checked(resolved(varied(scenario, variant)))
    # Names of robots and files of times are looked at now, not after planning.
    names = tuple(robot.name for robot in chosen.cell.robots)
    scenario_disturbances(chosen.execution, names, base)
    return chosen


def _planned(scenario: Scenario, base: Path, progress: Report) -> _Plan:
    from twin.planning.pipeline import plan_scenario

    planned = plan_scenario(scenario, base, progress)
    return planned.tpg, dict(planned.planning_s), planned.turns


def _saved_plan(folder: Path, scenario: Scenario, base: Path) -> _Plan:
    from scheduling.graph.plan_files import load_plan
    from twin.scenario.build_workcell import build_workcell

    tpg = load_plan(folder)
    cell = build_workcell(scenario, base)
    for what, found, expected in (
        ("robots", tpg.cell.robots, cell.robots),
        ("bricks", [o for o in tpg.cell.objects if not o.later], cell.objects),
    ):
        if [item.name for item in found] != [item.name for item in expected]:
            raise ScenarioError(
                f"the plan in {folder} is for other {what} than scenario {scenario.name!r}"
            )
    return tpg, {}, None


def _remove_if_empty(folder: Path) -> None:
    """Leave no empty folder behind when planning fails."""
    with contextlib.suppress(OSError):
        folder.rmdir()


def _announce(scenario: Scenario, folder: Path, *, compiles: bool) -> None:
    from rich.console import Console

    from twin.assemblies.kinds import assembly_kind

    console = Console(stderr=True, highlight=False)
    console.print(
        f"{scenario.name}: {len(scenario.cell.robots)} robots, "
        f"{assembly_kind(scenario.assembly).steps()} steps, seed {scenario.seed} -> {folder}"
    )
    if compiles:
        console.print("compiling kernels, once ...")
