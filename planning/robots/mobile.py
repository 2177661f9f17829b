"""Robots that drive: the first joints of their chain move a platform over the ground."""

from __future__ import annotations

import numpy as np

from planning.cell.robot_model import RobotModel


def is_mobile(model: RobotModel) -> bool:
    """Tell whether a robot drives: its first joints slide along x and y and turn about z."""
    axis, prismatic = model.chain.axis[:3], model.chain.prismatic[:3]
    return (
        model.dof > 3
        and tuple(prismatic) == (True, True, False)
        and bool(np.allclose(axis, np.eye(3)))
        and bool(np.allclose(model.chain.placement[:3], np.eye(4)))
    )
