"""``twin study`` and ``twin compare``: many runs of a scenario, and what they tell; ``twin explore``: which cell.

``twin cluster``: certificates, and a scheduler and workers that only their holders reach, for studies.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from planning.errors import RequestError
from planning.parallel import usable_cores
from twin.cluster.certificates import (
    DEFAULT_PORT,
    certificates_in,
    encrypted,
    make_certificates,
)
from twin.commands.command import View, command

if TYPE_CHECKING:
    from twin.cluster.certificates import Cluster
    from twin.explore.api import Explored
    from twin.host.progress import Report
    from twin.study.api import Comparison, Study
    from twin.trial.loaded_scenario import LoadedScenario
    from twin.trial.plan_result import PlanResult


def study_scenario(
    scenario: Path | None = None,
    *,
    precision: float = 0.02,
    least: int = 20,
    most: int = 10_000,
    confidence: float = 0.95,
    vary: Sequence[str] = (),
    seed: int | None = None,
    scheduler: str | None = None,
    certificates: Path | None = None,
    insecure: bool = False,
    plan: Path | None = None,
    resume: Path | None = None,
    workers: int | None = None,
    progress: Report,
    **options: Any,
) -> Study:
    """Replicate a plan under uncertainty: how long it takes, and how sure one can be.

    All policies and variants see the same draws, so their differences are sharp. Leaves
    replications.parquet, tasks.parquet, edges.parquet, summary.json, pictures and report.html.

    Args:
        scenario: file, or the name of one that comes with the program.
        precision: go on until the interval of the mean is this narrow, relative to it.
        least: at least so many, with --precision.
        most: at most so many, with --precision.
        confidence: of all intervals.
        vary: any key, or one of the execution section: cell.robots.b.base.xyz_m.0=0.7,0.8
            plans each layout and ranks them, skills.pick.scale=1,2 needs no other plan. Give it
            again for every combination.
        seed: in place of the scenario's.
        scheduler: address of a Dask scheduler that does the work: tls://host:port.
        certificates: folder with the certificates of the scheduler.
        insecure: use a tcp:// scheduler on another machine, unprotected.
        plan: study the plan in this folder of a run, instead of planning. Without SCENARIO that
            of the run is taken.
        resume: go on with the study in this folder.
        workers: processes; 0 for none besides this one. Default: one a core.
        progress: told how far each stage has come.
        options: those of twin.study.
    """
    from twin.scenario.variations import parse_variation
    from twin.study import api as studies
    from twin.study.replications.statistics import Precision

    cluster = given_cluster(scheduler, certificates, insecure)
    if resume is not None:
        return studies.resume_study(
            resume, scenario, workers=workers, cluster=cluster, progress=progress
        )
    return studies.study(
        _subject(scenario, plan, seed),
        [parse_variation(text) for text in vary],
        precision=Precision(precision, least, most, confidence),
        workers=workers,
        cluster=cluster,
        progress=progress,
        **options,
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


def given_cluster(
    scheduler: str | None, certificates: Path | None, insecure: bool
) -> Cluster | None:
    """Return the cluster of three options; None where no scheduler is named.

    Raises:
        RequestError: they do not go together.
    """
    from twin.cluster.certificates import Cluster

    if scheduler is None:
        if certificates is not None or insecure:
            raise RequestError("--certificates and --insecure go with --scheduler")
        return None
    held = None if certificates is None else certificates_in(certificates)
    return Cluster(scheduler, held, insecure)


def explore_scenario(
    scenario: Path | None = None,
    *,
    scheduler: str | None = None,
    certificates: Path | None = None,
    insecure: bool = False,
    **options: Any,
) -> Explored:
    """Search among designs of a cell for the best, and say what it is worth.

    What may be different, and what is looked for, is in the section explore of the scenario. Each design
    is checked, then reached for, planned, planned in full and replicated; what is refused says why.

    Args:
        scenario: a scenario, or the path of its file.
        scheduler: address of a Dask scheduler whose workers evaluate designs: tls://host:port. Files that
            the scenario names must be in the same folder on their machines.
        certificates: folder with the certificates of the scheduler.
        insecure: use a tcp:// scheduler on another machine, unprotected.
        options: those of twin.explore.
    """
    from twin.explore.api import explore

    cluster = given_cluster(scheduler, certificates, insecure)
    return explore(scenario, cluster=cluster, **options)


def _show_study(found: Study, view: View) -> None:
    from twin.study.report.terminal_table import print_study

    view.tell(found.summary, lambda: print_study(found.result))


def _show_explored(found: Explored, view: View) -> None:
    from twin.explore.page_words import print_explored

    view.tell(found.summary, lambda: print_explored(found.found, found.folder))


def columns() -> Sequence[Any]:
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


def _show_comparison(found: Comparison, view: View) -> None:
    from twin.comparison.chart import print_comparison

    figures, folder, heading = found.figures, found.folder, found.heading
    compiled = view.compiled()
    view.tell(
        figures,
        lambda: print_comparison(figures, folder, heading=heading, compiled=compiled),
    )


study = command(
    f"{__name__}:study_scenario",
    _show_study,
    columns=columns,
    passes_to="twin.study.api:study",
    replications={"names": ("--replications", "-n"), "min": 1},
    precision={"min": 1e-6},
    least={"min": 2},
    most={"min": 2},
    confidence={"min": 0.5, "max": 0.9999},
    policies={"names": ("--policy",)},
    deadline_s={"names": ("--deadline",)},
    audited={"names": ("--audit-sample",)},
)
explore = command(
    f"{__name__}:explore_scenario",
    _show_explored,
    passes_to="twin.explore.api:explore",
    columns=columns,
    designs={"min": 1},
    single_changes={"min": 1, "metavar": "N"},
    replications={"names": ("--replications", "-n"), "min": 2},
    workers={"min": 1},
)
compare = command("twin.study.api:compare", _show_comparison, seeds={"min": 1})


cluster = typer.Typer(
    no_args_is_help=True, help="Let other machines help with studies, over TLS."
)


def make(folder: Path, *, days: int = 90) -> None:
    """Make the certificates of a cluster: whoever has them may use it.

    Args:
        folder: folder to make; copy it to members.
        days: valid for so long.
    """
    make_certificates(folder, days)
    typer.echo(f"{folder}: valid for {days} days; key.pem is secret")


def serve(
    *,
    certificates: Path,
    host: str = "127.0.0.1",
    port: int = DEFAULT_PORT,
    workers: int | None = None,
) -> None:
    """Run a scheduler and workers on this machine until Ctrl-C.

    Args:
        certificates: folder that twin cluster certificates has made.
        host: address of this machine to listen on, and on no other.
        port: of the scheduler; 0 for any free one.
        workers: processes on this machine. Default: one a core.
    """
    held = certificates_in(certificates)
    _require_distributed()
    from twin.cluster.serving import serve_cluster

    count = usable_cores() if workers is None else workers
    serve_cluster(held, host, port, count, typer.echo)


def help_out(
    address: str,
    *,
    certificates: Path,
    host: str = "127.0.0.1",
    workers: int | None = None,
) -> None:
    """Run workers on this machine for the scheduler of another, until Ctrl-C.

    Args:
        address: of the scheduler: tls://host:port.
        certificates: folder that twin cluster certificates has made.
        host: address of this machine to listen on, and on no other.
        workers: processes on this machine. Default: one a core.
    """
    if not encrypted(address):
        raise RequestError(f"{address}: give the address as tls://host:port")
    held = certificates_in(certificates)
    _require_distributed()
    from twin.cluster.serving import serve_workers

    count = usable_cores() if workers is None else max(1, workers)
    serve_workers(held, address, host, count, typer.echo)


def _require_distributed() -> None:
    from twin.cluster.client import distributed

    distributed()


for _name, _command in {
    "certificates": command(
        f"{__name__}:make", folder={"metavar": "DIR"}, days={"min": 1, "max": 3650}
    ),
    "up": command(
        f"{__name__}:serve", port={"min": 0, "max": 65535, "default": DEFAULT_PORT}
    ),
    "join": command(f"{__name__}:help_out"),
}.items():
    cluster.command(_name)(_command)
