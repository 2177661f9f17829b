"""Transits of arms among random boxes, beside those of roboplan.

    python -m benchmarks.transits [--queries 20] [--scenes 5]

Plans the same queries with both planners in one process, without clearance and within the limits of
the joints. What is measured has been planned once before, so that all is compiled and loaded.
CPU time of the thread that plans. Roboplan looks at configurations only, a step apart; its paths
are put to our checker, which proves motions as a whole. Writes benchmarks/results/transits.md.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.machine import date_line, load_line, machine_line
from benchmarks.transits.peer import Peer
from benchmarks.transits.scenes import BOXES, ROBOTS_MEASURED, BoxScene, make_scene
from planning.motion.speed import L1Speed
from planning.motion.transit import RrtConnect
from planning.transforms import Array

RESULTS = Path(__file__).parents[1] / "results"
STEPS = (0.05, 0.02)
"""Steps of the peer [rad]: its own choice, and one at which nearly all of its paths are free."""

OURS = "ours"
Planner = Callable[[int], Array | None]
"""Plans the k-th query of a scene."""


@dataclass(frozen=True)
class Answer:
    """What a planner made of a query.

    Attributes:
        cpu_ms: CPU time.
        far, sum: length of the path as L2 and as L1 joint distance, NaN without one [rad].
        free: whether our checker proves it free, but for 3 mm.
    """

    cpu_ms: float
    far: float
    sum: float
    free: bool

    @property
    def found(self) -> bool:
        """Whether there is a path."""
        return not math.isnan(self.far)


def planners(scene: BoxScene) -> dict[str, Planner]:
    """Return the planners for the queries of a scene, by their names."""
    own = RrtConnect(scene.model.lower, scene.model.upper, L1Speed())
    queries = scene.queries
    out: dict[str, Planner] = {
        OURS: lambda k: own.plan(scene.checker, queries[k].start, queries[k].goal, k)
    }
    for step in STEPS:
        peer = Peer(scene, step)
        out[f"roboplan, {step} rad"] = lambda k, peer=peer: peer.plan(queries[k], k)
    return out


def measure(scene: BoxScene, planner: Planner, query: int) -> Answer:
    """Plan a query and measure that, a second time where the first one found a path."""
    for _ in range(2):
        begin = time.thread_time()
        path = planner(query)
        cpu_ms = 1e3 * (time.thread_time() - begin)
        if path is None:
            return Answer(cpu_ms, math.nan, math.nan, False)
    steps = np.diff(path, axis=0)
    return Answer(
        cpu_ms,
        float(np.linalg.norm(steps, axis=1).sum()),
        float(np.abs(steps).sum()),
        all(scene.lenient.motion_free(a, b) for a, b in pairwise(path)),
    )


def rows(answers: dict[str, list[Answer]], robot: str, boxes: int) -> list[str]:
    """Return the lines of a table: one for each planner, over what any of them solved.

    Lengths are means over the queries that all of them solved.
    """
    each = list(zip(*answers.values(), strict=True))
    solvable = [any(a.found and a.free for a in query) for query in each]
    shared = [all(a.found for a in query) for query in each]
    out = []
    for name, all_own in answers.items():
        own = [a for a, ok in zip(all_own, solvable, strict=True) if ok]
        both = [a for a, ok in zip(all_own, shared, strict=True) if ok]
        cpu = np.array([a.cpu_ms for a in own])
        out.append(
            f"| {robot} | {boxes} | {name} | {len(own)} | {sum(not a.found for a in own)} "
            f"| {sum(a.found and not a.free for a in own)} | {np.median(cpu):.1f} "
            f"| {np.percentile(cpu, 95):.1f} | {cpu.max():.0f} "
            f"| {np.mean([a.far for a in both]):.2f} | {np.mean([a.sum for a in both]):.2f} |"
        )
    return out


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure all robots and numbers of boxes, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--queries", type=int, default=20, help="queries of a scene")
    parser.add_argument("--scenes", type=int, default=5, help="scenes of a kind")
    options = parser.parse_args(arguments)
    table, loads = [], []
    for robot in ROBOTS_MEASURED:
        for boxes in BOXES:
            before = os.getloadavg()[0]
            answers: dict[str, list[Answer]] = {}
            for seed in range(options.scenes):
                scene = make_scene(robot, boxes, options.queries, seed)
                for name, planner in planners(scene).items():
                    found = answers.setdefault(name, [])
                    found += [
                        measure(scene, planner, k) for k in range(options.queries)
                    ]
            loads.append((before, os.getloadavg()[0]))
            table += rows(answers, robot, boxes)
            print(*table[-len(answers) :], sep="\n", flush=True)  # noqa: T201
    asked = options.queries * options.scenes
    text = f"""# Transits among random boxes

`python -m benchmarks.transits`, {date_line()}, {machine_line()}, {load_line(loads)}.

{options.scenes} scenes of each kind with {options.queries} queries each, none of which a straight motion solves. The UR10 is
our UR5e, half as large again. Of the {asked} queries those count that at least one planner solved with
a path that our checker proves free, or would if the boxes were 3 mm smaller on every side: our round
links are polyhedra around them, and shortened paths graze boxes. The ends of the others are shut in,
as far as is known. *Failed* are the queries of these without a path; where there are paths within
those 3 mm only, we fail. *Not free* are those whose path is not proved so. Ours are made of parts of
motions that were proved, which the checker, exact to 0.2 mm, may not prove again on their own.

Times are CPU milliseconds of a query, of one that failed as well; lengths are means over the queries
that all three solved, as L2 and L1 joint distance. We shorten the L1 distance, as the speed model of
the plans asks for; roboplan (RRT-Connect and its shortcutting, 100 tries) the L2 distance. Its steps
are the distances at which it looks at configurations: 0.05 rad is its own choice.

| robot | boxes | planner | queries | failed | not free | median [ms] | p95 [ms] | max [ms] | length L2 [rad] | length L1 [rad] |
|---|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|
"""
    RESULTS.joinpath("transits.md").write_text(text + "\n".join(table) + "\n")


if __name__ == "__main__":
    main()
