"""Random pose errors in a replication: of robot bases (calibration), and of paths (force control)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from planning.cell.workcell import PlacedRobot, PoseError
from planning.transforms import Array, Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.uncertainty.draws import uniforms


def drawn_base(
    robot: PlacedRobot, error: PoseError, *, seed: int, replication: int
) -> Transform:
    """Return where the base of a robot is in a replication, shape (4, 4).

    Its origin is drawn uniformly from the ball around where it should be, its turn, as axis times
    angle, uniformly from the ball of turns.

    Args:
        robot: which; its name is part of the draw's.
        error: how far it may be off.
        seed: of the study.
        replication: its number.
    """
    draw = _Draw(robot.name, 0, "base", seed, replication)
    displacement, turn = np.split(_drawn_error(draw, error), 2)
    out = np.array(robot.base, dtype=np.float64)
    out[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ robot.base[:3, :3]
    out[:3, 3] += displacement
    return out


def drawn_deviations(
    tpg: TemporalPlanGraph,
    deviations: Mapping[str, PoseError],
    *,
    seed: int,
    replication: int,
) -> dict[tuple[str, int], Array]:
    """Return the flange deviation in the middle of each skill node, by robot and node.

    Each is a displacement and a rotation vector, shape (6,) [m, rad], drawn like base errors.

    Args:
        tpg: the plan.
        deviations: by skill, how far it may be off.
        seed: of the study.
        replication: its number.
    """
    kinds = {task.index: task.kind for task in tpg.tasks}
    out = {}
    for chain in tpg.chains:
        for node in np.flatnonzero(chain.skill).tolist():
            task = int(chain.task[node])
            if error := deviations.get(kinds[task]):
                draw = _Draw(chain.robot, task, kinds[task], seed, replication)
                out[chain.robot, node] = _drawn_error(draw, error)
    return out


class _Draw(NamedTuple):
    robot: str
    task: int
    kind: str
    seed: int
    replication: int


def _drawn_error(of: _Draw, error: PoseError) -> Array:
    """Return a displacement and a rotation vector, each uniform in its ball, shape (6,)."""
    names, kinds = [of.robot] * 6, [of.kind] * 6
    counted = [of.replication], names, of.task, kinds, "pose error", range(6)
    u = uniforms(of.seed, *counted)[:, 0]
    return np.concatenate([_in_ball(u[:3], error.m), _in_ball(u[3:], error.rad)])


def _in_ball(u: Array, radius: float) -> Array:
    """Return a uniform point of a ball from three uniforms, shape (3,)."""
    up, around = 2.0 * u[0] - 1.0, 2.0 * math.pi * u[1]
    flat = math.sqrt(1.0 - up * up)
    displacement = np.array([flat * math.cos(around), flat * math.sin(around), up])
    return np.asarray(radius * np.cbrt(u[2]) * displacement)
