"""``twin study``: many replications of a plan under uncertainty, and what they tell."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from planning.errors import RequestError
from twin.commands.options import AsJson, AuditEngine, Out, Quiet, Seed, Shortcuts
from twin.host.guard import COMPLETED, guarded, print_json
from twin.run.policies import ASYNCHRONOUS, OPEN_LOOP, SEQUENTIAL

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from twin.cluster.address import Cluster
    from twin.scenario.sections.scenario import Scenario
    from twin.study.plans import Plans

File = Annotated[Path | None, typer.Argument(help="Scenario file.", metavar="SCENARIO")]
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
        " Default: sequential and asynchronous; of a given plan sequential and its own."
    ),
]
Vary = Annotated[
    list[str] | None,
    typer.Option(
        help="Vary an input of the execution section: skills.pick.scale=1,1.5,2."
        " Give it again for every combination."
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

    from twin.audit.worlds.engine import engine_named
    from twin.comparison.comparison import shortcut_budget
    from twin.host.progress import StageDisplay
    from twin.run.folder import locked, run_folder
    from twin.scenario.file import load_scenario
    from twin.study.folder import StudyRequest, require_no_study, require_same_study
    from twin.study.replications.executors import check_cluster, open_executor
    from twin.study.study import resume_study, start_study

    def executor() -> AbstractContextManager[Executor]:
        return open_executor(workers, cluster)

    engine = engine_named(audit_engine) if audit_engine else None
    cluster = _cluster(scheduler, certificates, insecure)
    if cluster is not None:
        check_cluster(cluster)  # now, not after the planning
    columns = (
        *(MofNCompleteColumn(), TimeElapsedColumn()),
        *(TextColumn("left"), TimeRemainingColumn()),
    )
    with StageDisplay(enabled=not (quiet or as_json), columns=columns) as progress:
        if resume is not None:
            if scenario is not None:
                require_same_study(resume, load_scenario(scenario))
            with locked(resume):
                result = resume_study(resume, executor, progress)
        else:
            from twin.scenario.variations import parse_variation, variants
            from twin.study.replications.experiment import Experiment
            from twin.study.replications.statistics import Precision

            chosen, base = _scenario(scenario, plan)
            if seed is not None:
                chosen = chosen.model_copy(update={"seed": seed})
            if plan is None:
                plans, names = None, _named(policy) or (SEQUENTIAL, ASYNCHRONOUS)
            else:
                if shortcuts is not None:
                    raise RequestError("--shortcuts is for planning, not for --plan")
                plans, names = _plans(plan, chosen, base, _named(policy))
            experiment = Experiment(
                policies=names,
                variants=variants([parse_variation(text) for text in vary or ()]),
                replications=replications,
                precision=Precision(precision, least, most, confidence),
                antithetic=antithetic,
                audited=audit_sample,
                audit_engine=engine,
            )
            request = StudyRequest(
                chosen,
                base,
                experiment,
                shortcut_budget(chosen) if shortcuts is None else shortcuts,
                deadline,
                sobol,
                "" if plan is None else str(plan.resolve()),
            )
            require_no_study(out, request.scenario)
            with run_folder(out, f"study-{request.scenario.name}") as folder:
                result = start_study(request, folder, executor, progress, plans)
        from twin.study.report.report import write_report

        write_report(result, progress)
    if as_json:
        print_json(result.summary)
    elif not quiet:
        from twin.study.report.terminal_table import print_study

        print_study(result)
    return COMPLETED


def _named(policies: list[str] | None) -> tuple[str, ...]:
    from twin.run.policies import policy_named

    return tuple(map(policy_named, policies or ()))


def _scenario(path: Path | None, plan: Path | None) -> tuple[Scenario, Path]:
    """Return the scenario of a file or of the run that a plan is of, and where it was."""
    from twin.scenario.file import load_scenario
    from twin.scenario.manifest import manifest_base, read_manifest

    if path is not None:
        return load_scenario(path), path.parent
    if plan is None:
        raise RequestError("give a scenario file, --plan DIR or --resume DIR")
    scenario, manifest = read_manifest(plan, "run whose plan is studied")
    return scenario, manifest_base(plan, manifest)


def _plans(
    folder: Path, scenario: Scenario, base: Path, policies: tuple[str, ...]
) -> tuple[Plans, tuple[str, ...]]:
    """Return the plans of a run, and the policies under which they are studied."""
    from twin.study.plans import given_plans, possible_policies
    from twin.trial.saved_plan import read_saved_plan

    saved = read_saved_plan(folder, scenario, base)
    if not policies:
        possible = [p for p in possible_policies(saved) if p != OPEN_LOOP]
        policies = tuple(dict.fromkeys((SEQUENTIAL, possible[-1])))
        policies = tuple(p for p in policies if p in possible)
    return given_plans(saved, policies), policies


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
