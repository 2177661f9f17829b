"""Monte-Carlo study: planning, replications, audits and summary."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import OutputError, RequestError
from planning.files import read_object
from scheduling.graph.plan_files import save_plan
from scheduling.planned_motions import PlannedMotions
from twin.audits.audit import audit_off_bases, audit_run
from twin.audits.motion.deviations import with_flange_deviations
from twin.audits.motion.executed import read_recording
from twin.audits.worlds.engines import Engine, engine_named
from twin.bulk.bulk_engine import BulkEngine
from twin.cluster.client import ClusterError, ClusterLostError
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.engine import Simulator
from twin.engine.execution_model import Messages
from twin.engine.model_holds import with_model_holds
from twin.host.atomic_files import write_json
from twin.host.progress import Report, report_nothing
from twin.planning.build_workcell import build_workcell
from twin.recorders.run_tables import write_motion
from twin.runs.policies import OPEN_LOOP, named_policies
from twin.scenario.sections.scenario import Scenario
from twin.scenario.variations import apply_variation, is_of_execution, layout_of
from twin.studies.folder import (
    AUDITS,
    BLOCKS,
    EDGES,
    PLANS,
    PREVENTED,
    PRODUCTS,
    REPLICATIONS,
    SUMMARY,
    TASKS,
    StudyRequest,
    edge_columns,
    read_request,
    require_same_plans,
    task_columns,
    write_cells,
    write_replications,
    write_request,
)
from twin.studies.gains.files import write_gains
from twin.studies.gains.gains import CellGains, study_gains
from twin.studies.operated_figures import (
    OperatedSummary,
    Prevention,
    find_preventions,
    operated_summary,
    prevented_makespans_s,
)
from twin.studies.plans import (
    Plans,
    distinct,
    given_plans,
    load_plans,
    plan_hashes,
    plan_key,
    plans_of_layouts,
    save_plans,
    workloads,
)
from twin.studies.pose_errors import drawn_base, drawn_deviations
from twin.studies.products import orders_of, product_columns, study_product_times
from twin.studies.replications.block_results import cell_tally
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.runner import OpenExecutor, run_replications
from twin.studies.replications.workload import Workload
from twin.studies.sensitivity import INFLUENCES, input_influences, sobol_indices
from twin.studies.summary import StudySummary, shown_cell, summarise_study
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.planning import plan_scenario
from twin.trial.simulation import skill_durations
from twin.uncertainty.disturbances import Speed

CHECKING = "audit of replications"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class StudyResult:
    """Result of a study.

    Attributes:
        folder: folder of its files.
        request: the request.
        summary: its figures.
        loads: workload of each cell.
        gains: gains of interventions, by cell.
        raised_skills: number of skills in replication 0 whose drawn durations were shorter than the joint
            speed limits allow, and were raised to these; largest over the cells.
    """

    folder: Path
    request: StudyRequest
    summary: StudySummary
    loads: Sequence[Workload]
    gains: Sequence[CellGains]
    raised_skills: int


def start_study(
    request: StudyRequest,
    folder: Path,
    open_executor: OpenExecutor,
    progress: Report = report_nothing,
    plans: Plans | None = None,
    motions: PlannedMotions | None = None,
) -> StudyResult:
    """Plan a scenario and run its study into a folder.

    Args:
        request: the request.
        folder: folder of the study, which exists and is empty.
        open_executor: opens an executor.
        progress: receives the progress of each stage.
        plans: the studied plans; None to plan.
        motions: their base motions, for replanning.

    Raises:
        ScenarioError: a varied input does not fit the scenario.
        RequestError: the scenario cannot be planned, or the deadline is not possible.
    """
    experiment, scenario = request.experiment, request.scenario
    # Refuse inputs that do not fit the scenario before planning, which takes long.
    case = LoadedScenario(scenario, request.base)
    executions = [
        {key: variant[key] for key in variant if is_of_execution(key)}
        for variant in experiment.variants
    ]
    for own in distinct(executions):
        case.varied(own)
    for variant in experiment.variants:
        if layout_of(variant):
            _require_fitting(apply_variation(scenario, variant), request.base)
    if plans is None:
        request, plans = plans_of_layouts(request, progress)
    elif any(map(layout_of, experiment.variants)):
        keys = ", ".join(layout_of(experiment.variants[0]))
        raise RequestError(f"{keys}: a plan that is there cannot be varied; plan again")
    save_plans(plans, folder / PLANS)
    # The manifest is written last: a folder that has one can be resumed.
    cell = build_workcell(scenario, request.base)
    write_request(folder, request, cell, plan_hashes(plans))
    return _run(request, folder, plans, motions, open_executor, progress)


def resume_study(
    folder: Path, open_executor: OpenExecutor, progress: Report = report_nothing
) -> StudyResult:
    """Resume an interrupted study; nothing is computed twice.

    The data for replanning is not saved: with replanning, the plans are made again.

    Raises:
        OutputError: the folder is not that of a study whose plans are saved.
    """
    request = read_request(folder)
    plans, motions = load_plans(folder / PLANS, request.experiment), None
    if request.operated:
        made = plan_scenario(
            LoadedScenario(request.scenario, request.base), progress=progress, keep=True
        )
        motions, plans = made.motions, given_plans(made, request.experiment.policies)
    require_same_plans(folder, plan_hashes(plans))
    return _run(request, folder, plans, motions, open_executor, progress)


def _run(
    request: StudyRequest,
    folder: Path,
    plans: Plans,
    motions: PlannedMotions | None,
    open_executor: OpenExecutor,
    progress: Report,
) -> StudyResult:
    experiment = request.experiment
    loads = workloads(request.scenario, request.base, plans, experiment, motions)
    _check_possible(request.deadline_s, loads)
    blocks = folder / BLOCKS
    try:
        count = run_replications(experiment, loads, blocks, open_executor, progress)
        prevented = list(find_preventions(loads, blocks))
        if prevented:
            again = replace(experiment, replications=count)
            others = [own.load for own in prevented]
            place = folder / PREVENTED
            run_replications(again, others, place, open_executor, progress)
    except (ClusterError, ClusterLostError) as error:
        raise ClusterLostError(
            f"{error}; what was done is kept, continue with --resume {folder}"
        ) from error
    audits = _audits(experiment, folder, plans, loads, progress)
    write_replications(folder / REPLICATIONS, experiment, blocks)
    tallies = [cell_tally(blocks, cell) for cell in range(len(loads))]
    write_cells(folder / TASKS, experiment, map(task_columns, loads, tallies))
    write_cells(folder / EDGES, experiment, map(edge_columns, loads, tallies))
    _write_products(request, folder)
    operated = _operated(experiment, folder, loads, prevented)
    summary = summarise_study(request, blocks, loads, audits, operated)
    counts = [cell.replications for cell in summary.cells]
    gains = study_gains(experiment, loads, counts, progress)
    write_gains(folder, experiment, gains)
    counted = [tally.count > 0 for tally in tallies]
    summary = _with_sensitivity(request, summary, loads, counted, gains, progress)
    write_json(folder / SUMMARY, summary.content())
    raised_skills = max(
        load.execution.durations.bind(load.tpg).raised(seed=load.seed, replication=0)
        for load in loads
    )
    return StudyResult(folder, request, summary, loads, gains, raised_skills)


def _with_sensitivity(
    request: StudyRequest,
    summary: StudySummary,
    loads: Sequence[Workload],
    counted: Sequence[bool],
    gains: Sequence[CellGains],
    progress: Report,
) -> StudySummary:
    """Return the summary with gains, tornado chart and Sobol indices of each cell.

    Cells without a replication that was executed as planned (``counted``) have gains only.
    """
    experiment, confidence = request.experiment, summary.confidence
    first, cells = shown_cell(summary, experiment.policies), []
    how: dict[str, Any] = {
        "confidence": confidence,
        "antithetic": experiment.antithetic,
    }
    for k, (cell, load) in enumerate(zip(summary.cells, loads, strict=True)):
        found: dict[str, Any] = {"gains": gains[k].leading}
        progress(INFLUENCES, k, len(loads))
        if cell.makespan_s is not None and counted[k]:
            found["tornado"] = tuple(input_influences(load, **how))
            if (points := request.sobol_points) and k == first:
                own: dict[str, Any] = {
                    "seed": request.scenario.seed,
                    "confidence": confidence,
                }
                indices = sobol_indices(load, points, **own, progress=progress)
                found["sobol"] = tuple(indices)
        cells.append(cell.model_copy(update=found))
    progress(INFLUENCES, len(loads), len(loads))
    return summary.model_copy(update={"cells": tuple(cells)})


def _operated(
    experiment: Experiment,
    folder: Path,
    loads: Sequence[Workload],
    prevented: Sequence[Prevention],
) -> dict[int, OperatedSummary]:
    """Return the cost of failures in each cell with replanning."""
    blocks, found = folder / BLOCKS, {}
    for cell, load in enumerate(loads):
        if load.operated is not None:
            others = [
                (own, prevented_makespans_s(blocks, cell, folder / PREVENTED, place))
                for place, own in enumerate(prevented)
                if own.cell == cell
            ]
            found[cell] = operated_summary(experiment, blocks, cell, others)
    return found


def _write_products(request: StudyRequest, folder: Path) -> None:
    """Write the tables of products, where there are several."""
    columns: list[dict[str, Any] | None] = []
    for cell, (_, variant) in enumerate(request.experiment.cells):
        times = study_product_times(folder / BLOCKS, cell)
        orders = orders_of(apply_variation(request.scenario, variant))
        columns.append(None if times is None else product_columns(times, orders))
    write_cells(folder / PRODUCTS, request.experiment, columns)


def _require_fitting(scenario: Scenario, base: Path) -> None:
    """Refuse a variant with unknown robots or missing files of measured durations."""
    skill_durations(scenario, base)
    names = tuple(robot.name for robot in scenario.cell.robots)
    scenario.execution.disturbances(names, base)


def _audits(
    experiment: Experiment,
    folder: Path,
    plans: Plans,
    loads: Sequence[Workload],
    progress: Report,
) -> dict[int, list[int]]:
    """Return the collisions in audited replications of open-loop cells and cells with pose errors."""
    drawn: dict[int, Workload] = {}
    for cell, (policy, variant) in enumerate(experiment.cells):
        tpg = plans[plan_key(variant, named_policies()[policy].plan)]
        load = replace(loads[cell], tpg=tpg)  # the workload's own graph has no shapes
        if policy == OPEN_LOOP or _describe_pose_errors(load):
            drawn[cell] = load
    count = experiment.audited
    if experiment.replications is not None:
        count = min(count, experiment.replications)
    found: dict[int, list[int]] = {}
    if not (drawn and count):
        return found
    engine = engine_named(experiment.audit_engine)
    for k, (cell, load) in enumerate(drawn.items()):
        found[cell] = []
        place = folder / AUDITS / str(cell)
        for collisions in _audit_cell(load, place, count, engine):
            found[cell].append(collisions)
            progress(CHECKING, k * count + len(found[cell]), len(drawn) * count)
    return found


def _describe_pose_errors(load: Workload) -> str:
    """Return a description of pose errors: of bases, or of tools in skills."""
    disturbances, cell = load.execution.disturbances, load.tpg.cell
    what = {
        "bases": any(disturbances.base_error_of(robot) for robot in cell.robots),
        "skills": any(disturbances.deviations_in(cell).values()),
    }
    return " and ".join(name for name, off in what.items() if off)


def _audit_cell(
    load: Workload, folder: Path, count: int, engine: Engine
) -> Iterator[int]:
    """Yield the number of collisions in each of the first replications.

    Base and skill errors differ between replications, and only contacts are checked then. Findings are
    saved in one small file per replication, so that an interrupted study can be resumed. Incomplete
    replications are skipped. The workload has the geometry of its plan.
    """
    folder.mkdir(parents=True, exist_ok=True)
    simulator = Simulator(with_model_holds(load.tpg, load.execution), load.execution)
    replay = folder / "replay"
    for replication in range(count):
        path = folder / f"{replication}.json"
        if path.exists():
            yield _violations(path)
            continue
        run = simulator.run(seed=load.seed, replication=replication)
        if run.outcome != "completed":
            continue
        if not replay.exists():
            replay.mkdir()
            save_plan(load.tpg, replay)
        write_motion(replay, load.tpg, run)
        if _describe_pose_errors(load):
            disturbances, cell = load.execution.disturbances, load.tpg.cell
            how = {"seed": load.seed, "replication": replication}
            known = disturbances.deviations_in(cell)
            twists = drawn_deviations(load.tpg, known, **how)
            recording = with_flange_deviations(
                cell, read_recording(replay, cell), twists
            )
            bases = {
                robot.name: drawn_base(robot, disturbances.base_error_of(robot), **how)
                for robot in cell.robots
            }
            report = audit_off_bases(load.tpg, recording, bases, engine)
        else:
            report = audit_run(replay, ordered=False, engine=engine)
        least = report.min_distance_m
        found = {
            "replication": replication,
            "engine": report.engine,
            "violations": len(report.violations),
            "min_distance_m": least if np.isfinite(least) else None,
        }
        write_json(path, found)
        yield len(report.violations)
    shutil.rmtree(replay, ignore_errors=True)


def _violations(path: Path) -> int:
    """Return the saved number of collisions of a replication."""
    found = read_object(path, "audit of a study").get("violations")
    if type(found) is not int or found < 0:
        raise OutputError(f"{path}: violations must be a whole number")
    return found


def _check_possible(deadline_s: float | None, loads: Sequence[Workload]) -> None:
    """Refuse a deadline before the earliest end that any durations allow."""
    if deadline_s is None:
        return
    bounds = [
        BulkEngine(
            load.tpg, replace(load.execution, messages=Messages())
        ).least_makespan_ns()
        for load in loads
        # With speed factors, motions may be faster than planned: then there is no such bound.
        if load.execution.disturbances.speed == Speed()
    ]
    if len(bounds) == len(loads) and deadline_s * NANOSECONDS < min(bounds):
        raise RequestError(
            f"a deadline of {deadline_s:g} s is impossible: even if every skill is as"
            f" quick as it can be, the run takes {min(bounds) / NANOSECONDS:.1f} s"
        )
