"""``twin study``: many replications of a plan under uncertainty, and what they tell."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import twin
from planning.errors import RequestError
from twin.commands.options import AsJson, AuditEngine, Out, Quiet, Seed, Shortcuts
from twin.host.guard import COMPLETED, guarded, print_json

if TYPE_CHECKING:
    from twin.cluster.address import Cluster

File = Annotated[
    Path | None,
    typer.Argument(
        help="Scenario file, or the name of one that twin scenarios lists.",
        metavar="SCENARIO",
    ),
]
Replications = Annotated[
    int | None,
    typer.Option(
        "--replications",
        "-n",
        min=1,
        help="Replications of every policy and variant; default: until --precision.",
    ),
]
PrecisionOf = Annotated[
    float,
    typer.Option(
        min=1e-6,
        help="Go on until the interval of the mean is this narrow, relative to it.",
    ),
]
Least = Annotated[int, typer.Option(min=2, help="At least so many, with --precision.")]
Most = Annotated[int, typer.Option(min=2, help="At most so many, with --precision.")]
Confidence = Annotated[
    float, typer.Option(min=0.5, max=0.9999, help="Of all intervals.")
]
PolicyNames = Annotated[
    list[str] | None,
    typer.Option(
        help="sequential, synchronous, 'synchronous + TPG', 'synchronous + TPG + shortcuts',"
        " asynchronous, 'asynchronous + shortcuts' or open-loop; give it again for more."
        " Default: sequential, and what twin run executes."
    ),
]
Vary = Annotated[
    list[str] | None,
    typer.Option(
        help="Vary any key, or one of the execution section: cell.robots.b.base.xyz_m.0=0.7,0.8"
        " plans each layout and ranks them, skills.pick.scale=1,2 needs no other plan. Give it"
        " again for every combination."
    ),
]
Deadline = Annotated[
    float | None, typer.Option(help="How likely is the run over by then [s]?")
]
Antithetic = Annotated[
    bool, typer.Option("--antithetic", help="Draw replications in mirrored pairs.")
]
Sobol = Annotated[
    int,
    typer.Option(
        min=0, help="Points of the sample for Sobol indices, such as 128; 0 for none."
    ),
]
Audited = Annotated[
    int,
    typer.Option(
        min=0, help="Open-loop replications that PyBullet checks for collisions."
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        min=0, help="Processes; 0 for none besides this one. Default: one a core."
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        help="Address of a Dask scheduler that does the work: tls://host:port."
    ),
]
CertificatesOf = Annotated[
    Path | None,
    typer.Option(
        "--certificates",
        metavar="DIR",
        help="Folder with the certificates of the scheduler.",
    ),
]
Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure", help="Use a tcp:// scheduler on another machine, unprotected."
    ),
]
PlanOf = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Study the plan in this folder of a run, instead of planning. Without SCENARIO that"
        " of the run is taken.",
    ),
]
Resume = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Go on with the study in this folder."),
]


@guarded
def study(
    scenario: File = None,
    replications: Replications = None,
    precision: PrecisionOf = 0.02,
    least: Least = 20,
    most: Most = 10_000,
    confidence: Confidence = 0.95,
    policy: PolicyNames = None,
    vary: Vary = None,
    deadline: Deadline = None,
    antithetic: Antithetic = False,
    sobol: Sobol = 0,
    audit_sample: Audited = 20,
    audit_engine: AuditEngine = None,
    shortcuts: Shortcuts = None,
    seed: Seed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    certificates: CertificatesOf = None,
    insecure: Insecure = False,
    plan: PlanOf = None,
    resume: Resume = None,
    out: Out = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Replicate a plan under uncertainty: how long it takes, and how sure one can be.

    All policies and variants see the same draws, so their differences are sharp. Leaves
    replications.parquet, tasks.parquet, edges.parquet, summary.json, pictures and report.html.
    """
    from rich.progress import (
        MofNCompleteColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from twin.host.progress import StageDisplay, compilation_shown
    from twin.scenario.variations import parse_variation
    from twin.study.replications.statistics import Precision

    cluster = _cluster(scheduler, certificates, insecure)
    columns = (
        *(MofNCompleteColumn(), TimeElapsedColumn()),
        *(TextColumn("left"), TimeRemainingColumn()),
    )
    silent = quiet or as_json
    with (
        StageDisplay(enabled=not silent, columns=columns) as progress,
        compilation_shown(progress, silent=silent),
    ):
        if resume is not None:
            found = twin.resume_study(
                resume, scenario, workers=workers, cluster=cluster, progress=progress
            )
        else:
            found = twin.study(
                _subject(scenario, plan, seed),
                [parse_variation(text) for text in vary or ()],
                replications=replications,
                precision=Precision(precision, least, most, confidence),
                policies=policy or (),
                deadline_s=deadline,
                antithetic=antithetic,
                sobol=sobol,
                audited=audit_sample,
                audit_engine=audit_engine,
                shortcuts=shortcuts,
                workers=workers,
                cluster=cluster,
                out=out,
                progress=progress,
            )
    if as_json:
        print_json(found.summary)
    elif not quiet:
        from twin.study.report.terminal_table import print_study

        print_study(found.result)
    return COMPLETED


def _subject(
    path: Path | None, plan: Path | None, seed: int | None
) -> twin.LoadedScenario | twin.PlanResult:
    """Return what is studied: a scenario, or the plan that a run left."""
    from twin.trial.plan_result import scenario_of_run

    if path is not None:
        chosen = twin.load(path)
    elif plan is not None:
        chosen = scenario_of_run(plan)
    else:
        raise RequestError("give a scenario file, --plan DIR or --resume DIR")
    chosen = chosen.varied({} if seed is None else {"seed": seed})
    return chosen if plan is None else twin.read_plan(plan, chosen)


def _cluster(
    scheduler: str | None, certificates: Path | None, insecure: bool
) -> Cluster | None:
    from twin.cluster.address import Cluster
    from twin.cluster.certificates import certificates_in

    if scheduler is None:
        if certificates is not None or insecure:
            raise RequestError("--certificates and --insecure go with --scheduler")
        return None
    held = None if certificates is None else certificates_in(certificates)
    return Cluster(scheduler, held, insecure)
