"""Runs with random stalls, each audited: none may deadlock, no audit may find anything."""

import math
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audits.audit import Auditor
from twin.audits.motion.executed import read_recording
from twin.recorders.run_tables import objects_table, trajectory_table, write_table
from twin.runs.folder import OBJECTS, TRAJECTORY
from twin.runs.trajectory import object_placements, robot_trajectories
from twin.scenario.sections.scenario import Scenario
from twin.trial.simulation import execute
from twin.uncertainty.disturbances import Stalls


@dataclass(frozen=True)
class AuditedRun:
    """One run and what the audit said.

    Attributes:
        plan: ``built`` as the plan was before shortcuts, ``shortened`` after them.
        seed: of durations and stalls.
        stalls: of each robot.
        outcome: completed, failed or aborted.
        makespan_s: with the stalls [s].
        violations: what the audit found, in words.
        configurations: audited.
        least_m: least distance between robots [m], None where they never came close.
        cpu_s: processor seconds of execution and audit.
    """

    plan: str
    seed: int
    stalls: int
    outcome: str
    makespan_s: float
    violations: tuple[str, ...]
    configurations: int
    least_m: float | None
    cpu_s: float


def audited_runs(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    base: Path,
    plan: str,
    wanted: list[tuple[int, int]],
) -> Iterator[AuditedRun]:
    """Execute a plan several times and audit each run.

    Args:
        scenario: what the plan was made for.
        tpg: the plan.
        base: where relative paths of the scenario start.
        plan: what the rows call it.
        wanted: seed and stalls of each robot, run by run.
    """
    with Auditor(tpg) as auditor, tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for seed, stalls in wanted:
            start = time.process_time()
            section = Stalls(count_per_robot=stalls, duration_s=(1.0, 20.0))
            execution = scenario.execution.model_copy(update={"stalls": section})
            chosen = scenario.model_copy(update={"seed": seed, "execution": execution})
            run = execute(chosen, tpg, base, "asynchronous")
            motions = robot_trajectories(tpg, run)
            write_table(folder / TRAJECTORY, trajectory_table(motions))
            write_table(folder / OBJECTS, objects_table(object_placements(tpg, run)))
            found = auditor.audit(read_recording(folder, tpg.cell))
            least = found.min_distance_m
            yield AuditedRun(
                plan,
                seed,
                stalls,
                run.outcome,
                run.makespan_s,
                tuple(str(asdict(violation)) for violation in found.violations),
                found.configurations,
                least if math.isfinite(least) else None,
                time.process_time() - start,
            )


def run_with_stalls(
    scenario: Scenario, tpg: TemporalPlanGraph, base: Path, seed: int, stalls: int
) -> AuditedRun:
    """Execute a plan once with random stalls and audit it."""
    (run,) = audited_runs(scenario, tpg, base, "shortened", [(seed, stalls)])
    return run
