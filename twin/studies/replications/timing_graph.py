"""Timing graph: a plan without robot models, shapes, poses and paths.

It can be simulated, but not displayed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.cell.workcell import CellObject, Workcell
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.uncertainty.least_durations import least_seconds

_NO_SHAPE = Shape((), ())


def timing_graph(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    """Return a plan without robot models, shapes, poses and paths.

    Times from paths are kept: the least duration of each node, and its number of waypoints, which
        identifies nodes with tool actuation.
    """
    models = {robot.name: robot.model for robot in tpg.cell.robots}
    return replace(
        tpg,
        cell=replace(
            bare_cell({item.name: item.kind for item in tpg.cell.objects}),
            machines=tpg.cell.machines,
        ),
        tasks=tuple(replace(t, path=np.zeros((0, 0)), handlings=()) for t in tpg.tasks),
        chains=tuple(
            _bare_chain(chain, models.get(chain.robot)) for chain in tpg.chains
        ),
        handlings=(),
        allowed=(),
    )


def bare_cell(kinds: dict[str, str]) -> Workcell:
    """Return a cell without robots, whose objects have only name and kind."""
    items = tuple(
        CellObject(name, kind, _NO_SHAPE, np.eye(4)) for name, kind in kinds.items()
    )
    return Workcell((), (), items)


def _bare_chain(chain: NodeChain, model: RobotModel | None) -> NodeChain:
    return replace(
        chain,
        least=least_seconds(chain, model),
        start=np.zeros(0),
        waypoints=np.zeros((0, 0)),
        fraction=np.zeros(0),
    )
