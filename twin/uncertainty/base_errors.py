"""Bounds of the pose errors of robot bases, from calibration, and of flanges in skills, from force control."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from planning.bounds import LARGEST_ERROR
from planning.cell.workcell import PoseError
from twin.document.section import Section


class PoseErrorSection(Section):
    """How far a frame may be from where it is taken to be.

    Attributes:
        m: its origin is anywhere within.
        rad: it is turned about any axis by up to this.
    """

    m: Annotated[float, Field(ge=0, le=LARGEST_ERROR)] = 0.0
    rad: Annotated[float, Field(ge=0, le=LARGEST_ERROR)] = 0.0

    @property
    def planned(self) -> PoseError:
        """The same bounds as planning takes them."""
        return PoseError(self.m, self.rad)
