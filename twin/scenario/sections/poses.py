"""Vectors and poses in a scenario file, and poses as transforms."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from planning.transforms import Transform, from_quat_wxyz, from_rpy
from twin.scenario.document.section import Section, Three

# No cell reaches ten kilometres: what is beyond is a slip of the pen or of the unit.
Coordinate = Annotated[float, Field(ge=-1e4, le=1e4)]
Vector3 = Three[Coordinate]
Vector4 = Annotated[tuple[Coordinate, ...], Field(min_length=4, max_length=4)]
# Bodies thinner than a tenth of a millimetre have no volume that could be reckoned with.
Size3 = Three[Annotated[float, Field(ge=1e-4, le=1000)]]
Colour = Three[Annotated[int, Field(ge=0, le=255)]]
Mass = Annotated[float, Field(ge=0, le=1e6)]
Configuration = Annotated[tuple[Coordinate, ...], Field(min_length=1, max_length=100)]


class PoseSection(Section):
    """A pose: position, and orientation (upright by default).

    Attributes:
        xyz_m: position [m].
        rpy_deg: roll, pitch, yaw with R = Rz(yaw) Ry(pitch) Rx(roll) [deg].
        quat_wxyz: the same as a quaternion (w, x, y, z).
    """

    xyz_m: Vector3
    rpy_deg: Vector3 | None = None
    quat_wxyz: Vector4 | None = None

    @model_validator(mode="after")
    def _one_rotation(self) -> PoseSection:
        if self.rpy_deg is not None and self.quat_wxyz is not None:
            raise ValueError("give rpy_deg or quat_wxyz, not both")
        if self.quat_wxyz is not None and not sum(v * v for v in self.quat_wxyz) > 1e-9:
            raise ValueError("quat_wxyz must not be zero")
        return self


def build_transform(pose: PoseSection) -> Transform:
    """Return a pose of the scenario as a (4, 4) transform."""
    if pose.quat_wxyz is not None:
        return from_quat_wxyz(pose.xyz_m, pose.quat_wxyz)
    rpy = np.deg2rad(pose.rpy_deg or (0.0, 0.0, 0.0))
    return from_rpy(pose.xyz_m, rpy.tolist())
