"""Rates of both engines: replications a second in one process.

    python -m benchmarks.engines

Plans the cliff and the chair, executes each with both engines, checks that they agree to the
nanosecond, and writes benchmarks/results/engines.md. The same for the cliff, the chair and the boat within limits of
acceleration, with skills that vary and with robots that stall. Then it runs studies of growing size, each
in a process of its own, and reads their peak memory.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.machine import date_line, load_line, machine_line
from benchmarks.timing_graphs import load_timing_graph, save_timing_graph
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.model import Nanoseconds
from twin.engine.bulk.bulk_engine import BulkEngine
from twin.engine.bulk.max_plus import completions
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.host.progress import StageDisplay, StageWatch
from twin.planning.pipeline import order_motions, plan_in_turns
from twin.scenario.manifest import load_scenario
from twin.scenario.variations import varied
from twin.study.replications.workload import timing_graph
from twin.trial.planning import plan_scenario
from twin.trial.simulation import skill_durations
from twin.uncertainty.disturbances import Disturbances, Stalls
from twin.uncertainty.node_times import SegmentTimes
from twin.uncertainty.skill_durations import SkillDurations

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "benchmarks" / "results" / "engines.md"
MANY = 10_000
WITHIN_LIMITS = ("lego/cliff.yaml", "lego/chair.yaml", "multi_arm/assembly.yaml")
STALLS = Disturbances(stalls=Stalls(count_per_robot=10, duration_s=(1.0, 20.0)))
COMPARED = 300
"""Replications within limits that both engines execute, fewer where they take long."""

COMPARED_S = 60.0
"""Time of the event engine for them [CPU s]."""

SIDE_BY_SIDE = 1_000
"""Replications within limits that the bulk engine is timed with."""

STUDIES = (1_000, 10_000, 100_000)


@dataclass(frozen=True)
class Rates:
    """Rates of both engines with one plan.

    Attributes:
        scenario: its name.
        nodes: of the plan.
        segments, edges: of its contraction.
        events_per_s: replications a second of the event engine.
        makespans_s: CPU time of MANY replications side by side, makespans only [s].
        everything_s: the same with starts, ends, waits, critical paths and slack [s].
    """

    scenario: str
    nodes: int
    segments: int
    edges: int
    events_per_s: float
    makespans_s: float
    everything_s: float

    @property
    def ratio(self) -> float:
        """Speed-up of many replications side by side."""
        return MANY / self.makespans_s / self.events_per_s


@dataclass(frozen=True)
class RatesWithinLimits:
    """Rates of both engines with one plan within limits of acceleration.

    Attributes:
        scenario: its name.
        varies: what varies.
        nodes, edges: of the plan; no nodes are joined, as robots pass borders at speed.
        compared: replications that both engines executed.
        events_per_s: replications a second of the event engine, CPU time.
        makespans_per_s: of the bulk engine, SIDE_BY_SIDE of them, makespans only.
        everything_per_s: the same with starts, ends, waits and critical paths.
    """

    scenario: str
    varies: str
    nodes: int
    edges: int
    compared: int
    events_per_s: float
    makespans_per_s: float
    everything_per_s: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--out", type=Path, default=RESULT)
    parser.add_argument(
        "--peak", nargs=2, metavar=("GRAPH", "N"), help=argparse.SUPPRESS
    )
    options = parser.parse_args(arguments)
    if options.peak:
        peak = _study_in_this_process(Path(options.peak[0]), int(options.peak[1]))
        sys.stdout.write(f"{peak}\n")
        return 0
    before = os.getloadavg()[0]
    rates = []
    with StageDisplay() as progress:
        for name in ("cliff", "chair"):
            path = ROOT / "scenarios" / "lego" / f"{name}.yaml"
            scenario = load_scenario(path)
            watch = StageWatch(progress)
            turns = plan_in_turns(scenario, path.parent, watch)
            plan = order_motions(turns.motion_plan, watch)
            durations = skill_durations(scenario, path.parent)
            rates.append(measure(name, plan, durations))
            if name == "cliff":
                graph = ROOT / "benchmarks" / ".measured" / "cliff.npz"
                graph.parent.mkdir(exist_ok=True)
                save_timing_graph(graph, timing_graph(plan))
    limited = [row for name in WITHIN_LIMITS for row in measure_within_limits(name)]
    peaks = [(count, _peak_mib(graph, count)) for count in STUDIES]
    load = load_line([(before, os.getloadavg()[0])])
    text = _report(rates, limited, peaks, load)
    options.out.write_text(text, encoding="utf-8")
    sys.stdout.write(f"{options.out}\n")
    return 0


def measure(name: str, tpg: TemporalPlanGraph, durations: SkillDurations) -> Rates:
    """Measure both engines with one plan, kernels compiled."""
    model = ExecutionModel(durations)
    bulk = BulkEngine(tpg, model)
    _everything(bulk, range(2))
    events = Simulator(tpg, model)
    found = _makespans_ns(bulk, MANY)
    count = 0

    def replicate() -> None:
        nonlocal count
        run = events.run(seed=0, replication=count)
        if run.makespan_ns != found[count]:
            raise AssertionError(f"{name}: engines disagree in replication {count}")
        count += 1

    clock = time.process_time()
    while time.process_time() - clock < 5 or count < 20:
        replicate()
    rate = count / (time.process_time() - clock)
    return Rates(
        scenario=name,
        nodes=sum(len(chain) for chain in tpg.chains),
        segments=len(bulk.graph.order),
        edges=len(bulk.graph.source),
        events_per_s=rate,
        makespans_s=_seconds(lambda: _makespans_ns(bulk, MANY)),
        everything_s=_seconds(lambda: _in_blocks(bulk)),
    )


def measure_within_limits(name: str) -> list[RatesWithinLimits]:
    """Plan a scenario within limits and measure both engines, with and without stalls.

    Raises:
        AssertionError: the engines disagree on when any node starts or ends.
    """
    path = ROOT / "scenarios" / name
    scenario = varied(load_scenario(path), {"planning.speed_model": "limits"})
    tpg = plan_scenario(scenario, path.parent).tpg
    durations = skill_durations(scenario, path.parent)
    rows = []
    for varies, disturbances in (
        ("skills", Disturbances()),
        ("skills, stalls", STALLS),
    ):
        model = ExecutionModel(durations, disturbances=disturbances)
        bulk, events = BulkEngine(tpg, model), Simulator(tpg, model)
        found = bulk.execute(bulk.sample(seed=0, replications=range(COMPARED)))
        events.run(seed=0)
        clock = time.process_time()
        runs = []
        while len(runs) < COMPARED and time.process_time() - clock < COMPARED_S:
            runs.append(events.run(seed=0, replication=len(runs)))
        rate = len(runs) / (time.process_time() - clock)
        for k, run in enumerate(runs):
            for ours, theirs in (
                (run.start_ns, found.start_ns),
                (run.end_ns, found.end_ns),
            ):
                if not np.array_equal(np.concatenate(ours), theirs[:, k]):
                    raise AssertionError(f"{name}: engines disagree in replication {k}")
        rows.append(
            RatesWithinLimits(
                scenario=path.stem,
                varies=varies,
                nodes=sum(len(chain) for chain in tpg.chains),
                edges=len(tpg.edges),
                compared=len(runs),
                events_per_s=rate,
                makespans_per_s=_rate(bulk, bulk.makespans),
                everything_per_s=_rate(bulk, bulk.execute),
            )
        )
    return rows


def _rate(bulk: BulkEngine, execute: Callable[[SegmentTimes], object]) -> float:
    """Return replications a second, drawing included."""

    def work() -> None:
        for first in range(0, SIDE_BY_SIDE, 500):
            execute(bulk.sample(seed=0, replications=range(first, first + 500)))

    return SIDE_BY_SIDE / _seconds(work)


def _in_blocks(bulk: BulkEngine) -> None:
    """Execute MANY replications as a study does, some hundred at a time."""
    for first in range(0, MANY, 500):
        _everything(bulk, range(first, first + 500))


def _everything(bulk: BulkEngine, replications: range) -> None:
    completions(bulk.graph, bulk.sample(seed=0, replications=replications).busy_ns)


def _makespans_ns(bulk: BulkEngine, count: int) -> Nanoseconds:
    return bulk.makespans(bulk.sample(seed=0, replications=range(count)))


def _seconds(work: Callable[[], object]) -> float:
    """Return the least CPU time of three tries [s]."""
    tries = []
    for _ in range(3):
        clock = time.process_time()
        work()
        tries.append(time.process_time() - clock)
    return min(tries)


def _peak_mib(graph: Path, count: int) -> float:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.engines", "--peak", str(graph), str(count)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return float(done.stdout)


def _study_in_this_process(graph: Path, count: int) -> float:
    """Run a study of one cell and return the peak memory of this process [MiB]."""
    import tempfile

    from twin.study.folder import write_replications
    from twin.study.replications.runner import run_replications
    from twin.study.replications.statistics import Experiment
    from twin.study.replications.workload import Workload, open_executor

    path = ROOT / "scenarios" / "lego" / "cliff.yaml"
    models = load_scenario(path).execution.skill_models(path.parent)
    load = Workload(
        load_timing_graph(graph),
        ExecutionModel(SkillDurations(models)),
        seed=0,
    )
    experiment = Experiment(("asynchronous",), replications=count)
    with tempfile.TemporaryDirectory() as folder:
        blocks = Path(folder) / "blocks"
        run_replications(experiment, [load], blocks, lambda: open_executor(workers=0))
        write_replications(Path(folder) / "replications.parquet", experiment, blocks)
    # Not ru_maxrss, which a process inherits from the one that started it.
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return int(peak.split()[1]) / 1024


def _report(
    rates: Sequence[Rates],
    limited: Sequence[RatesWithinLimits],
    peaks: Sequence[tuple[int, float]],
    load: str,
) -> str:
    lines = [
        "# Two engines",
        "",
        f"{machine_line()}, {date_line()}, seed 0. One process, kernels compiled,"
        f" CPU time; {load}.",
        "The engines agreed to the nanosecond in every replication that both executed.",
        "",
        "| plan | nodes | segments | type-2 edges | event engine [1/s] |"
        f" {MANY} makespans [s] | {MANY} in full [s] | ratio |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {r.scenario} | {r.nodes} | {r.segments} | {r.edges} | {r.events_per_s:.0f}"
        f" | {r.makespans_s:.2f} | {r.everything_s:.2f} | {r.ratio:.0f} |"
        for r in rates
    ]
    lines += [
        "",
        "*In full* is with starts, ends, waits by cause, critical paths and slack, in blocks of 500"
        " as in a study. *Ratio* is replications a second side by side, makespans only, against"
        " the event engine.",
        "",
        "## Within limits of acceleration",
        "",
        "`planning.speed_model: limits`: how long a robot takes for a node depends on how far it was cleared when it came to its"
        " border, so nodes are not joined, and the bulk engine drives every robot from border to border. The engines agreed to"
        " the nanosecond on the start and the end of every node in all replications that both executed. Stalls: every robot"
        " stands still at 10 random nodes for 1 to 20 s. Replications a second of CPU time; of the bulk engine in blocks"
        " of 500, drawing included.",
        "",
        "| plan | varies | nodes | type-2 edges | both executed | event engine [1/s] | bulk engine, makespans [1/s]"
        " | bulk engine, in full [1/s] | ratio |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {r.scenario} | {r.varies} | {r.nodes} | {r.edges} | {r.compared} |"
        f" {r.events_per_s:.2g} | {r.makespans_per_s:.0f} | {r.everything_per_s:.0f} |"
        f" {r.makespans_per_s / r.events_per_s:.0f} |"
        for r in limited
    ]
    lines += [
        "",
        "## Memory of a study of the cliff",
        "",
        "| replications | peak memory of the process [MiB] |",
        "|---:|---:|",
    ]
    lines += [f"| {count} | {peak:.0f} |" for count, peak in peaks]
    growth = np.diff([peak for _, peak in peaks])[-1]
    grown = STUDIES[-1] - STUDIES[-2]
    lines += [
        "",
        f"The last {grown} replications added {growth * 2**20 / grown:.0f} bytes each; the"
        " makespans that the stopping rule looks at are 8 of them.",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
