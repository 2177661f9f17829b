"""Interface of a kind of assembly: its scenario section and its planner."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, Protocol, Self, get_args

from planning.cell.workcell import (
    CONTACT_DEPTH,
    CellObject,
    Fixture,
    PlacedRobot,
    Workcell,
)
from planning.errors import RequestError
from planning.tasks.task import ActuationKey
from twin.document.section import Section
from twin.document.validation import Problems
from twin.document.yaml_text import KeyPath
from twin.durations.composed import AnyDuration, SkillOverride
from twin.durations.measured import Packaged
from twin.durations.model import DurationModel, PackagedSkill
from twin.host.progress import StageWatch
from twin.registry import KINDS
from twin.scenario.sections.cell import CellSection, RobotSection
from twin.scenario.sections.execution import ExecutionSection, StepWindowSection

if TYPE_CHECKING:
    from planning.motion.sequential import MotionSettings
    from planning.tasks.assembly import Assembly
    from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
    from scheduling.planned_motions import PlannedMotions

SpeedModelName = Literal["limits", "joint", "l1"]

IdleReason = Literal[
    "no reach", "tools", "not allowed", "makespan", "balance", "search", "unknown"
]
"""Why a robot gets no task."""

StartUp = int | Literal["auto"] | None
"""Number of products at the beginning that do not count for throughput: by default a tenth; ``auto`` by MSER-5."""

ASSIGNMENT = "who does what"
"""Name of the stage for progress displays."""

NO_WINDOW = (
    "execution.window: only steps of a LEGO assembly, and products of a line whose steps are listed and whose"
    " parts are not alike, can be planned some at a time: leave it out"
)


class AssemblySection(Section):
    """Section of an assembly.

    Attributes:
        kind: name of its kind in the registry.
    """

    kind: str


class AssemblyKind(Protocol):
    """The section of an assembly in a scenario, and how it is planned.

    Defaults are those of a kind that brings neither objects nor fixtures of its own. The class is
    loaded with every scenario, so its module imports no planner.

    Attributes:
        section_class: class of the section.
        included: sections that may be in a file of their own, by their key in the assembly.
        default_speed_model: speed model of a plan whose scenario gives none.
        tries_sidesteps: whether sidesteps are tried where the scenario does not say.
        chooses_robots: whether fewer robots may do the steps than there are, where that shortens the plan.
        searches_assignment: whether an assignment is searched where the scenario does not say.
        changes_tools: whether robots may change their tools.
        allows_deviation: whether force control may deviate from the reference path.
    """

    section_class: ClassVar[type[AssemblySection]]
    included: ClassVar[Mapping[str, type[Section]]] = {}
    default_speed_model: ClassVar[SpeedModelName] = "limits"
    tries_sidesteps: ClassVar[bool] = False
    chooses_robots: ClassVar[bool] = False
    searches_assignment: ClassVar[bool] = False
    changes_tools: ClassVar[bool] = False
    allows_deviation: ClassVar[bool] = True

    @property
    def space_time(self) -> bool:
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

    def problems(self, cell: CellSection) -> Problems:
        """Yield the problems of the section.

        Args:
            cell: what the file says of the robots and fixtures around it.
        """
        yield from ()

    def reject_problems(
        self, execution: ExecutionSection, cell: CellSection
    ) -> Problems:
        """Yield the problems of rework and of the bin in an execution section; both are of assemblies of parts."""
        if execution.recovery.bin is not None:
            words = "a bin is for assemblies of parts that are planned step by step"
            yield ("execution", "recovery", "bin"), f"{words}: leave it out"
        for skill, own in execution.failures.items():
            if own.named:
                at = ("execution", "failures", skill, "rework", "steps")
                yield at, "only steps of assemblies of parts have names: leave it out"

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

    def distinct(self) -> Self:
        """Return the assembly with no more products than are needed to check all that differ."""
        return self

    def units(self) -> tuple[Self, ...]:
        """Return what is planned by itself, each as an assembly from HOME to HOME, to be executed as often as needed."""
        return (self,)

    def all_products(self, plans: Sequence[TemporalPlanGraph]) -> TemporalPlanGraph:
        """Return the plan of all products, made from the plans of the units; only asked of several products.

        Raises:
            PlanInvariantError: equipment of one product obstructs another.
        """
        raise AssertionError("one product is planned as a whole")

    def machines(self) -> tuple[str, ...]:
        """Return the names of the machines that bring parts and take products away."""
        return ()

    def machine_durations(self) -> tuple[SkillOverride, ...]:
        """Return how long machines take for their tasks."""
        return ()

    def products(self) -> int:
        """Return how many products are made."""
        return 1

    def product_ends(self) -> Sequence[int]:
        """Return the number of the last step of each product."""
        return (self.steps(),)

    def product_of(self, step: int) -> int:
        """Return the product of a step, both from 1."""
        return bisect_left(self.product_ends(), step) + 1

    def rush_s(self) -> tuple[float, ...]:
        """Return when the products of rush orders come in [s]."""
        return ()

    def with_rush(self, _after: tuple[int, ...]) -> Self:
        """Return the same with first products of rush orders, given how many products come before each of them."""
        return self

    def variants(self) -> tuple[str, ...]:
        """Return the variant of each product; empty where all are equal."""
        return ()

    def revised_section(self, _plan: TemporalPlanGraph) -> AssemblySection | None:
        """Return the section to plan again with, given a plan of its own; None where that is final."""
        return None

    def as_planned(
        self, _planned: Callable[[], AssemblySection]
    ) -> AssemblySection | None:
        """Return the section with what planning has added to the one that was planned; None where it adds nothing."""
        return None

    def due(self) -> tuple[tuple[float, ...], StartUp]:
        """Return when each product is due [s], and how many at the beginning do not count."""
        return (), None

    def contact_depth(self) -> float:
        """Return how deep objects that are meant to touch may be in each other [m]."""
        return CONTACT_DEPTH

    def assembly(self, cell: Workcell, watch: StageWatch) -> Assembly:
        """Return the assembly with the candidates of all steps; not asked of what is planned in space and time.

        Args:
            cell: built of the same scenario.
            watch: measures and reports the stages.

        Raises:
            TwinError: the assembly cannot be built as it is.
        """
        raise AssertionError("it is planned in space and time")

    def plan(
        self, cell: Workcell, settings: MotionSettings, watch: StageWatch
    ) -> PlannedMotions:
        """Plan in space and time who does what, and how everyone moves; only asked where ``space_time``.

        Args:
            cell: built of the same scenario.
            settings: how tasks are turned into motions.
            watch: measures and reports the stages.

        Raises:
            TwinError: the assembly cannot be built as it is, or no plan was found.
        """
        raise AssertionError("it is planned one task after another")

    def ahead(self, cell: Workcell, watch: StageWatch) -> Assembly:
        """Return the assembly of which ``first`` gives any number of steps, once all are known to be possible in order.

        Args:
            cell: built of the same scenario.
            watch: measures and reports the stages.

        Raises:
            RequestError: steps of this kind are looked at together.
            TwinError: the assembly cannot be built as it is.
        """
        raise RequestError(NO_WINDOW)

    def step_window(self) -> StepWindowSection | None:
        """Return the rolling planning window of ``twin operate`` where the scenario has none; None for all steps."""
        return None

    def finished(self, motions: PlannedMotions) -> PlannedMotions:
        """Return planned motions with what only this kind knows of them."""
        return motions

    def included_problems(self) -> Problems:
        """Yield the problems of an included section, with keys in its own file."""
        yield from ()

    def why_unable(self, robot: PlacedRobot, motions: PlannedMotions) -> IdleReason:
        """Return why a robot is a candidate for no step.

        Args:
            robot: of the cell.
            motions: of all robots.
        """
        return "no reach"

    def steps_served(self, robot: str, motions: PlannedMotions) -> tuple[int, int]:
        """Return in how many steps a robot could do something by its reach, and how many there are.

        Args:
            robot: its name.
            motions: planned along with the choice of who does what.
        """
        return 0, self.steps()

    def miss_probabilities(
        self, cell: Workcell, robots: Sequence[RobotSection]
    ) -> Mapping[str, float]:
        """Return the probability that a robot misses the place of an object, by ROBOT/OBJECT.

        Args:
            cell: as it is before the first motion.
            robots: of the cell, as the file describes them.
        """
        return {}

    def default_durations(self) -> Mapping[str, AnyDuration]:
        """Return the duration of each skill that takes a packaged time where the scenario gives none."""
        names: tuple[PackagedSkill, ...] = get_args(PackagedSkill)
        return {name: Packaged(skill=name) for name in names}

    def processes(self) -> Mapping[str, AnyDuration | None]:
        """Return the duration of each process that it names, None where ``execution.skills`` gives it."""
        return {}

    def actuations(self, cell: CellSection) -> Mapping[ActuationKey, DurationModel]:
        """Return how long tools take to close and to open, by act, robot and tool.

        Args:
            cell: what the file says of the robots and their tools.
        """
        return {}

    def part_names(self) -> Iterable[str]:
        """Return the names by which a failure may refer to an object."""
        return [name for _, name in self.names()]

    def working_machines(self) -> Iterable[str]:
        """Return the names of the machines that work at parts."""
        return ()

    def disturbed_machines(self) -> Iterable[str]:
        """Return the names of the machines that may be disturbed."""
        return ()

    def has_given_starts(self) -> bool:
        """Return whether every part lies at the start where the scenario gives its pose."""
        return False

    def object_named(
        self, name: str, known: Mapping[str, CellObject]
    ) -> CellObject | None:
        """Return an object that is supplied during execution, None if no such name is supplied.

        Args:
            name: not among those of the start.
            known: the objects by name.
        """
        return None


def assembly_kind(section: AssemblySection) -> AssemblyKind:
    """Return the assembly kind of a section."""
    found: AssemblyKind = KINDS.load(section.kind)(section)
    return found
