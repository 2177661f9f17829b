"""Bases that are not where the cell has them, drawn for a replication: what calibration leaves."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from planning.cell.workcell import PlacedRobot, PoseError
from planning.transforms import Array, Transform
from twin.scenario.document.section import Section
from twin.uncertainty.draws import uniforms


class PoseErrorSection(Section):
    """How far a frame may be from where it is taken to be.

    Attributes:
        m: its origin is anywhere within.
        rad: it is turned about any axis by up to this.
    """

    m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    rad: Annotated[float, Field(ge=0, le=0.1)] = 0.0

    @property
    def planned(self) -> PoseError:
        """The same as planning has it."""
        return PoseError(self.m, self.rad)


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
    names, kinds = [robot.name] * 6, ["base"] * 6
    u = uniforms(seed, [replication], names, 0, kinds, "pose error", range(6))[:, 0]
    out = np.array(robot.base, dtype=np.float64)
    turned = Rotation.from_rotvec(_in_ball(u[3:], error.rad))
    out[:3, :3] = turned.as_matrix() @ robot.base[:3, :3]
    out[:3, 3] += _in_ball(u[:3], error.m)
    return out


def _in_ball(u: Array, radius: float) -> Array:
    """Return a point of a ball, uniform for three uniforms, shape (3,)."""
    up, around = 2.0 * u[0] - 1.0, 2.0 * math.pi * u[1]
    flat = math.sqrt(1.0 - up * up)
    way = np.array([flat * math.cos(around), flat * math.sin(around), up])
    return np.asarray(radius * np.cbrt(u[2]) * way)
