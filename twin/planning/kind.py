"""The interface of a kind of assemblies, the motions that it plans, and the kinds there are.

The times of a plan within its robots' limits, with corners rounded where the scenario says so.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

from planning.cell.workcell import CONTACT_DEPTH, CellObject, Fixture, Workcell
from planning.errors import RequestError
from planning.expectations import Expectations
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import within_limits
from scheduling.shortcuts.corners import round_corners
from twin.document.validation import Found
from twin.document.yaml_text import KeyPath
from twin.host.progress import StageWatch
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.scenario import AssemblySection, Scenario

if TYPE_CHECKING:
    from planning.motion.known_motions import MotionPlan
    from planning.motion.sequential import MotionSettings
    from planning.tasks.assignment import TaskPlan
    from planning.tasks.work import AssemblyWork, WorkAhead
    from scheduling.repeat import Pattern
    from twin.durations.lifetimes import SkillOverride


@dataclass(frozen=True)
class PlannedMotions:
    """An assembly with its motions: what every coordination starts from.

    Attributes:
        cell: the workcell.
        assembly: what is built, such as a ``LegoAssembly``; the plan of a construction.
        task_plan: who does what; empty where that is decided along with the motions.
        motion_plan: how everyone moves.
        settings: how tasks were turned into motions.
        work: what task and motion plan were made from, where others can be made from it.
        pattern: how the plan goes on for further products, None where it is that of all.
        ahead: the work of more steps, None where all are planned.
    """

    cell: Workcell
    assembly: Any
    task_plan: TaskPlan
    motion_plan: MotionPlan
    settings: MotionSettings
    work: AssemblyWork | None = field(default=None, kw_only=True)
    pattern: Pattern | None = field(default=None, kw_only=True)
    ahead: WorkAhead | None = field(default=None, kw_only=True)


NO_WINDOW = (
    "execution.window: only steps of a LEGO assembly, and products of a line whose steps are listed and whose"
    " parts are not alike, can be planned some at a time: leave it out"
)


class AssemblyKind(Protocol):
    """The section of an assembly in a scenario, and how it is planned.

    Defaults are those of a kind that brings neither objects nor fixtures of its own.
    """

    @property
    def at_once(self) -> bool:
        """True if planned in space and time: robots move at once, on shortened paths.

        Its robots then move at the speeds of their joints, and its plan cannot be turned into
        one in slots.
        """
        return False

    def steps(self) -> int:
        """Return the number of steps."""
        ...

    def wanted_steps(self) -> int:
        """Return the number of first steps that are wanted as long as nothing fails and nothing else is ordered."""
        return self.steps()

    def supply(self) -> str:
        """Return a description of the supply."""
        ...

    def names(self) -> Iterable[tuple[KeyPath, str]]:
        """Return the names of the objects it brings, each with its key in the file."""
        return ()

    def object_kinds(self) -> Iterable[str]:
        """Return the types of the objects it brings, each once."""
        return dict.fromkeys(item.kind for item in self.objects())

    def reserved(self, name: str) -> str | None:
        """Return what of its own has a name that nothing else may have, None if nothing."""
        return None

    def problems(self, cell: CellSection) -> Found:
        """Yield the problems of the section.

        Args:
            cell: what the file says of the robots and fixtures around it.
        """
        yield from ()

    def fixtures(self) -> tuple[Fixture, ...]:
        """Return the fixtures it brings."""
        return ()

    def objects(self, folder: Path = Path()) -> tuple[CellObject, ...]:
        """Return the objects it brings.

        Args:
            folder: where relative paths of meshes start, that of the scenario's file.
        """
        return ()

    def written_out(self) -> Self:
        """Return the same with every product planned by itself, where plans else repeat after the first ones."""
        return self

    def machines(self) -> tuple[str, ...]:
        """Return the names of the machines that bring parts and take products away."""
        return ()

    def machine_durations(self) -> tuple[SkillOverride, ...]:
        """Return how long machines take for their tasks."""
        return ()

    def products(self) -> int:
        """Return how many products are made, each in as many steps."""
        return 1

    def due(self) -> tuple[tuple[float, ...], int | None]:
        """Return when each product is due [s], and how many at the beginning do not count."""
        return (), None

    def contact_depth(self) -> float:
        """Return how deep objects that are meant to touch may be in each other [m]."""
        return CONTACT_DEPTH

    def wanted(self, cell: CellSection) -> Expectations:
        """Return what the run is to come to, as the section says, for the audit.

        Args:
            cell: what the file says of the robots and fixtures around it.
        """
        return Expectations()

    def place_misses(self, scenario: Scenario, folder: Path) -> Mapping[str, float]:
        """Return how likely robots miss the places of what they put down, by ROBOT/OBJECT.

        Args:
            scenario: with this section.
            folder: where relative paths in it start.
        """
        return {}

    def plan(
        self, cell: Workcell, settings: MotionSettings, watch: StageWatch
    ) -> PlannedMotions:
        """Plan who does what, and how everyone moves.

        Args:
            cell: built of the same scenario.
            settings: how tasks are turned into motions.
            watch: measures and reports the stages.

        Raises:
            TwinError: the assembly cannot be built as it is, or no plan was found.
        """
        ...

    def ahead(self, cell: Workcell, watch: StageWatch) -> WorkAhead:
        """Return the work of any number of first steps, once all are known to be possible in their order.

        Args:
            cell: built of the same scenario.
            watch: measures and reports the stages.

        Raises:
            RequestError: steps of this kind are looked at together.
            TwinError: the assembly cannot be built as it is.
        """
        raise RequestError(NO_WINDOW)

    def finished(self, motions: PlannedMotions) -> PlannedMotions:
        """Return motions that were planned otherwise, as ``plan`` would have left them."""
        return motions


_KINDS = {
    "lego": ("twin.planning.lego", "LegoKind"),
    "assembly": ("twin.planning.parts", "PartKind"),
    "goals": ("twin.planning.goals", "GoalsKind"),
    "construction": ("twin.planning.construction", "ConstructionKind"),
}
"""Module and class by the ``kind`` of a section."""


def assembly_kind(section: AssemblySection) -> AssemblyKind:
    """Return the assembly kind of a section."""
    module, name = _KINDS[section.kind]
    found: AssemblyKind = getattr(import_module(module), name)(section)
    return found


CORNERS = "corners"
"""Name of the stage for progress displays."""


def timed(
    tpg: TemporalPlanGraph, scenario: Scenario, watch: StageWatch
) -> TemporalPlanGraph:
    """Return a graph with the times that robots need within their limits; the stage is tpg.

    Corners are rounded first, where the scenario says so; what has no edges yet, or is executed slot
    by slot, stays as it was planned.
    """
    limited = scenario.speed_model == "limits" and scenario.planning.corners == "smooth"
    ordered = len(tpg.edges) > 0 or len(tpg.chains) < 2
    if limited and ordered and not len(tpg.slots):
        with watch.stage("tpg", CORNERS):
            tpg = round_corners(tpg, progress=watch.reporter(CORNERS))
    return within_limits(tpg)
