"""What all sections of a scenario file have in common: strictness, names, vectors and poses."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$", max_length=64)]
"""Names become parts of file names and of paths in a recording."""

Vector3 = Annotated[tuple[float, ...], Field(min_length=3, max_length=3)]
Vector4 = Annotated[tuple[float, ...], Field(min_length=4, max_length=4)]
Size3 = Annotated[
    tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=3, max_length=3)
]


class Section(BaseModel):
    """A mapping of the file: no unknown keys, no silent conversion, no change afterwards."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False
    )


class PoseSection(Section):
    """A pose: where, and how it is turned (upright when not said).

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
