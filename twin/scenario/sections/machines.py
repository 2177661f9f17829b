"""Machines of an assembly: what works at parts where they lie, without a robot."""

from __future__ import annotations

from twin.scenario.document.section import Section
from twin.scenario.sections.poses import PoseSection
from twin.scenario.sections.shapes import ShapedSection


class DoorSection(ShapedSection):
    """Room that no robot may be in while its machine works: the leaf of a door, or a zone.

    Attributes:
        pose: of the frame of its shape in the world; of a box, its centre.
    """

    pose: PoseSection


class MachineSection(Section):
    """A machine that works at one part at a time where that lies; its frame is fixtures.

    Attributes:
        door: what is shut for as long as it works; nothing when not given.
    """

    door: DoorSection | None = None
