"""Small construction sites: boxes to place, and a ring of mobile manipulators around them."""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256

import numpy as np

from planning.cell.workcell import PlacedRobot, Workcell
from planning.construction.planner import plan_construction
from planning.construction.problem.models import ModelPart
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.problem.site import (
    Spiral,
    SupplyLayout,
    build_problem,
    ground_fixture,
    part_objects,
)
from planning.robots.registry import robot_model
from planning.transforms import identity, readonly, translation


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
        team.append(PlacedRobot(f"robot{k + 1}", model, identity(), readonly(home)))
    cell = Workcell(
        tuple(team), (ground_fixture(),), part_objects(parts, supply or Spiral())
    )
    return replace(build_problem(cell, parts), seed=seed)


def toy_part(name: str, size: tuple[float, ...], at: tuple[float, ...]) -> ModelPart:
    return ModelPart(name, readonly(size), 1.0, readonly(translation(*at)))


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
