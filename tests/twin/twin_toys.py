"""Small made-up robots, cells and temporal plan graphs for the tests of the twin."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from planning.cell.robot_model import KinematicChain, RobotModel
from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Fixture, PlacedRobot, Workcell
from planning.tasks.task import Task, TaskKind
from planning.transforms import Array, translation
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)

_SHAPE = box_shape("box", (0.016, 0.032, 0.0096))
_TABLE = box_shape("table", (2.0, 2.0, 0.1))


def toy_model(dof: int, urdf: Path = Path("toy.urdf")) -> RobotModel:
    """A chain of revolute joints about z, 0.1 m apart."""
    return RobotModel(
        name="toy",
        urdf=urdf,
        package_dirs=(),
        joint_names=tuple(f"joint_{j}" for j in range(dof)),
        lower=np.full(dof, -3.0),
        upper=np.full(dof, 3.0),
        velocity=np.full(dof, 1000.0),  # no draw is too short for that
        chain=KinematicChain(
            placement=np.stack([translation(0.1, 0, 0)] * dof),
            axis=np.tile([0.0, 0.0, 1.0], (dof, 1)),
            prismatic=np.zeros(dof, dtype=bool),
        ),
        flange=translation(0.1, 0, 0),
        frames={"tool": translation(0, 0, 0.05)},
        parts=(),
        never_collide=frozenset(),
        home=np.zeros(dof),
    )


def toy_cell(
    dofs: Sequence[int], objects: int = 1, urdf: Path = Path("toy.urdf")
) -> Workcell:
    """Robots robot_0, robot_1, ... 1 m apart, bricks brick_0, ... and a table."""
    robots = tuple(
        PlacedRobot(
            f"robot_{k}", toy_model(dof, urdf), translation(k, 0, 0), np.zeros(dof)
        )
        for k, dof in enumerate(dofs)
    )
    bricks = tuple(
        CellObject(
            f"brick_{k}",
            "2x4",
            _SHAPE,
            translation(0.1 * k, 0.5, 0),
        )
        for k in range(objects)
    )
    table = Fixture("table", _TABLE, translation(0, 0, -0.1))
    return Workcell(robots, (table,), bricks)


def random_tpg(
    seed: int,
    *,
    dofs: Sequence[int] = (2, 3),
    tasks: int = 6,
    nodes_per_transit: int = 4,
    edges: int = 8,
    idle_robots: int = 0,
) -> TemporalPlanGraph:
    """Random tasks in a row, transit and skill in turn; random edges along the planned order.

    A few nodes take no time. The first skill of the plan picks brick_0, the second puts it down.
    """
    rng = np.random.default_rng(seed)
    cell = toy_cell([*dofs, *[2] * idle_robots])
    tasks = max(tasks, len(dofs))
    owner = rng.integers(len(dofs), size=tasks)
    owner[: len(dofs)] = np.arange(len(dofs))
    task_list, order = [], []
    parts: list[list[_Node]] = [[] for _ in dofs]
    clock = 0.0
    for m in range(tasks):
        k = int(owner[m])
        skill = m % 2 == 1
        kind = (
            TaskKind.SKILLS[int(rng.integers(len(TaskKind.SKILLS)))]
            if skill
            else TaskKind.TRANSIT
        )
        waypoints = int(rng.integers(1, 4)) if skill else nodes_per_transit
        path = rng.uniform(-1, 1, (waypoints, dofs[k]))
        task_list.append(
            Task(m, cell.robots[k].name, kind, m // 2 + 1, f"task {m}", path)
        )
        for block in [path] if skill else [row[None] for row in path]:
            duration = 0.0 if rng.random() < 0.1 else float(rng.uniform(0.01, 2.0))
            order.append((k, len(parts[k])))
            parts[k].append(_Node(block, m, skill, duration, clock))
            clock += duration
    chains = tuple(
        _chain(cell.robots[k], nodes) for k, nodes in enumerate(parts) if nodes
    )
    found = set()
    for _ in range(edges if len(order) > 1 else 0):
        a, b = sorted(rng.choice(len(order), 2, replace=False).tolist())
        if order[a][0] != order[b][0]:
            found.add((*order[a], *order[b]))
    rows = np.array(sorted(found), dtype=np.int64).reshape(-1, 4)
    skills = [(k, n) for k, n in order if chains[k].skill[n]]
    handlings: tuple[NodeHandling, ...] = ()
    if len(skills) >= 2:
        (k, n), (j, m) = skills[0], skills[1]
        handlings = (
            NodeHandling(
                "brick_0", k, n, 1, cell.robots[k].name, translation(0, 0, 0.1)
            ),
            NodeHandling("brick_0", j, m, 0, None, translation(0.4, 0.4, 0)),
        )
    return TemporalPlanGraph(
        cell=cell,
        tasks=tuple(task_list),
        chains=chains,
        edges=rows,
        cause=np.ones(len(rows), dtype=np.uint8),
        handlings=handlings,
        allowed=(),
    )


class _Node(NamedTuple):
    path: Array
    task: int
    skill: bool
    duration: float
    planned_start: float


def _chain(robot: PlacedRobot, nodes: list[_Node]) -> NodeChain:
    counts = [len(node.path) for node in nodes]
    return NodeChain(
        robot.name,
        robot.home,
        np.vstack([node.path for node in nodes]),
        np.concatenate([np.arange(1, c + 1) / c for c in counts]),
        np.cumsum([0, *counts]),
        np.array([node.task for node in nodes]),
        np.array([node.skill for node in nodes]),
        np.array([node.duration for node in nodes]),
        np.array([node.planned_start for node in nodes]),
    )


def two_robot_tpg(edges: Sequence[tuple[int, int, int, int]]) -> TemporalPlanGraph:
    """Two robots of three pose nodes of 1 s each, with the edges asked for."""
    cell = toy_cell((1, 1))
    tasks = tuple(
        Task(k, f"robot_{k}", TaskKind.TRANSIT, 1, f"transit {k}", np.full((1, 1), 0.3))
        for k in range(2)
    )
    chains = tuple(
        _chain(
            cell.robots[k],
            [
                _Node(np.full((1, 1), 0.1 * (n + 1)), k, False, 1.0, 3.0 * k + n)
                for n in range(3)
            ],
        )
        for k in range(2)
    )
    rows = np.array(sorted(edges), dtype=np.int64).reshape(-1, 4)
    return TemporalPlanGraph(
        cell, tasks, chains, rows, np.ones(len(rows), dtype=np.uint8), (), ()
    )


def with_cut_skill(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    """Return a graph whose first skill node, in the first chain that has one, is cut in two."""
    place = next(k for k, chain in enumerate(tpg.chains) if chain.skill.any())
    chain = tpg.chains[place]
    node = int(np.flatnonzero(chain.skill)[0])
    at = int(chain.first[node + 1])
    cut = replace(
        chain,
        waypoints=np.insert(chain.waypoints, at, chain.waypoints[at - 1], axis=0),
        fraction=np.insert(chain.fraction, at, 1.0),
        first=np.insert(chain.first, node + 1, at)
        + (np.arange(len(chain) + 2) > node + 1),
        task=np.insert(chain.task, node, chain.task[node]),
        skill=np.insert(chain.skill, node, True),
        duration=np.insert(chain.duration, node, 0.7),
        planned_start=np.insert(chain.planned_start, node, chain.planned_start[node]),
    )
    chains = (*tpg.chains[:place], cut, *tpg.chains[place + 1 :])
    return replace(tpg, chains=chains)
