"""Command ``twin study``: many runs of a scenario, with statistics.

Replications are executed in ``twin.studies.replications.runner``. Confidence intervals of means, quantiles and
proportions are computed in ``twin.studies.replications.statistics``.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from planning.errors import RequestError
from twin.cluster.options import Certificates, Insecure, Scheduler
from twin.commands.options import (
    AsJson,
    AuditEngine,
    OptionalScenarioFile,
    Quiet,
    Seed,
    Shortcuts,
)
from twin.commands.view import View
from twin.host.guard import guarded

if TYPE_CHECKING:
    from twin.trial.loaded_scenario import LoadedScenario
    from twin.trial.plan_result import PlanResult


@guarded
def study(
    scenario: OptionalScenarioFile = None,
    replications: Annotated[
        int | None,
        typer.Option(
            "--replications",
            "-n",
            min=1,
            help="Replications of every policy and variant; by default until the "
            "precision is reached.",
        ),
    ] = None,
    precision: Annotated[
        float,
        typer.Option(
            min=1e-6,
            help="Continue until the confidence interval of the mean is this "
            "narrow, relative to the mean.",
        ),
    ] = 0.02,
    policies: Annotated[
        list[str] | None,
        typer.Option(
            "--policy",
            help="Sequential, synchronous, 'synchronous + TPG', 'synchronous + TPG +"
            " shortcuts', asynchronous, 'asynchronous + shortcuts' or open-loop, of which"
            " there may be several; by default sequential, and what twin run executes.",
        ),
    ] = None,
    deadline_s: Annotated[
        float | None,
        typer.Option(
            "--deadline",
            help="Deadline, whose probability of being met is estimated [s].",
        ),
    ] = None,
    antithetic: Annotated[
        bool,
        typer.Option("--antithetic", help="Draw replications in mirrored pairs."),
    ] = False,
    sobol: Annotated[
        int,
        typer.Option(
            min=0,
            help="Points of the sample for Sobol indices, such as 128; 0 for none.",
        ),
    ] = 0,
    audited: Annotated[
        int,
        typer.Option(
            "--audit-sample",
            min=0,
            help="Replications that are checked for collisions: open-loop ones, and all"
            " where bases are off.",
        ),
    ] = 20,
    audit_engine: AuditEngine = None,
    shortcuts: Shortcuts = None,
    operate: Annotated[
        bool | None,
        typer.Option(
            "--operate/--no-operate",
            help="Replan the remaining work where a skill fails for good or a "
            "robot is out of service, as twin operate does, with the plan "
            "that it executes; by default where a failure has then: rework or scrap, "
            "or products have rush orders. --no-operate leaves rush orders out.",
        ),
    ] = None,
    failures: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1,
            metavar="P",
            help="With --operate, probability that an attempt at any skill fails, "
            "a fifth of which lose the object; for skills without a rate in "
            "the scenario.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Worker processes; 0 computes in this process. Default: one per core.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the results; by default logs/study-<scenario>-<UTC time>.",
        ),
    ] = None,
    least: Annotated[
        int,
        typer.Option(min=2, help="Minimum number of replications, with --precision."),
    ] = 20,
    most: Annotated[
        int,
        typer.Option(min=2, help="Maximum number of replications, with --precision."),
    ] = 10_000,
    confidence: Annotated[
        float,
        typer.Option(min=0.5, max=0.9999, help="Confidence level of all intervals."),
    ] = 0.95,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help="Any key, or one of the execution section:"
            " cell.robots.b.base.xyz_m.0=0.7,0.8 plans each layout and ranks them,"
            " skills.pick.scale=1,2 needs no other plan. Give it again for every"
            " combination."
        ),
    ] = None,
    seed: Seed = None,
    scheduler: Scheduler = None,
    certificates: Certificates = None,
    insecure: Insecure = False,
    plan: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Study the plan in this folder of a run, instead of planning. Without"
            " SCENARIO that of the run is taken.",
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Resume the study in this folder."),
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Replicate a plan under uncertainty: makespans with confidence intervals.

    All policies and variants use common random numbers, so that their differences are paired. Writes
    replications.parquet, tasks.parquet, edges.parquet, summary.json, pictures and report.html.
    """
    from twin.cluster.commands import given_cluster
    from twin.scenario.variations import Variation
    from twin.studies import api
    from twin.studies.replications.statistics import Precision
    from twin.studies.report.terminal_table import print_study

    view = View(as_json, quiet)
    cluster = given_cluster(scheduler, certificates, insecure)
    with view.progress(items=True) as progress:
        if resume is not None:
            found = api.resume_study(
                resume, scenario, workers=workers, cluster=cluster, progress=progress
            )
        else:
            found = api.study(
                _subject(scenario, plan, seed),
                [Variation.parse(text) for text in vary or ()],
                replications=replications,
                precision=Precision(precision, least, most, confidence),
                policies=policies or (),
                deadline_s=deadline_s,
                antithetic=antithetic,
                sobol=sobol,
                audited=audited,
                audit_engine=audit_engine,
                shortcuts=shortcuts,
                operate=operate,
                failures=failures,
                workers=workers,
                cluster=cluster,
                out=out,
                progress=progress,
            )
    view.output(found.summary, lambda: print_study(found.result))


def _subject(
    path: Path | None, plan: Path | None, seed: int | None
) -> LoadedScenario | PlanResult:
    """Return the subject of a study: a scenario, or the plan of a run."""
    from twin.trial.loaded_scenario import load
    from twin.trial.plan_result import read_plan, scenario_of_run

    if path is not None:
        chosen = load(path)
    elif plan is not None:
        chosen = scenario_of_run(plan)
    else:
        raise RequestError("give a scenario file, --plan DIR or --resume DIR")
    chosen = chosen.varied({} if seed is None else {"seed": seed})
    return chosen if plan is None else read_plan(plan, chosen)
