"""Poses of a scenario file as transforms."""

from __future__ import annotations

import numpy as np

from planning.transforms import Transform, from_quat_wxyz, from_rpy
from twin.scenario.sections.base import PoseSection


def build_transform(pose: PoseSection) -> Transform:
    """Return a pose of the scenario as a (4, 4) transform."""
    if pose.quat_wxyz is not None:
        return from_quat_wxyz(pose.xyz_m, pose.quat_wxyz)
    rpy = np.deg2rad(pose.rpy_deg or (0.0, 0.0, 0.0))
    return from_rpy(pose.xyz_m, rpy.tolist())
