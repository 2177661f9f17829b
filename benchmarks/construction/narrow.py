"""Keyframes in narrow places: one program over both switches against inverse kinematics with rejection.

``python -m benchmarks.construction.narrow --cases 200 --out benchmarks/results/keyframes.md``: parts that
lie between pillars, under low ceilings and in shelves, for two kinds of mobile robots, are brought to
another such place. For each way to find keyframes: how often it finds some, processor seconds until the
first, how often a path leads over them, and how long it takes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.construction.joint_keyframes import JointKeyframes
from planning.cell.shape import box_shape
from planning.cell.workcell import Fixture, PlacedRobot, Workcell
from planning.construction.keyframes import EarliestTimes, Keyframes, KeyframeSolver
from planning.construction.problem.models import ModelPart
from planning.construction.problem.problem import (
    ConstructionProblem,
    SubproblemSettings,
)
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.problem.site import (
    Spiral,
    build_problem,
    ground_fixture,
    part_objects,
)
from planning.construction.step_scenes import StepScenes
from planning.construction.subproblem import LegPlanner, Stopwatch
from planning.construction.world.fixed_world import nothing_built
from planning.robots.registry import robot_model
from planning.steps.skill import gripped
from planning.transforms import (
    Array,
    Transform,
    identity,
    readonly,
    rotation,
    translation,
)

PLACES = ("shelf", "pillars", "ceiling")
MODELS = ("mobile-manipulator", "mobile-iiwa14")


def place(
    kind: str, name: str, at: Transform, size: Array, rng: np.random.Generator
) -> tuple[list[Fixture], float]:
    """Return what makes a place narrow, around a part on the ground there, and how high that lies."""

    def box(tag: str, edges: tuple[float, ...], xyz: tuple[float, ...]) -> Fixture:
        own = f"{name}_{tag}"
        return Fixture(own, box_shape(own, edges), readonly(at @ translation(*xyz)))

    x, y, z = size.tolist()
    if kind == "pillars":
        room = float(rng.uniform(0.06, 0.3))
        tall = float(rng.uniform(0.5, 1.2))
        away = x / 2 + room + 0.1
        edges = (0.2, float(rng.uniform(0.2, 0.6)), tall)
        return [
            box("left", edges, (-away, 0.0, tall / 2)),
            box("right", edges, (away, 0.0, tall / 2)),
        ], 0.0
    if kind == "ceiling":
        under = z + float(rng.uniform(0.22, 0.5))
        edges = (x + 0.6, y + 0.6, 0.05)
        return [box("slab", edges, (0.0, 0.0, under + 0.025))], 0.0
    board = float(rng.uniform(0.3, 0.7))
    room, side = (
        z + float(rng.uniform(0.2, 0.45)),
        x / 2 + float(rng.uniform(0.05, 0.2)),
    )
    deep = y + float(rng.uniform(0.05, 0.25))
    tall = board + room + 0.03
    return [
        box("board", (2 * side, deep, 0.03), (0.0, 0.0, board - 0.015)),
        box("top", (2 * side, deep, 0.03), (0.0, 0.0, board + room + 0.015)),
        box("back", (2 * side, 0.02, tall), (0.0, deep / 2 + 0.012, tall / 2)),
        box("left", (0.02, deep, tall), (-side - 0.012, 0.0, tall / 2)),
        box("right", (0.02, deep, tall), (side + 0.012, 0.0, tall / 2)),
    ], board


def narrow_problem(number: int) -> tuple[ConstructionProblem, str]:
    """Return a case: one robot, one part, a narrow place at either end, drawn by its number."""
    rng = np.random.default_rng([7, number])
    size = rng.uniform((0.25, 0.12, 0.08), (0.45, 0.25, 0.16))
    kinds = [PLACES[int(rng.integers(3))], PLACES[number % 3]]
    fixtures, poses = [ground_fixture()], []
    for kind, name, x in zip(kinds, ("from", "to"), (-1.6, 1.6), strict=True):
        turned = rotation("z", float(rng.uniform(-np.pi, np.pi)))
        at = translation(x, float(rng.uniform(-0.5, 0.5)), 0.0) @ turned
        made, height = place(kind, name, at, size, rng)
        fixtures += made
        poses.append(readonly(at @ translation(0.0, 0.0, height + size[2] / 2)))
    faces = ("+z", "-y", "+x", "-x")
    part = ModelPart("part", readonly(size), 2.0, poses[1], faces)
    model = robot_model(MODELS[number % 2])
    home = np.array(model.home)
    home[1] = -4.0
    cell = Workcell(
        (PlacedRobot("robot", model, identity(), readonly(home)),),
        tuple(fixtures),
        part_objects((part,), Spiral(), {"part": poses[0]}),
    )
    # Into shelves from their open side, elsewhere from above.
    inwards = poses[1][:3, 1] if kinds[1] == "shelf" else np.array([0.0, 0.0, -1.0])
    approach = 0.25 if "shelf" in kinds else 0.04
    ways = {"part": inwards}
    return build_problem(cell, (part,), insertions=ways, approach=approach), kinds[1]


@dataclass
class Outcome:
    """What one way to find keyframes came to in a case.

    Attributes:
        found: whether it found keyframes.
        cpu: processor seconds until then, or until it gave up.
        arrival: when the part is in its place over the path that was found, infinite for none [s].
    """

    found: bool
    cpu: float
    arrival: float


WAYS = ("drawn, rejected", "one program")


def solved(problem: ConstructionProblem, bounds: ReachBounds, way: str) -> Outcome:
    """Return what one way comes to."""
    building, part, settings = (
        nothing_built(problem),
        problem.parts[0],
        SubproblemSettings(),
    )
    scenes = StepScenes(problem, building.world, part, ("robot",))
    rng = np.random.default_rng(3)
    kind = JointKeyframes if way == WAYS[1] else KeyframeSolver
    solver = kind(scenes, bounds, EarliestTimes(0.0, 0.0), settings.keyframes, rng)
    options = solver.alone("robot")
    begin = process_time()
    found = next(options, None)
    outcome = Outcome(found is not None, process_time() - begin, np.inf)
    if found is not None:
        outcome.arrival = _arrival(problem, found, settings)
    return outcome


def _arrival(
    problem: ConstructionProblem, found: Keyframes, settings: SubproblemSettings
) -> float:
    """Return when the part is in its place over a path by the keyframes, infinity for no path [s]."""
    building, part = nothing_built(problem), problem.parts[0]
    legs = LegPlanner(settings.rrt, np.random.default_rng(5), Stopwatch())
    leg = legs.leg(building, "robot", found.picks)
    if leg is None:
        return np.inf
    touching = gripped("robot", part.name) | problem.start_contacts[part.name]
    pose = problem.held_in_flange("robot", part, *found.holds[0])
    building = leg.building.worked(
        leg.keyframe.motion, "pick", part.name, leg.start, "robot", pose, touching
    )
    allowed = gripped("robot", part.name)
    leg = legs.leg(building, "robot", found.places, allowed=allowed)
    return np.inf if leg is None else leg.start + leg.keyframe.motion.seconds


Row = tuple[str, tuple[Outcome, ...]]


def compared(count: int) -> Iterator[Row]:
    """Yield the place of each case, and what each way comes to."""
    for number in range(count):
        problem, kind = narrow_problem(number)
        bounds = ReachBounds(problem)
        bounds.alone(problem.parts[0])  # shared by all attempts at a part
        yield kind, tuple(solved(problem, bounds, way) for way in WAYS)


def report(rows: list[Row]) -> str:
    """Return the table."""
    lines = [
        "| place | cases | way | found | found by it alone | CPU s, mean | CPU s, worst | path | arrival where all have one, s |",
        "|---|---:|---|---:|---:|---:|---:|---:|---:|",
    ]
    for kind in (*PLACES, "all"):
        own = [outcomes for place, outcomes in rows if kind in (place, "all")]
        each = [row for row in own if all(np.isfinite(o.arrival) for o in row)]
        for k, way in enumerate(WAYS):
            mine = [row[k] for row in own]
            alone = sum(row[k].found and sum(o.found for o in row) == 1 for row in own)
            cpu = [outcome.cpu for outcome in mine]
            arrival = np.mean([row[k].arrival for row in each]) if each else np.nan
            lines.append(
                f"| {kind} | {len(own)} | {way} | {sum(o.found for o in mine)} | {alone} |"
                f" {np.mean(cpu):.3f} | {max(cpu):.2f} |"
                f" {sum(np.isfinite(o.arrival) for o in mine)} | {arrival:.1f} |"
            )
    return "\n".join(lines)


def main() -> None:
    """Compare, and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--out", type=Path, default=None)
    args = parser.parse_args()
    for way in WAYS:
        solved(*_warm(), way)  # compiles
    text = report(list(compared(args.cases)))
    sys.stdout.write(text + "\n")
    if args.out is not None:
        args.out.write_text(text + "\n")


def _warm() -> tuple[ConstructionProblem, ReachBounds]:
    problem, _ = narrow_problem(1)
    return problem, ReachBounds(problem)


if __name__ == "__main__":
    main()
