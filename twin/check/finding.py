"""What a check finds, and the cell that it looks at, its parts in the order of their steps."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass
from functools import cached_property, wraps
from pathlib import Path

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import ConstructionError, InfeasibleStepError
from planning.parts.assembly import PartAssembly, Work
from planning.parts.part_steps import KnownStep, part_steps
from planning.steps.tool_changes import rack_tools, with_every_tool
from twin.kinds.parts.alike import listed_steps
from twin.kinds.parts.section import PartsSection
from twin.planning.build_workcell import build_workcell
from twin.scenario.document.yaml_text import KeyPath
from twin.scenario.sections.kind import AssemblyKind, assembly_kind
from twin.scenario.sections.scenario import Scenario


@dataclass(frozen=True)
class OrderedParts:
    """An assembly of parts, as listed and in order.

    Attributes:
        cell: its objects are the parts.
        section: what the file says.
    """

    cell: Workcell
    section: PartsSection

    @property
    def count(self) -> int:
        """Number of its steps; of those of a product where several are made."""
        return len(listed_steps(self.section))

    @cached_property
    def listed(self) -> PartAssembly:
        """The assembly with its steps as the file lists them."""
        from twin.kinds.parts.built import build_assembly

        return build_assembly(self.section)

    @cached_property
    def there(self) -> Workcell:
        """The cell as steps find it: parts that are alike are nowhere, as each may come from anywhere."""
        from planning.parts.alike import from_nowhere

        return from_nowhere(self.cell, self.listed)

    @cached_property
    def found(self) -> PartAssembly | str:
        """The assembly in its order, the one that is found if the file asks for that; or why not."""
        from planning.parts.order import in_found_order

        if self.section.order != "find":
            return self.listed
        try:
            return in_found_order(self.there, self.listed)
        except (ConstructionError, InfeasibleStepError) as error:
            return error.message

    @cached_property
    def steps(self) -> tuple[KnownStep, ...] | None:
        """Its steps in that order; None where one cannot be, or there is no order."""
        if isinstance(self.found, str):
            return None
        try:
            return part_steps(self.there, self.found)
        except InfeasibleStepError:
            return None

    def works(self) -> Iterator[tuple[int, KnownStep, Work, list[PlacedRobot]]]:
        """Yield processes of robots in that order: number as listed, from 1, and who may do each.

        There are none where a step cannot be, which is said elsewhere.
        """
        listed = {id(step): k for k, step in enumerate(self.listed.steps, start=1)}
        for known in self.steps or ():
            step = known.step
            if not isinstance(step, Work):
                continue
            process = step.process
            robots = [
                robot
                for robot in self.cell.robots
                if step.done_by(robot.name)
                and process.tool in (None, robot.tool)
                and process.frame in {"flange", *robot.model.frames}
            ]
            yield listed[id(step)], known, step, robots


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a scenario, or that is doubtful.

    Attributes:
        at: key in the file.
        message: what, and what to do about it.
        error: whether it makes a plan impossible or false; a warning otherwise.
    """

    at: KeyPath
    message: str
    error: bool = False


Findings = Iterator[Finding]


def of_parts(
    check: Callable[[Subject, OrderedParts], Findings],
) -> Callable[[Subject], Findings]:
    """Make a check of assemblies of parts one of all scenarios, which finds nothing in others."""

    @wraps(check)
    def checked(subject: Subject) -> Findings:
        return iter(()) if subject.parts is None else check(subject, subject.parts)

    return checked


@dataclass(frozen=True)
class Subject:
    """A scenario that is checked, with its cell, and where in the file things are named.

    Attributes:
        scenario: passed the checks of its file.
        folder: where relative paths in it start.
    """

    scenario: Scenario
    folder: Path

    @cached_property
    def built(self) -> Workcell:
        """The cell as it is before the first motion, as planning gets it."""
        return build_workcell(self.scenario, self.folder)

    @cached_property
    def cell(self) -> Workcell:
        """The same with a robot that changes its tools as several: one with each of them on it."""
        return with_every_tool(self.built)

    @cached_property
    def kind(self) -> AssemblyKind:
        """The kind of the assembly."""
        return assembly_kind(self.scenario.assembly)

    @cached_property
    def parts(self) -> OrderedParts | None:
        """The assembly in order, where it is one of parts."""
        section = self.scenario.assembly
        if not isinstance(section, PartsSection):
            return None
        return OrderedParts(self.cell, section)

    @cached_property
    def unlike_robots(self) -> tuple[PlacedRobot, ...]:
        """A robot of each model: what its description says holds for the others."""
        first: dict[RobotModel, PlacedRobot] = {}
        for robot in self.cell.robots:
            first.setdefault(robot.model, robot)
        return tuple(first.values())

    @cached_property
    def own_fixtures(self) -> frozenset[str]:
        """Names of the fixtures that the file lists; others come with the kind of assembly."""
        return frozenset(item.name for item in self.scenario.cell.fixtures)

    def robot_at(self, name: str, *keys: str) -> KeyPath:
        """Return where a robot is in the file, or the first of some keys that it may have."""
        listed = [robot.name for robot in self.scenario.cell.listed]
        if name not in listed:
            return ("cell", "team")
        number = listed.index(name)
        section = self.scenario.cell.listed[number]
        key = next((k for k in keys if getattr(section, k)), "name")
        return ("cell", "robots", number, key)

    def step_at(self, number: int, *keys: str) -> KeyPath:
        """Return where a step is in the file, by its number from 1; all products share theirs."""
        assert self.parts is not None
        listed = listed_steps(self.parts.section)
        return ("assembly", "steps", listed[(number - 1) % len(listed)], *keys)

    def thing_at(self, name: str, key: str = "name") -> KeyPath:
        """Return where an object or a fixture is in the file; where it begins may be its source."""
        places, known = self._places, in_file(name, self._places)
        path = places.get(known, ("assembly",))
        if path[-1] != "name":
            return path
        section = self.scenario.assembly
        if isinstance(section, PartsSection) and path[:2] == ("assembly", "parts"):
            number = path[2]
            assert isinstance(number, int)
            part = section.parts[number]
            if key == "start" and part.source is not None:
                return ("assembly", "sources", part.source, "pose")
            if part.several and key in ("start", "goal"):
                key += "s"
        return (*path[:-1], key)

    @cached_property
    def _places(self) -> dict[str, KeyPath]:
        fixtures: dict[str, KeyPath] = {
            item.name: ("cell", "fixtures", number, "name")
            for number, item in enumerate(self.scenario.cell.fixtures)
        }
        racks: dict[str, KeyPath] = {
            tool.name: ("cell", "tools", tool.name, "rack")
            for tool in rack_tools(self.built)
        }
        return {name: path for path, name in self.kind.names()} | fixtures | racks


def in_file(name: str, known: Container[str]) -> str:
    """Return what the file calls a part: of products, and of parts that are alike, without its number.

    Args:
        name: of the part.
        known: names in the file.
    """
    while name not in known and "." in name:
        name = name.rpartition(".")[0]
    return name


def millimetres(distance_m: float) -> str:
    """Return a distance in words."""
    return f"{distance_m * 1e3:.1f} mm"


def position(pose_xyz: tuple[float, ...] | list[float]) -> str:
    """Return a position in words."""
    return f"({', '.join(f'{value:.2f}' for value in pose_xyz)}) m"
