"""Scenario section of assembly kind ``goals``: a sequence of robot motions to goals."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from twin.document.section import Name, Section, Several
from twin.scenario.sections.kind import AssemblySection
from twin.scenario.sections.shapes import Configuration, PoseSection


class MoveSection(Section):
    """One robot goes to one goal.

    Attributes:
        robot: who.
        to_deg: configuration of a robot with revolute joints only [deg]; or
        to_rad_or_m: configuration of any robot, joint by joint [rad or m]; or
        to: pose of the frame in the world.
        frame: tool frame that goes there.
    """

    robot: Name
    to_deg: Configuration | None = None
    to_rad_or_m: Configuration | None = None
    to: PoseSection | None = None
    frame: Name = "tool"

    @model_validator(mode="after")
    def _one_goal(self) -> MoveSection:
        given = [v for v in (self.to_deg, self.to_rad_or_m, self.to) if v is not None]
        if len(given) != 1:
            raise ValueError("give 'to', 'to_deg' or 'to_rad_or_m', one of them")
        return self


class GoalsSection(AssemblySection):
    """Goals of the robots.

    Attributes:
        kind: ``goals``.
        moves: in the order of a sequential plan.
    """

    kind: Literal["goals"]
    moves: Several[MoveSection]
