"""Forecasts of the end of a run that drivers execute, made beside it from what has been executed."""

from __future__ import annotations

import numpy as np

from twin.engine.execution_model import ExecutionModel
from twin.follow.forecast import Forecast, Forecaster
from twin.follow.state import FollowedRun
from twin.page.panel import NodesSoFar

_SAMPLES = 100


class Forecasts:
    """Forecasts a run of which the plan may become another one.

    Args:
        model: how long what drivers do takes, as far as is known.
    """

    def __init__(self, model: ExecutionModel) -> None:
        self._model = model
        self._forecaster: Forecaster | None = None
        self._of: object = None

    def forecast(self, so_far: NodesSoFar) -> Forecast:
        """Return the forecast of the end of a run."""
        tpg = so_far.tpg
        if self._forecaster is None or self._of is not tpg:
            self._forecaster = Forecaster(tpg, self._model, samples=_SAMPLES)
            self._of = tpg
        run = FollowedRun(tpg)
        run.now_ns = so_far.now_ns
        for robot, start, end in zip(
            run.robots, so_far.start_ns, so_far.end_ns, strict=True
        ):
            robot.start_ns[:], robot.end_ns[:] = start, end
            robot.completed = int(np.argmin(np.append(robot.end_ns, -1) >= 0))
        return self._forecaster.forecast(run)
