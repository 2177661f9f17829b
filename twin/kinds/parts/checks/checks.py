"""Checks of a scenario with an assembly of parts, and the parts that pictures of the scenario show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from planning.cell.workcell import CellObject
from planning.contacts.interference import Overlaps
from planning.parts.assembly import PlacePart
from planning.parts.part_steps import spot_pose
from planning.transforms import Array, Transform
from twin.checks.finding import Finding, Findings, name_in_file
from twin.checks.ignored_contacts import check_ignored_contacts
from twin.checks.meshes import check_meshes
from twin.checks.placements import (
    check_centres,
    check_fixtures,
    check_starts,
)
from twin.checks.robots import (
    check_bases,
    check_efforts,
    check_homes,
    check_skill_times,
    check_speeds,
    check_standing_times,
)
from twin.checks.tools import (
    check_descriptions,
    check_flanges,
    check_openings,
    check_suction,
    check_tool_frames,
)
from twin.checks.usual import check_physics, check_rates, check_usual
from twin.document.yaml_text import KeyPath
from twin.kinds.parts.checks.actuation_times import check_grip_times
from twin.kinds.parts.checks.context import PartsContext
from twin.kinds.parts.checks.gripping import check_lifts, check_room, check_turning
from twin.kinds.parts.checks.grips import check_grips
from twin.kinds.parts.checks.holds import check_friction, check_holds, check_pads
from twin.kinds.parts.checks.loads import check_payloads
from twin.kinds.parts.checks.places import (
    check_balance,
    check_goals,
    check_joints,
    check_machines,
    check_works,
)
from twin.kinds.parts.checks.reach import check_part_reach
from twin.kinds.parts.checks.windows import check_due_times, check_windows
from twin.kinds.parts.fits import KnownFit, known_fits
from twin.kinds.parts.line import write_out_line
from twin.kinds.parts.ordered_places import pallet_places


class PartChecks(PartsContext):
    """Checks of a scenario with an assembly of parts."""

    quick = (
        check_fixtures,
        check_meshes,
        check_bases,
        check_homes,
        check_starts,
        check_goals,
        check_joints,
        check_balance,
        check_centres,
        check_descriptions,
        check_ignored_contacts,
        check_grips,
        check_turning,
        check_flanges,
        check_tool_frames,
        check_openings,
        check_pads,
        check_holds,
        check_room,
        check_lifts,
        check_friction,
        check_payloads,
        check_suction,
        check_efforts,
        check_works,
        check_machines,
        check_windows,
        check_skill_times,
        check_grip_times,
        check_standing_times,
        check_speeds,
        check_usual,
        check_rates,
        check_due_times,
        check_physics,
    )
    skills = ("pick", "place-down")

    @property
    def by_suction(self) -> bool:
        """Whether the grips of the assembly are by suction."""
        return self.section.grips.suction

    @property
    def touch_m(self) -> float:
        """Distance up to which parts touch [m]."""
        return self.section.touch_m

    @property
    def overlaps(self) -> Overlaps:
        """Allowed overlaps of joined and press-fitted parts."""
        return self.parts.listed.overlaps

    def reach(self) -> Findings:
        """Yield parts, places of work and racks that no robot reaches."""
        return check_part_reach(self.subject, self.parts)

    def goals(self) -> Mapping[str, Transform]:
        """Return the goals of the parts."""
        return self.parts.listed.goals

    def goal_pieces(self) -> Iterator[tuple[str, Array]]:
        """Yield the pieces of the parts at their goals and intermediate places."""
        from twin.checks.views import placed_points

        assembly, cell = self.parts.listed, self.subject.cell
        words = {
            name: f"{name.rpartition('.')[0]} goal {number}"
            for group in assembly.alike
            for number, name in enumerate(group, start=1)
        }
        stops = [
            (step.part, spot_pose(cell, step.stop))
            for step in assembly.steps
            if isinstance(step, PlacePart) and step.stop is not None
        ]
        for name, pose in (*assembly.goals.items(), *stops):
            for piece in cell.object(name).shape.pieces:
                yield words.get(name, name), placed_points(piece.vertices, pose)

    def tool_frames(self) -> Iterator[tuple[str, str, bool]]:
        """Yield the frame that grips, and those of processes."""
        for robot in self.subject.cell.robots:
            yield robot.name, self.section.grips.frame, True
        for process in self.section.processes.values():
            for item in self.subject.cell.robots:
                if process.frame in item.model.frames:
                    yield item.name, process.frame, False

    def sized(self) -> Sequence[CellObject]:
        """Return the parts."""
        return self.subject.cell.objects

    def placed(self) -> Sequence[CellObject]:
        """Return the parts that steps place."""
        placed = {step.place for step in self.section.steps if step.place}
        objects = self.subject.cell.objects
        return [part for part in objects if name_in_file(part.name, placed) in placed]

    def key_at(self, path: KeyPath, key: str) -> KeyPath:
        """Return the path of a property of a part or of its source."""
        if path[:2] == ("assembly", "parts"):
            number = path[2]
            assert isinstance(number, int)
            part = self.section.parts[number]
            if key == "start" and part.sources[1:]:
                return ("assembly", "parts", number, "source")
            if key == "start" and part.sources:
                return ("assembly", "sources", part.sources[0], "pose")
            if part.several and key in ("start", "goal"):
                key += "s"
        return super().key_at(path, key)

    def places(self, finding: Finding) -> Mapping[str, str]:
        """Return the places in which the parts of a finding lie, or to which they go."""
        line = write_out_line(self.section)
        found = line.places
        if finding.at[-1] in ("goal", "goals"):
            words = pallet_places(self.section).words
            numbers = {name: product for name, (_, product) in line.numbers.items()}
            found = {k: words[(n - 1) % len(words)] for k, n in numbers.items()}
        elif finding.at[-1] != "source" and finding.at[1:2] != ("sources",):
            found = {}
        return {name: found[name] for name in finding.parts if found.get(name)}

    def fits(self) -> tuple[KnownFit, ...]:
        """Return the fits of parts at their places, in the order of the steps."""
        return known_fits(self.parts, self.subject.scenario.cell.robots)
