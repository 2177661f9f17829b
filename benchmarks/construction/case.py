"""Measures one construction: planned, checked, executed and audited; or planned by the baseline."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path

from benchmarks.construction.fine_check.check import check_construction
from benchmarks.construction.fixed_time import plan_fixed_time
from benchmarks.construction.schedule import longest_chain, schedule
from benchmarks.stalled_runs import audited_runs
from benchmarks.store import Row
from planning.construction.motion_plan_export import motion_plan
from planning.construction.planner import ConstructionPlan, plan_construction
from planning.construction.problem.problem import ConstructionProblem
from planning.errors import TwinError
from scheduling.build_tpg import build_tpg
from scheduling.graph.rollout import earliest_times
from twin.host.progress import Report
from twin.kinds.construction.kind import ConstructionKind
from twin.kinds.construction.section import ConstructionSection
from twin.planning.build_workcell import build_workcell
from twin.planning.pipeline import motion_settings
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.cell import choose_robots
from twin.scenario.sections.scenario import Scenario, resolve_scenario, restore_scenario

FOLDER = Path(__file__).parents[2] / "scenarios" / "construction"

PARTS = "parts placed"
"""Name of the stage for progress displays."""


class OutOfTimeError(TwinError):
    """Planning took more processor time than it was given."""


def case_scenario(model: str, robots: int, seed: int) -> Scenario:
    """Return a shipped construction with so many robots, of its team or one by one, and a seed."""
    content = resolve_scenario(load_scenario(FOLDER / f"{model}.yaml"))
    cell = content["cell"]
    alone = len(cell["robots"]) if cell["team"] is not None else 0
    choose_robots(cell, robots - alone)
    content["seed"] = seed
    return restore_scenario(content)


def measure_method(
    model: str,
    robots: int,
    seed: int,
    *,
    limit: float,
    stalled: int,
    progress: Report,
) -> Row:
    """Plan a construction, check it, execute and audit it; all of it as a row.

    Args:
        model: name of a shipped scenario.
        robots: size of the team.
        seed: of everything that is drawn.
        limit: processor time for planning [s].
        stalled: runs with stalls besides the nominal one; no run at all where negative.
        progress: told how many parts are placed.
    """
    scenario = case_scenario(model, robots, seed)
    row: Row = {"what": "method", "model": model, "robots": robots, "seed": seed}
    row["load"] = _load()
    gc.collect()
    start = time.perf_counter(), time.process_time()
    try:
        problem = case_problem(scenario)
        checked = time.perf_counter(), time.process_time()
        row |= _about(problem)
        plan = plan_construction(problem, progress=_watched(limit, progress))
    except TwinError as error:
        return row | _failed(error, start)
    done = time.perf_counter(), time.process_time()
    row |= _planned(plan)
    for k, (name, by) in enumerate((("wall_s", plan.seconds), ("cpu_s", plan.cpu))):
        row[name] = {"checks": checked[k] - start[k], **by}
        row[name]["other"] = done[k] - start[k] - sum(row[name].values())
        row[name]["total"] = done[k] - start[k]
    row["fine"] = _fine(plan)
    began = time.process_time()
    motions = motion_plan(problem, plan.building)
    tpg = build_tpg(motions)
    row["tpg"] = {
        "cpu_s": time.process_time() - began,
        "nodes": sum(len(chain) for chain in tpg.chains),
        "edges": len(tpg.edges),
        "planned_s": max(float(m.time[-1]) for m in motions.motions),
        "executed_s": earliest_times(tpg).makespan,
    }
    wanted = [(seed, 0), *((seed + k, 5) for k in range(1, stalled + 1))]
    runs = audited_runs(scenario, tpg, FOLDER, "built", wanted if stalled >= 0 else [])
    row["runs"] = [asdict(run) for run in runs]
    return row


def measure_baseline(
    model: str,
    robots: int,
    seed: int,
    duration: float,
    *,
    limit: float,
    progress: Report,
) -> Row:
    """Plan a construction with actions of a fixed duration; see measure_method.

    The duration is T [s]. The checks that come before planning are not measured.
    """
    row: Row = {"what": "baseline", "model": model, "robots": robots, "seed": seed}
    row |= {"duration_s": duration, "load": _load()}
    problem = case_problem(case_scenario(model, robots, seed))
    gc.collect()
    start = time.perf_counter(), time.process_time()
    try:
        plan = plan_fixed_time(problem, duration, progress=_watched(limit, progress))
    except TwinError as error:
        return row | _failed(error, start)
    done = time.perf_counter(), time.process_time()
    row |= _planned(plan)
    for k, (name, by) in enumerate((("wall_s", plan.seconds), ("cpu_s", plan.cpu))):
        row[name] = dict(by)
        row[name]["other"] = done[k] - start[k] - sum(by.values())
        row[name]["total"] = done[k] - start[k]
    row["fine"] = _fine(plan)
    return row


def warm_up() -> None:
    """Load all kernels, so that nobody's planning is measured with their compilation.

    A small team at a small tower would not need all of them: its straight ways are free.
    """
    problem = case_problem(case_scenario("tower", 5, 100))
    plan = plan_construction(problem)
    plan_fixed_time(problem, 4.0)
    check_construction(plan)
    earliest_times(build_tpg(motion_plan(problem, plan.building)))


def case_problem(scenario: Scenario) -> ConstructionProblem:
    """Return what is to be built in a scenario, checked."""
    cell = build_workcell(scenario, FOLDER)
    section = scenario.assembly
    assert isinstance(section, ConstructionSection)
    settings = motion_settings(scenario, cell, FOLDER)
    return ConstructionKind(section).problem(cell, settings)


def _about(problem: ConstructionProblem) -> Row:
    """Return how far a model can be built at several places at once."""
    chain = longest_chain(problem.graph, carried=problem.carried)
    return {
        "parts": len(problem.parts),
        "longest_chain": len(chain),
        "chain_s": len(chain) * problem.seconds.place,
    }


def _planned(plan: ConstructionPlan) -> Row:
    return {
        "ok": True,
        "makespan_s": plan.makespan,
        "rewound": plan.rewound,
        "failures": len(plan.failures),
        "schedule": [list(span) for span in schedule(plan)],
    }


def _fine(plan: ConstructionPlan) -> Row:
    began = time.process_time()
    found = check_construction(plan)
    return {
        "measured": found.measured,
        "faults": [str(fault) for fault in found.faults],
        "least_robots_m": min(found.least_robots_m, 1e3),
        "least_others_m": min(found.least_others_m, 1e3),
        "cpu_s": time.process_time() - began,
    }


def _failed(error: TwinError, start: tuple[float, float]) -> Row:
    wall, cpu = time.perf_counter() - start[0], time.process_time() - start[1]
    totals: Mapping[str, Row] = {"wall_s": {"total": wall}, "cpu_s": {"total": cpu}}
    return {"ok": False, "reason": str(error), **totals}


def _watched(limit: float, progress: Report) -> Callable[[float, float], None]:
    """Return what is told of every part, and stops planning when its time is over."""
    end = time.process_time() + limit

    def watch(done: float, total: float) -> None:
        progress(PARTS, done, total)
        if time.process_time() > end and done < total:
            raise OutOfTimeError(
                f"stopped after {limit:.0f} s of processor time, {done} of {total} parts placed"
            )

    return watch


def _load() -> float:
    """Return how busy the machine is: processes that run or wait, a minute's average."""
    import os

    return os.getloadavg()[0]
