"""``twin run`` and ``twin resume``: plan, execute in the twin, check, and show the figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from planning.errors import RequestError, ScenarioError
from twin.commands.options import (
    AsJson,
    AuditEngine,
    Improve,
    Out,
    Quiet,
    ScenarioFile,
    Seed,
    Shortcuts,
)
from twin.host.guard import (
    COMPLETED,
    FAILED,
    INTERRUPTED,
    guarded,
    print_error,
    print_json,
)

if TYPE_CHECKING:
    from twin.check.check import CheckReport
    from twin.host.progress import Report
    from twin.planning.pipeline import Planned
    from twin.scenario.document.yaml_text import YamlDocument
    from twin.scenario.sections.scenario import Scenario
    from twin.scenario.variations import Variant
    from twin.trial.saved_plan import SavedPlan

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
Robots = Annotated[
    int | None,
    typer.Option(
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
    typer.Option(
        "--audit/--no-audit", help="Check what was executed with code of its own."
    ),
]
Recording = Annotated[
    bool,
    typer.Option("--recording/--no-recording", help="Write run.rrd for the viewer."),
]


@guarded
def run(
    scenario: ScenarioFile,
    seed: Seed = None,
    out: Out = None,
    plan: Plan = None,
    policy: PolicyName = None,
    stalls: Stalls = None,
    shortcuts: Shortcuts = None,
    improve: Improve = None,
    robots: Robots = None,
    settings: Settings = None,
    audit: Audit = True,
    audit_engine: AuditEngine = None,
    recording: Recording = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Plan a scenario, execute it in the twin, check it, and show the figures."""
    from twin.host.progress import StageDisplay, compilation_shown
    from twin.run.folder import run_folder

    engine = None
    if audit and audit_engine is not None:
        from twin.audit.worlds.engine import engine_named

        engine = engine_named(audit_engine)  # now, not after the planning

    base = scenario.parent
    given = {"policy": policy, "stalls.count_per_robot": stalls}
    variant = {key: value for key, value in given.items() if value is not None}
    variant |= _values(settings or [])
    chosen, document = _chosen(scenario, seed, (shortcuts, improve), robots, variant)
    silent = quiet or as_json
    with (
        StageDisplay(enabled=not silent) as progress,
        compilation_shown(progress, silent=silent) as compiled,
    ):
        report = _checked(chosen, document, base, progress, silent=silent)
        planned: Planned | SavedPlan | None = None
        if plan is not None:
            from twin.trial.saved_plan import read_saved_plan

            planned = read_saved_plan(plan, chosen, base)
        with run_folder(out, chosen.name) as folder:
            if not silent:
                _announce(chosen, folder)
            if planned is None:
                from twin.planning.pipeline import plan_scenario

                planned = plan_scenario(chosen, base, progress)
            from twin.trial.trial import Origin, try_plan

            trial = try_plan(
                chosen,
                planned.tpg,
                folder,
                base=base,
                origin=Origin(planned, report.messages(report.warnings)),
                recording=recording,
                audit=engine or audit,
                progress=progress,
            )
    if as_json:
        print_json({"folder": str(folder), **trial.summary})
    elif not quiet:
        from twin.run.summary import print_summary

        print_summary(
            trial.summary, folder, recording=recording, compiled=compiled() > 0
        )
    if trial.run.outcome == "aborted":
        print_error(f"interrupted; what happened until then is in {folder}")
        return INTERRUPTED
    return COMPLETED if trial.passed else FAILED


def _values(settings: list[str]) -> dict[str, Any]:
    """Return the keys of the execution section that are set, and their values."""
    from twin.scenario.variations import parse_variation

    found = {}
    for text in settings:
        variation = parse_variation(text)
        if len(variation.values) > 1:
            raise ScenarioError(f"--set {text}: give one value")
        found[variation.key] = variation.values[0]
    return found


