"""``twin study`` and ``twin compare``: many runs of a scenario, and what they tell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planning.errors import RequestError
from twin.commands.command import View, command
from twin.host.guard import COMPLETED, print_json

if TYPE_CHECKING:
    from twin.api.comparisons import Comparison
    from twin.api.studies import Study
    from twin.cluster.certificates import Cluster
    from twin.host.progress import Report
    from twin.trial.loaded_scenario import LoadedScenario
    from twin.trial.plan_result import PlanResult


def study_scenario(
    scenario: Path | None = None,
    *,
    replications: int | None = None,
    precision: float = 0.02,
    least: int = 20,
    most: int = 10_000,
    confidence: float = 0.95,
    policy: Sequence[str] = (),
    vary: Sequence[str] = (),
    deadline: float | None = None,
    antithetic: bool = False,
    sobol: int = 0,
    audit_sample: int = 20,
    audit_engine: str | None = None,
    shortcuts: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    certificates: Path | None = None,
    insecure: bool = False,
    plan: Path | None = None,
    resume: Path | None = None,
    out: Path | None = None,
    progress: Report,
) -> Study:
    """Replicate a plan under uncertainty: how long it takes, and how sure one can be.

    All policies and variants see the same draws, so their differences are sharp. Leaves
    replications.parquet, tasks.parquet, edges.parquet, summary.json, pictures and report.html.

    Args:
        scenario: file, or the name of one that comes with the program.
        replications: of every policy and variant; default: until --precision.
        precision: go on until the interval of the mean is this narrow, relative to it.
        least: at least so many, with --precision.
        most: at most so many, with --precision.
        confidence: of all intervals.
        policy: sequential, synchronous, 'synchronous + TPG', 'synchronous + TPG + shortcuts',
            asynchronous, 'asynchronous + shortcuts' or open-loop; give it again for more.
            Default: sequential, and what twin run executes.
        vary: any key, or one of the execution section: cell.robots.b.base.xyz_m.0=0.7,0.8
            plans each layout and ranks them, skills.pick.scale=1,2 needs no other plan. Give it
            again for every combination.
        deadline: how likely is the run over by then [s]?
        antithetic: draw replications in mirrored pairs.
        sobol: points of the sample for Sobol indices, such as 128; 0 for none.
        audit_sample: open-loop replications that PyBullet checks for collisions.
        audit_engine: what the audit measures with, pybullet or coal; by default PyBullet where it
            is installed, else coal.
        shortcuts: most shortcuts tried on each plan, in place of the scenario's.
        seed: in place of the scenario's.
        workers: processes; 0 for none besides this one. Default: one a core.
        scheduler: address of a Dask scheduler that does the work: tls://host:port.
        certificates: folder with the certificates of the scheduler.
        insecure: use a tcp:// scheduler on another machine, unprotected.
        plan: study the plan in this folder of a run, instead of planning. Without SCENARIO that
            of the run is taken.
        resume: go on with the study in this folder.
        out: folder for the results; default: logs/<scenario>-<UTC time>.
        progress: told how far each stage has come.
    """
    from twin.api import studies
    from twin.scenario.variations import parse_variation
    from twin.study.replications.statistics import Precision

    cluster = _cluster(scheduler, certificates, insecure)
    if resume is not None:
        return studies.resume_study(
            resume, scenario, workers=workers, cluster=cluster, progress=progress
        )
    return studies.study(
        _subject(scenario, plan, seed),
        [parse_variation(text) for text in vary],
        replications=replications,
        precision=Precision(precision, least, most, confidence),
        policies=policy,
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


def _subject(
    path: Path | None, plan: Path | None, seed: int | None
) -> LoadedScenario | PlanResult:
    """Return what is studied: a scenario, or the plan that a run left."""
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


def _cluster(
    scheduler: str | None, certificates: Path | None, insecure: bool
) -> Cluster | None:
    from twin.cluster.certificates import Cluster, certificates_in

    if scheduler is None:
        if certificates is not None or insecure:
            raise RequestError("--certificates and --insecure go with --scheduler")
        return None
    held = None if certificates is None else certificates_in(certificates)
    return Cluster(scheduler, held, insecure)


def _show_study(found: Study, view: View) -> int:
    if view.as_json:
        print_json(found.summary)
    elif not view.quiet:
        from twin.study.report.terminal_table import print_study

        print_study(found.result)
    return COMPLETED


def _columns() -> Sequence[Any]:
    """Return what stands behind the bar of a stage: how many, how long, and how long yet."""
    from rich.progress import (
        MofNCompleteColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    return (
        *(MofNCompleteColumn(), TimeElapsedColumn()),
        *(TextColumn("left"), TimeRemainingColumn()),
    )


def _show_comparison(found: Comparison, view: View) -> int:
    if view.as_json:
        print_json(found.figures)
    elif not view.quiet:
        from twin.comparison.chart import print_comparison

        print_comparison(
            found.figures,
            found.folder,
            heading=found.heading,
            compiled=view.compiled(),
        )
    return COMPLETED


study = command(
    f"{__name__}:study_scenario",
    _show_study,
    columns=_columns,
    replications={"names": ("--replications", "-n"), "min": 1},
    precision={"min": 1e-6},
    least={"min": 2},
    most={"min": 2},
    confidence={"min": 0.5, "max": 0.9999},
    sobol={"min": 0},
    audit_sample={"min": 0},
    certificates={"metavar": "DIR"},
    plan={"metavar": "DIR"},
    resume={"metavar": "DIR"},
)
compare = command("twin.api.comparisons:compare", _show_comparison, seeds={"min": 1})
