"""What a check finds, the scenario that it looks at, and what depends on the kind of its assembly."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Protocol

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.contacts.interference import Overlaps
from planning.expectations import TOUCH
from planning.steps.tool_changes import rack_tools, with_all_tools_mounted
from planning.transforms import Array, Transform
from twin.document.yaml_text import KeyPath
from twin.durations.model import PackagedSkill
from twin.planning.build_workcell import build_workcell
from twin.registry import CHECKS
from twin.scenario.sections.kind import AssemblyKind, assembly_kind
from twin.scenario.sections.scenario import Scenario


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a scenario, or that is doubtful.

    Attributes:
        at: key in the file.
        message: what, and what to do about it.
        error: whether it makes a plan impossible or false; a warning otherwise.
        at_start: whether something is wrong before anybody moves.
    """

    at: KeyPath
    message: str
    error: bool = False
    at_start: bool = False


Findings = Iterator[Finding]


@dataclass(frozen=True)
class CheckContext:
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

    def thing_at(self, name: str, key: str = "name") -> KeyPath:
        """Return where an object or a fixture is in the file; where it begins may be its source."""
        places, known = self._places, name_in_file(name, self._places)
        path = places.get(known, ("assembly",))
        if path[-1] != "name":
            return path
        return self.checks.key_at(path, key)

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
    """What checks and pictures of a scenario ask of its kind of assembly; for kinds with nothing of their own.

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
        """Whether tools hold by suction where nothing else is said of them."""
        return False

    @property
    def touch_m(self) -> float:
        """Distance up to which things touch at the start [m]."""
        return TOUCH

    @property
    def overlaps(self) -> Overlaps:
        """How deep objects may be in each other."""
        return Overlaps()

    def reach(self) -> Findings:
        """Yield what no robot reaches: an error where the planner would find none either."""
        yield from ()

    def goals(self) -> Mapping[str, Transform]:
        """Return where objects are put, by their names."""
        return {}

    def goal_pieces(self) -> Iterator[tuple[str, Array]]:
        """Yield what is put somewhere, with the corners of each of its pieces there, shape (v, 3) [m]."""
        yield from ()

    def tool_frames(self) -> Iterator[tuple[str, str, bool]]:
        """Yield the tool frames that are used, each with its robot, and whether it holds parts there."""
        for robot in self.subject.cell.robots:
            yield robot.name, "tool", True

    def sized(self) -> Sequence[CellObject]:
        """Return the objects whose sizes the file gives."""
        return ()

    def placed(self) -> Sequence[CellObject]:
        """Return the objects that are put in place and whose masses count."""
        return ()

    def key_at(self, path: KeyPath, key: str) -> KeyPath:
        """Return the key of a property of an object or a fixture.

        Args:
            path: key of its name.
            key: such as ``start`` or ``goal``.
        """
        return (*path[:-1], key)

    def fits(self) -> tuple[FittedPart, ...]:
        """Return how parts fit where they are put, in the order of the steps."""
        return ()


class FittedPart(Protocol):
    """How a part fits where it is put."""

    @property
    def step(self) -> int:
        """Number of the step, from 1."""
        ...

    @property
    def words(self) -> str:
        """What it is, for people."""
        ...

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        ...


def name_in_file(name: str, known: Container[str]) -> str:
    """Return what the file calls a part: of products, and of parts that are alike, without its number.

    Args:
        name: of the part.
        known: names in the file.
    """
    while name not in known and "." in name:
        name = name.rpartition(".")[0]
    return name


def format_millimetres(distance_m: float) -> str:
    """Return a distance in words."""
    return f"{distance_m * 1e3:.1f} mm"


def format_position(pose_xyz: tuple[float, ...] | list[float]) -> str:
    """Return a position in words."""
    return f"({', '.join(f'{value:.2f}' for value in pose_xyz)}) m"
