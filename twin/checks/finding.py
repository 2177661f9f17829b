"""Findings of checks, the data that checks receive, and the interface of checks for special kinds of assembly."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Protocol

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.contacts.interference import Overlaps
from planning.contacts.touching import NEAR
from planning.handling.tool_changes import rack_tools, with_all_tools_mounted
from planning.transforms import Array, Transform
from twin.document.yaml_text import KeyPath
from twin.durations.model import PackagedSkill
from twin.planning.build_workcell import build_workcell
from twin.registry import CHECKS
from twin.scenario.sections.kind import AssemblyKind, assembly_kind
from twin.scenario.sections.scenario import Scenario

Findings = Iterator["Finding"]


@dataclass(frozen=True)
class Finding:
    """An error or a warning about a scenario.

    Attributes:
        at: key in the file.
        message: the problem and its remedy.
        error: whether it makes a plan impossible or false; a warning otherwise.
        at_start: whether something is wrong before anybody moves.
        code: its kind, where it is about parts that several products have.
        parts: names of those parts, and of what they are near to.
        figures: what else distinguishes such findings, such as distances [m].
    """

    at: KeyPath
    message: str
    error: bool = False
    at_start: bool = False
    code: str = ""
    parts: tuple[str, ...] = ()
    figures: tuple[float, ...] = ()


@dataclass(frozen=True)
class CheckContext:
    """A checked scenario, with its cell and positions in the file.

    Attributes:
        scenario: passed the checks of its file.
        folder: where relative paths in it start.
    """

    scenario: Scenario
    folder: Path

    @cached_property
    def built(self) -> Workcell:
        """The cell before the first motion, as in planning."""
        return build_workcell(self.scenario, self.folder, self.kind.distinct())

    @cached_property
    def cell(self) -> Workcell:
        """The cell with a tool-changing robot as several, one with each tool."""
        return with_all_tools_mounted(self.built)

    @cached_property
    def kind(self) -> AssemblyKind:
        """The kind of the assembly."""
        return assembly_kind(self.scenario.assembly)

    @cached_property
    def checks(self) -> KindChecks:
        """The checks that depend on the kind of the assembly."""
        kind = self.scenario.assembly.kind
        found: type[KindChecks] = CHECKS.load(kind) if kind in CHECKS else KindChecks
        return found(self)

    @cached_property
    def distinct_robots(self) -> tuple[PlacedRobot, ...]:
        """One robot of each model, for checks of descriptions."""
        first: dict[RobotModel, PlacedRobot] = {}
        for robot in self.cell.robots:
            first.setdefault(robot.model, robot)
        return tuple(first.values())

    @cached_property
    def own_fixtures(self) -> frozenset[str]:
        """Names of the fixtures that the file lists; others come with the kind of assembly."""
        return frozenset(item.name for item in self.scenario.cell.fixtures)

    def robot_at(self, name: str, *keys: str) -> KeyPath:
        """Return the path of a robot in the file, or of the first of some keys that it has."""
        listed = [robot.name for robot in self.scenario.cell.listed]
        if name not in listed:
            return ("cell", "team")
        number = listed.index(name)
        section = self.scenario.cell.listed[number]
        key = next((k for k in keys if getattr(section, k)), "name")
        return ("cell", "robots", number, key)

    def thing_at(self, name: str, key: str = "name") -> KeyPath:
        """Return the path of an object or a fixture in the file."""
        places, known = self._places, name_in_file(name, self._places)
        path = places.get(known, ("assembly",))
        if path[-1] != "name":
            return path
        return self.checks.key_at(path, key)

    def alike_as(self, name: str) -> tuple[str, str]:
        """Return what an object or a fixture has in common with those like it.

        That is its name in the file without the number of equal parts, and, of equal parts, its product.
        """
        known = name_in_file(name, self._places)
        kind, _, number = known.rpartition(".")
        at = self._places.get(known)
        if number.isdigit() and list(self._places.values()).count(at or ()) > 1:
            return kind, name.removeprefix(known)
        return known, ""

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


class KindChecks:
    """Interface of kind-specific checks and pictures; the default for kinds without their own.

    Attributes:
        subject: the scenario and its cell.
        quick: its quick checks in their order; empty for the general ones.
        skills: skills that every assembly of the kind uses, and for which no time is packaged.
    """

    quick: ClassVar[tuple[Callable[[CheckContext], Findings], ...]] = ()
    skills: ClassVar[tuple[PackagedSkill, ...]] = ()

    def __init__(self, subject: CheckContext) -> None:
        self.subject = subject

    @property
    def by_suction(self) -> bool:
        """Whether tools hold by suction by default."""
        return False

    @property
    def touch_m(self) -> float:
        """Distance up to which things touch at the start [m]."""
        return NEAR

    @property
    def overlaps(self) -> Overlaps:
        """Allowed overlaps of objects."""
        return Overlaps()

    def reach(self) -> Findings:
        """Yield unreachable poses: an error where planning would fail, too."""
        yield from ()

    def goals(self) -> Mapping[str, Transform]:
        """Return the goal poses of objects, by name."""
        return {}

    def goal_pieces(self) -> Iterator[tuple[str, Array]]:
        """Yield placed objects, with the corners of each piece at the goal, shape (v, 3) [m]."""
        yield from ()

    def tool_frames(self) -> Iterator[tuple[str, str, bool]]:
        """Yield the used tool frames, each with its robot, and whether it holds parts."""
        for robot in self.subject.cell.robots:
            yield robot.name, "tool", True

    def sized(self) -> Sequence[CellObject]:
        """Return the objects with sizes in the file."""
        return ()

    def placed(self) -> Sequence[CellObject]:
        """Return the placed objects whose masses count."""
        return ()

    def key_at(self, path: KeyPath, key: str) -> KeyPath:
        """Return the key of a property of an object or a fixture.

        Args:
            path: key of its name.
            key: such as ``start`` or ``goal``.
        """
        return (*path[:-1], key)

    def places(self, finding: Finding) -> Mapping[str, str]:
        """Return the places of trays and pallets in which parts of a finding are, by part."""
        return {}

    def fits(self) -> tuple[FittedPart, ...]:
        """Return the fits of parts at their places, in the order of the steps."""
        return ()


class FittedPart(Protocol):
    """Fit of a part at its place."""

    @property
    def step(self) -> int:
        """Number of the step, from 1."""
        ...

    @property
    def words(self) -> str:
        """Description, for people."""
        ...

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        ...


def name_in_file(name: str, known: Container[str]) -> str:
    """Return the name of a part in the file, without the number of products or equal parts.

    Args:
        name: of the part.
        known: names in the file.
    """
    while name not in known and "." in name:
        name = name.rpartition(".")[0]
    return name


def format_millimetres(distance_m: float) -> str:
    """Return a distance as text."""
    return f"{distance_m * 1e3:.1f} mm"


def format_position(pose_xyz: tuple[float, ...] | list[float]) -> str:
    """Return a position as text."""
    return f"({', '.join(f'{value:.2f}' for value in pose_xyz)}) m"
