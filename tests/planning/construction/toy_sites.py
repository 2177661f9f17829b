"""Small construction sites: boxes to place, and a ring of mobile manipulators around them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from hashlib import sha256

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import Fixture, PlacedRobot, Workcell
from planning.construction.planner import ConstructionPlan, plan_construction
from planning.construction.problem.models import ModelPart, tower
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.problem.site import (
    build_problem,
    ground_fixture,
    part_objects,
)
from planning.construction.problem.supply_layout import Spiral, SupplyLayout
from planning.robots.registry import robot_model
from planning.transforms import identity, read_only_copy, translation


def toy_problem(
    parts: tuple[ModelPart, ...],
    robots: int,
    seed: int = 0,
    supply: SupplyLayout | None = None,
) -> ConstructionProblem:
    model = robot_model("mobile-manipulator")
    team = []
    for k in range(robots):
        at = 2.0 * np.pi * k / robots
        home = np.array(model.home)
        home[:3] = 5.0 * np.cos(at), 5.0 * np.sin(at), at
        team.append(
            PlacedRobot(f"robot{k + 1}", model, identity(), read_only_copy(home))
        )
    cell = Workcell(
        tuple(team), (ground_fixture(),), part_objects(parts, supply or Spiral())
    )
    return replace(build_problem(cell, parts), seed=seed)


def toy_part(name: str, size: tuple[float, ...], at: tuple[float, ...]) -> ModelPart:
    return ModelPart(name, read_only_copy(size), 1.0, read_only_copy(translation(*at)))


CHEST = (
    toy_part("post1", (0.12, 0.3, 0.4), (-0.4, 0.0, 0.2)),
    toy_part("post2", (0.12, 0.3, 0.4), (0.4, 0.0, 0.2)),
    toy_part("chest", (0.4, 0.25, 0.2), (0.0, 0.0, 0.1)),
    toy_part("slab", (1.0, 0.3, 0.1), (0.0, 0.0, 0.45)),
)
"""A chest under a slab on two posts: gripped from above, it must come before the slab."""


def slab_digest() -> str:
    """Plan a slab on two posts, and hash everything about the plan."""
    plan = plan_construction(toy_problem(CHEST[:2] + CHEST[3:], 2))
    digest = sha256()
    for _, line in sorted(plan.building.world.robots.items()):
        digest.update(line.time.tobytes() + line.path.tobytes())
    for work in plan.building.work:
        digest.update(repr((work.robot, work.kind, work.object)).encode())
        digest.update(work.handlings[0].pose.tobytes())
    return digest.hexdigest()


@cache
def tower_plan() -> ConstructionPlan:
    """Three robots stack beams."""
    return plan_construction(toy_problem(tower(4), 3))


@cache
def handover_plan(approach: float = 0.05) -> ConstructionPlan:
    """An arm on wheels reaches the supply, a crane the place; where they meet is up to them."""
    arm, crane = robot_model("mobile-iiwa14"), robot_model("tower-crane")
    at = np.array(arm.home)
    at[:3] = 3.5, 0.0, np.pi
    # What an arm can reach is below this, what the crane reaches is above the floor.
    height = 1.152
    size = read_only_copy((0.7, 0.2, height))
    plinth = Fixture(
        "plinth",
        box_shape("plinth", size),
        read_only_copy(translation(0.0, 0.0, 0.5 * height)),
    )
    beam = toy_part("beam", (0.7, 0.2, 0.096), (0.0, 0.0, height + 0.048))
    cell = Workcell(
        (
            PlacedRobot(
                "crane",
                crane,
                read_only_copy(translation(-1.9, 0.0, 0.0)),
                read_only_copy((1.57, 2.2, 0.0, 0.0)),
            ),
            PlacedRobot("arm", arm, identity(), read_only_copy(at)),
        ),
        (ground_fixture(), plinth),
        part_objects((beam,), Spiral(2.4, turn=0.5)),
    )
    problem = build_problem(
        cell, (beam,), offsets=(0.0, 0.25, -0.25), approach=approach
    )
    problem = replace(problem, seed=1)
    return plan_construction(problem)