def _chosen(
    path: Path,
    seed: int | None,
    planning: tuple[int | None, float | None],
    robots: int | None,
    variant: Variant,
) -> tuple[Scenario, YamlDocument]:
    """Return a scenario with what the options say in place of what the file says, and the file."""
    from twin.run.run_record import POLICIES
    from twin.scenario.file import read_scenario
    from twin.scenario.sections.cell import choose_robots
    from twin.scenario.sections.scenario import resolved, restored
    from twin.scenario.variations import assign_variant

    loaded, document = read_scenario(path)
    content = resolved(loaded)
    policy = variant.get("policy")
    if policy is not None and policy not in POLICIES:
        _refuse_policy(str(policy))
    if robots is not None:
        choose_robots(content["cell"], robots)
    if seed is not None:
        content["seed"] = seed
    shortcuts, improve = planning
    if shortcuts is not None:
        content["planning"]["shortcut_candidates"] = shortcuts
    if improve is not None:
        content["planning"]["improve_s"] = improve
    assign_variant(content, variant)
    chosen = restored(content)
    # Names of robots and files of times are looked at now, not after planning.
    names = tuple(robot.name for robot in chosen.cell.robots)
    chosen.execution.disturbances(names, path.parent)
    return chosen, document


def _checked(
    scenario: Scenario,
    document: YamlDocument,
    base: Path,
    progress: Report,
    *,
    silent: bool,
) -> CheckReport:
    """Return what the check of the cell finds, and print its warnings; errors are raised."""
    from twin.check.check import check_scenario, require_checked

    progress("check of the cell", 0, 1)
    report = check_scenario(scenario, document, base)
    require_checked(report)
    progress("check of the cell", 1, 1)
    if report.warnings and not silent:
        print_error(report.excerpts(report.warnings).report())
    return report


def _refuse_policy(text: str) -> None:
    """Refuse a policy that is no way to release nodes, with the way to have it."""
    from twin.run.policies import NAMED_POLICIES, policy_named
    from twin.run.run_record import POLICIES

    try:
        name = policy_named(text)
    except RequestError:
        raise ScenarioError(f"policy: there is no {text!r}", choices=POLICIES) from None
    plan, release = NAMED_POLICIES[name]
    raise ScenarioError(
        f"policy {name!r} is {release} of the plan {plan}: give --policy {release}; --shortcuts"
        " and the scenario's coordination say which plan it is"
    )


def _announce(scenario: Scenario, folder: Path) -> None:
    from rich.console import Console

    from twin.planning.kind import assembly_kind

    console = Console(stderr=True, highlight=False)
    console.print(
        f"{scenario.name}: {len(scenario.cell.robots)} robots, "
        f"{assembly_kind(scenario.assembly).steps()} steps, seed {scenario.seed} -> {folder}"
    )


Folder = Annotated[Path, typer.Argument(help="Folder of the run.", metavar="LOGDIR")]
Base = Annotated[
    Path | None,
    typer.Option(
        help="Where relative paths of the scenario start; default: where they did.",
        metavar="DIR",
    ),
]


@guarded
def resume(
    folder: Folder, base: Base = None, as_json: AsJson = False, quiet: Quiet = False
) -> int:
    """Go on with a simulated run from its event log, after its process was killed.

    The run is computed again from the start, compared with the log event by event, and brought
    to its end: the files are those of a run that was never killed.
    """
    from twin.host.progress import StageDisplay
    from twin.run.folder import locked
    from twin.trial.resume import resume_run
    from twin.trial.trial import has_passed, read_summary

    silent = quiet or as_json
    with locked(folder), StageDisplay(enabled=not silent) as progress:
        done = resume_run(folder, base=base, progress=progress)
    summary = read_summary(folder)
    if as_json:
        print_json({"folder": str(folder), **summary})
    elif not quiet:
        from twin.run.folder import RECORDING
        from twin.run.summary import print_summary

        if done.trial is None:
            typer.echo(f"{folder}: the run has come to its end already")
        else:
            typer.echo(
                f"{folder}: {done.agreed} events of the log happened again,"
                f" {done.added} were missing"
            )
        print_summary(summary, folder, recording=(folder / RECORDING).exists())
    return COMPLETED if has_passed(summary) else FAILED
