"""Time to build the temporal plan graph.

    python -m benchmarks.tpg_construction [SCENARIO]

Plans a scenario (the chair by default) one task after another, then builds its graph: as a whole
with the proof of its guarantee, and step by step on one core. Writes
benchmarks/results/tpg-construction.md and .json (for another scenario with its name behind).
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from os import getloadavg
from pathlib import Path
from typing import TypeVar

import numpy as np

from benchmarks.machine import date_line, load_line, machine_line
from planning.motion.motion_plan import MotionPlan
from planning.transforms import Indices
from scheduling.build_nodes import build_nodes
from scheduling.build_tpg import build_tpg, find_motion_edges
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.reduction import order_and_reduce
from scheduling.graph.task_edges import dependency_edges
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.host.progress import StageWatch
from twin.planning.pipeline import plan_in_turns
from twin.scenario.file import load_scenario

RESULTS = Path(__file__).parent / "results"
CHAIR = Path("scenarios/lego/chair.yaml")
SMALL = Path("scenarios/lego/cliff.yaml")

REPEATS = 2
"""Repetitions of each measurement; the quickest counts."""

Result = TypeVar("Result")


@dataclass(frozen=True)
class Search:
    """Finding motion edges; processor seconds of all threads.

    Attributes:
        bodies_s: segments, their capsules, and the tree.
        search_s: finding the edges.
        total_s: the whole construction: nodes, bodies, search and reduction.
        found: motion edges found.
        reduced: edges of the graph after reduction.
    """

    bodies_s: float
    search_s: float
    total_s: float
    found: int
    reduced: int


@dataclass(frozen=True)
class Built:
    """Times to build the graph of a plan.

    Attributes:
        nodes: of all robots.
        edges: of the reduced graph.
        wall_s, cpu_s: whole construction, the proof of the guarantee included.
        memory_mib: largest resident memory up to then, planning included.
        search: on one core, the best of REPEATS.
    """

    nodes: int
    edges: int
    wall_s: float
    cpu_s: float
    memory_mib: int
    search: Search


def measure_plan(plan: MotionPlan) -> Built:
    """Build the graph of a plan and measure it."""
    start = time.perf_counter()
    tpg, cpu = _clock(lambda: build_tpg(plan))
    wall = time.perf_counter() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    # On one core: two threads on one that is shared would count much of each other's time.
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    # The first search pays for fresh memory.
    search = min(
        (_search(plan) for _ in range(REPEATS)), key=lambda found: found.total_s
    )
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    return Built(sum(map(len, tpg.chains)), len(tpg.edges), wall, cpu, memory, search)


def _search(plan: MotionPlan) -> Search:
    (tpg, task_edges), common = _clock(lambda: _nodes(plan))
    nodes = DerivedTpg(tpg)
    _, made = _clock(lambda: nodes.occupancies)
    found, searched = _clock(lambda: find_motion_edges(nodes, task_edges))
    edges, reduced = _clock(lambda: _reduced(nodes.ranks, task_edges, found))
    total = common + made + searched + reduced
    return Search(made, searched, total, len(found), len(edges))


def _nodes(plan: MotionPlan) -> tuple[TemporalPlanGraph, Indices]:
    tpg = build_nodes(plan)
    return tpg, dependency_edges(tpg)


def _reduced(
    ranks: tuple[Indices, ...], task_edges: Indices, motion_edges: Indices
) -> Indices:
    edges = np.concatenate([task_edges, motion_edges])
    return np.unique(edges[order_and_reduce(ranks, edges)[1]], axis=0)


def _clock(work: Callable[[], Result]) -> tuple[Result, float]:
    start = time.process_time()
    out = work()
    return out, time.process_time() - start


def _plan(file: Path) -> tuple[int, MotionPlan]:
    scenario = load_scenario(file)
    turns = plan_in_turns(scenario, file.parent, StageWatch())
    return scenario.seed, turns.motion_plan


def main() -> int:
    """Measure and write the result files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario", type=Path, nargs="?", default=CHAIR)
    options = parser.parse_args()
    # Kernels are loaded apart from what is measured.
    measure_plan(_plan(SMALL)[1])
    seed, plan = _plan(options.scenario)
    before = getloadavg()[0]
    built = measure_plan(plan)
    load = load_line([(before, getloadavg()[0])])
    own = options.scenario.resolve() == CHAIR.resolve()
    target = RESULTS / (
        "tpg-construction" if own else f"tpg-construction-{options.scenario.stem}"
    )
    RESULTS.mkdir(exist_ok=True)
    report = _report(options.scenario.stem, seed, load, built)
    target.with_suffix(".md").write_text(report)
    text = json.dumps(
        {
            "scenario": options.scenario.stem,
            "seed": seed,
            "date": date_line(),
            "machine": machine_line(),
            "load": load,
            **asdict(built),
        },
        indent=1,
    )
    target.with_suffix(".json").write_text(text + "\n")
    sys.stdout.write(report)
    return 0


def _report(name: str, seed: int, load: str, built: Built) -> str:
    search = built.search
    lines = [
        f"# Construction of the temporal plan graph: {name}",
        "",
        f"{date_line()}, {machine_line()}; {load}; seed {seed}. Made by "
        "`python -m benchmarks.tpg_construction`.",
        "",
        f"{built.nodes} nodes. The whole construction and the proof "
        f"of its guarantee took **{built.wall_s:.2f} s** by the wall clock and "
        f"{built.cpu_s:.2f} s of the processor (two robots' searches run at once), for "
        f"{built.edges} edges. Largest memory of the process, planning included: "
        f"**{built.memory_mib} MiB**.",
        "",
        f"Processor seconds on one core, the best of {REPEATS}; the search for an order and shortcuts are not in them.",
        "",
        "| edges found | reduced | bodies [s] | search [s] | whole [s] |",
        "|---:|---:|---:|---:|---:|",
        f"| {search.found} | {search.reduced} | {search.bodies_s:.2f} | {search.search_s:.2f} "
        f"| {search.total_s:.2f} |",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
