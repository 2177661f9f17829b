"""Scenario section of assembly kind ``assembly``: parts, grips, machines, processes and steps."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from planning.bounds import DENSEST_KG_M3, LONGEST_S
from planning.errors import ScenarioError
from twin.document.section import Name, Section, Several, with_tuples
from twin.durations.bounded import Fixed
from twin.durations.composed import AnyDuration
from twin.durations.model import PositiveSeconds
from twin.kinds.parts.between import AfterSection, FitSection
from twin.kinds.parts.sources import (
    Amount,
    FixedGrid,
    Places,
    ProductsSection,
    SourceSection,
)
from twin.kinds.statics import BalanceSection, JoinedParts
from twin.scenario.sections.cell import ActuationTime
from twin.scenario.sections.kind import AssemblySection
from twin.scenario.sections.shapes import (
    Colour,
    Mass,
    PoseSection,
    ShapedSection,
    Vector3,
)

Together = Annotated[int, Field(ge=1, le=100)]
Distance = Annotated[float, Field(ge=1e-4, le=1)]
Positions = Annotated[int, Field(ge=1, le=50)]
Margin = Annotated[float, Field(ge=0, le=1)]
Steepest = Annotated[float, Field(ge=0, le=180)]
Tilt = Annotated[float, Field(gt=-90, lt=90)]
Around = Annotated[float, Field(ge=1, le=360)]


class DoorSection(ShapedSection):
    """Room that no robot may be in while its machine works: the leaf of a door, or a zone.

    Attributes:
        pose: of the frame of its shape in the world; of a box, its centre.
    """

    pose: PoseSection


class MachineSection(Section):
    """A machine that works at parts where they lie, at one at a time or at a batch; its frame is fixtures.

    Attributes:
        door: what is shut for as long as it works; nothing when not given.
        fixtures: names of those that it is made of: what it works at lies on one of them.
        capacity: most parts that it works at together, in one run of a process.
        batches: numbers of parts in its first runs, where they are fewer; later ones are of ``capacity``.
        start_after_s: how long after its first part a run takes further ones in, in the plan; any time when not
            given.
    """

    door: DoorSection | None = None
    fixtures: tuple[Name, ...] = ()
    capacity: Together = 1
    batches: Annotated[tuple[Together, ...], Field(max_length=5000)] = ()
    start_after_s: Annotated[float, Field(gt=0, le=LONGEST_S)] | None = None


ChangeoverTime = AnyDuration | PositiveSeconds
"""A distribution, or a number of seconds."""


class ChangeoverSection(Section):
    """Work between two products of different variants.

    Attributes:
        machine: that is changed over, from when the last part is taken out of it until the next is put in; the whole
            cell when not given, from when the product has left until the next is begun.
        by: name of who does it; the machine itself when not given.
        duration: how long it takes between any two variants: a number [s] or a distribution.
        durations: in place of it, by the variant before and the variant after; pairs that are not there need none.
    """

    machine: Name | None = None
    by: Name | None = None
    duration: ChangeoverTime | None = None
    durations: dict[Name, dict[Name, ChangeoverTime]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _takes_time(self) -> ChangeoverSection:
        if (self.duration is None) == (not any(self.durations.values())):
            raise ValueError("how long does it take? Give duration or durations")
        return self

    @property
    def chain(self) -> str:
        """Name of the machine or person that does it."""
        return self.by or self.machine or "changeover"

    def between(self, before: str, after: str) -> AnyDuration | None:
        """Return how long it takes between two variants, None where it is not needed."""
        found = self.durations.get(before, {}).get(after)
        if self.duration is not None and before != after:
            found = self.duration
        return Fixed(value_s=found) if isinstance(found, float) else found


def _real_direction(value: tuple[float, ...]) -> tuple[float, ...]:
    if sum(v * v for v in value) < 1e-9:
        raise ValueError("a direction must not be zero")
    return value


Direction = Annotated[Vector3, AfterValidator(_real_direction)]


class PartSection(ShapedSection):
    """Something that is handled.

    Attributes:
        name: unique in the scenario.
        start: pose of the frame of its shape in the world at the start, unless it comes from a
            source; of a box, its centre.
        source: name of the source that it is taken from; of several, the first is emptied before the next
            one is begun, and so on in turns.
        goal: pose of that frame once it is in place; a part without one stays where it is.
        count: how many there are that are alike; as many as ``starts`` has places, or ``goals`` where
            they come from a source, when not given.
        starts: in place of ``start``, where parts that are alike lie: poses, or places in rows and columns.
        goals: in place of ``goal``, places each of which one of them comes to, whichever; what is left
            over stays where it is.
        mass_kg: its mass.
        density_kg_m3: in place of it, what a cubic metre of it weighs.
        centre_of_mass_m: its centre of mass in the frame of its shape; that of a body that is
            equally dense throughout when not given.
        colour: red, green, blue.
        frames: places on it where processes are done, by name: poses in the frame of its shape;
            their z axes point out of the part.
        grips: rules for grips on it, as far as they are others than those of the assembly.
        approach_m: of this part alone.
        leave_m: of this part alone.
        insert: direction in the world in which it is led straight into its place.
        take_out: direction in which it is led straight out of where it lies at the start.
    """

    name: Name
    start: PoseSection | None = None
    source: Name | Several[Name] | None = None
    goal: PoseSection | None = None
    count: Amount | None = None
    starts: Places | None = None
    goals: Places | None = None
    mass_kg: Mass = 0.0
    density_kg_m3: Annotated[float, Field(gt=0, le=DENSEST_KG_M3)] | None = None
    centre_of_mass_m: Vector3 | None = None
    colour: Colour = (190, 140, 90)
    frames: dict[Name, PoseSection] = Field(default_factory=dict)
    grips: PartGripSection | None = None
    approach_m: Distance | None = None
    leave_m: Distance | None = None
    insert: Direction = (0.0, 0.0, -1.0)
    take_out: Direction = (0.0, 0.0, 1.0)

    not_both = (("mass_kg", "density_kg_m3"), ("start", "starts"), ("goal", "goals"))

    @model_validator(mode="after")
    def _check_source(self) -> PartSection:
        if (self.start is None and self.starts is None) == (self.source is None):
            raise ValueError(
                "where does it come from? Give start, a pose, or source, the name of one"
            )
        if self.several and (self.start or self.goal):
            key = "start" if self.start else "goal"
            words = f"{key} is of one part, and this says of several: give {key}s"
            raise ValueError(words)
        return self

    @property
    def sources(self) -> tuple[str, ...]:
        """The sources that it comes from, in their order."""
        own = self.source or ()
        return (own,) if isinstance(own, str) else own

    @property
    def several(self) -> bool:
        """Whether it stands for parts that are alike."""
        return self.count is not None or bool(self.starts) or bool(self.goals)

    @property
    def mass_is_given(self) -> bool:
        """Whether it is known what it weighs."""
        return self.mass_kg > 0.0 or self.density_kg_m3 is not None


class PartGripSection(Section):
    """Rules for the grips on one part, in place of those of the assembly.

    Attributes:
        positions: places along the longest edge of a part.
        end_margin_m: distance of the outermost place from the end.
        opening_m: widest edge that fits between the fingers.
        depth_m: how far the tool frame goes below the face it comes from, at most to the
            middle of the part.
        directions: directions in the world along which the tool may point.
        steepest_deg: largest angle between the tool and the nearest of them.
        tilts_deg: leanings of the tool about the axis along which its fingers close.
        around_deg: step in which the tool is turned about a bar, and about the direction in
            which it closes on a mesh.
        finger_width_m: width of the fingers, across the direction in which they close.
        finger_depth_m: room that an open finger takes beside a part that is no box.
        suction: whether parts are held by suction, with the tool frame at a face.
        cup_m: radius of the spot that must be flat then; default: that of the cup that the shapes of
            the tool tell, 0.01 where they do not.
    """

    positions: Positions | None = None
    end_margin_m: Margin | None = None
    opening_m: Distance | None = None
    depth_m: Distance | None = None
    directions: Several[Direction] | None = None
    steepest_deg: Steepest | None = None
    tilts_deg: Several[Tilt] | None = None
    around_deg: Around | None = None
    finger_width_m: Distance | None = None
    finger_depth_m: Distance | None = None
    suction: bool | None = None
    cup_m: Distance | None = None


class GripSection(PartGripSection):
    """Rules for the grips that are tried.

    Attributes:
        frame: tool frame; its z axis points out of the hand, its fingers close along y.
        close_s: time that a tool takes to close on a part, or suction to hold it: a number or a
            distribution; for tools that do not say it; default: 0.4, and 0.2 for suction.
        open_s: time that a tool takes to let go, likewise.
    """

    positions: Positions = 5
    end_margin_m: Margin = 0.02
    opening_m: Distance = 0.04
    depth_m: Distance = 0.03
    directions: Several[Direction] = ((0.0, 0.0, -1.0),)
    steepest_deg: Steepest = 60.0
    tilts_deg: Several[Tilt] = (0.0,)
    around_deg: Around = 45.0
    finger_width_m: Distance = 0.02
    finger_depth_m: Distance = 0.01
    suction: bool = False
    frame: Name = "tool"
    close_s: ActuationTime | None = None
    open_s: ActuationTime | None = None


class ProcessSection(Section):
    """A process that robots do at parts, fixtures or places of the world, or machines at parts.

    The tool comes to a frame with its own z axis opposite to the frame's, straight along it, then
    follows the path if there is one, and stays or moves for as long as the process takes. A machine
    works at a part where that lies, and no robot is needed.

    Attributes:
        duration: how long it takes, from when the tool is there until it goes back;
            ``execution.skills`` may say another.
        machine: name of the machine that does it.
        unattended: whether nobody does it, such as glue that cures: any number of parts at once.
        tool: name of the tool that a robot must have; any when not given.
        frame: tool frame that comes to the place.
        approach_m: straight way to the place, and back from it.
        path: poses in the frame of the place that the tool goes through in straight lines, z
            pointing out of the surface; the first is where it comes to, the last where it leaves.
        turn_deg: turn of the tool about the frame's z axis; any when not given.
        turns: how many turns are tried where any will do.
        distance_m: how far in front of itself the tool works, such as a camera.
    """

    duration: AnyDuration | None = None
    machine: Name | None = None
    unattended: bool = False
    tool: Name | None = None
    frame: Name = "tool"
    approach_m: Distance = 0.05
    path: tuple[PoseSection, ...] = ()
    turn_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    turns: Annotated[int, Field(ge=1, le=72)] = 8
    distance_m: Annotated[float, Field(ge=0, le=10)] = 0.0

    not_both = (("machine", "unattended"),)

    @model_validator(mode="after")
    def _of_robots_or_not(self) -> ProcessSection:
        if self.without_robot:
            of_robots = ("tool", "frame", "approach_m", "path", "turn_deg", "turns")
            for key in (*of_robots, "distance_m"):
                if getattr(self, key) != type(self).model_fields[key].default:
                    raise ValueError(f"{key} is of a robot, and no robot does this")
        return self

    @property
    def without_robot(self) -> bool:
        """True if a machine does it, or nobody."""
        return self.machine is not None or self.unattended


class PlaceOfWork(Section):
    """Where a process is done, or a part is put down: a frame of a part, a fixture or the world.

    Attributes:
        part: part to which it belongs.
        fixture: fixture to which it belongs; the world where neither is given.
        frame: name of one of the frames of that part or fixture.
        pose: a pose in that frame, or in the frame of the part, of the fixture or of the world.
        grid: places there, taken by one product after another.
    """

    part: Name | None = None
    fixture: Name | None = None
    frame: Name | None = None
    pose: PoseSection | None = None
    grid: FixedGrid | None = None

    not_both = (("part", "fixture"),)

    @model_validator(mode="after")
    def _known_frame(self) -> PlaceOfWork:
        if self.frame is not None and self.part is None and self.fixture is None:
            raise ValueError(
                "of which part or fixture is this frame? Give part or fixture, or a pose in the"
                " world"
            )
        return self


class StepSection(Section):
    """A step: a part is put somewhere, or a process is done.

    Attributes:
        place: name of the part that is put in its place.
        process: name of the process that is done.
        at: where it is done; for a part, where it is put down on its way: its frame comes there.
        name: what other steps call it in ``after``; the name of the part that it puts in place.
        after: names of steps that must be complete before its part is put down, or its process
            begins; in place of a name, a mapping says how long after that at least, and at most.
        robots: who may do it; anyone when not given.
        hold: part that another robot grips, where it lies, for as long as this is done.
        until: name of a later step; whoever places the part keeps hold of it until that one is
            complete. What a later step joins, and would fall without, is kept hold of anyway.
        variants: names of the variants of products that it is of; all when not given.
        path: of this step, in place of that of the process.
        turn_deg: of this step, in place of that of the process.
    """

    place: Name | None = None
    process: Name | None = None
    at: PlaceOfWork | None = None
    name: Name | None = None
    after: tuple[AfterSection | Name, ...] = ()
    robots: Several[Name] | None = None
    hold: Name | None = None
    until: Name | None = None
    variants: Several[Name] | None = None
    path: tuple[PoseSection, ...] | None = None
    turn_deg: Annotated[float, Field(ge=-360, le=360)] | None = None

    @model_validator(mode="after")
    def _place_or_process(self) -> StepSection:
        if (self.place is None) == (self.process is None):
            raise ValueError("give place, the name of a part, or process, not both")
        if self.process is not None and self.at is None:
            raise ValueError(
                f"where is {self.process} done? Give at: {{part: NAME, frame: NAME}}"
            )
        if self.process is not None and self.until is not None:
            raise ValueError(
                "until is of a step that places a part: a process holds nothing; hold: PART lets"
                " another robot hold one meanwhile"
            )
        if self.until is not None and self.at is not None:
            raise ValueError(
                "until is of a step that puts its part in its place, and this one puts it down on its"
                " way"
            )
        for key in ("path", "turn_deg"):
            if self.place is not None and getattr(self, key) is not None:
                raise ValueError(f"{key} is of a process, and this step places a part")
        return self

    @property
    def follows(self) -> tuple[AfterSection, ...]:
        """The steps after which it comes."""
        own = (AfterSection(step=x) if isinstance(x, str) else x for x in self.after)
        return tuple(own)

    @property
    def known_as(self) -> str | None:
        """What other steps call it."""
        return self.name or (self.place if self.at is None else None)


def _step_spelt_out(step: Any) -> Any:
    """Return a step in full: a name alone is that of a part to be placed."""
    return {"place": step} if isinstance(step, str) else with_tuples(step)


Step = Annotated[
    StepSection,
    BeforeValidator(_step_spelt_out, json_schema_input_type=StepSection | Name),
]


class PartsSection(AssemblySection):
    """Parts, where they go, what is done to them, and in which order.

    Attributes:
        kind: ``assembly``.
        parts: everything that can be handled; one entry may stand for several that are alike.
        sources: where parts come from that have no ``start`` of their own, by name.
        products: how many products are made, one after another; one when not given.
        processes: what robots do besides placing parts, and what machines do, by name.
        machines: what works at parts without a robot, by name.
        changeovers: what has to be done between products of different variants.
        steps: names of parts that are put in place, and steps in full; where the order is found,
            all parts with a goal when not given.
        order: ``listed`` does the steps in their order, ``find`` in one that is found.
        approach_m: straight way towards a part before it is gripped, and straight down with
            it before it is put in place.
        leave_m: straight way up with a part, and back from it once it is in place.
        touch_m: parts nearer to each other than this touch: the later one waits for the
            earlier one.
        grips: which grips are tried.
        balance: friction under which everything must stand after every step.
        joined: pairs of parts, or of a part and a fixture, that are joined.
        joined_overlap_m: deepest that these may be in each other in their places, such as bars
            that meet in a node; only rounding when not given.
        fits: pairs of parts, or of a part and a fixture, that are pressed into each other.
    """

    kind: Literal["assembly"]
    parts: Several[PartSection]
    sources: dict[Name, SourceSection] = Field(default_factory=dict)
    products: ProductsSection | None = None
    processes: dict[Name, ProcessSection] = Field(default_factory=dict)
    machines: dict[Name, MachineSection] = Field(default_factory=dict)
    changeovers: tuple[ChangeoverSection, ...] = ()
    steps: Several[Step] = ()
    order: Literal["listed", "find"] = "listed"
    approach_m: Distance = 0.06
    leave_m: Distance = 0.06
    touch_m: Annotated[float, Field(gt=0, le=0.05)] = 0.002
    grips: GripSection = GripSection()
    balance: BalanceSection = BalanceSection()
    joined: tuple[JoinedParts, ...] = ()
    joined_overlap_m: Annotated[float, Field(ge=0, le=0.05)] = 0.0
    fits: tuple[FitSection, ...] = ()

    @model_validator(mode="after")
    def _has_steps(self) -> PartsSection:
        if self.steps:
            return self
        if self.order != "find":
            raise ValueError(
                "key 'steps' is missing: name the parts in the order in which they are put in"
                " place, or write 'order: find'"
            )
        found = tuple(
            StepSection(place=part.name)
            for part in self.parts
            if part.goal or part.goals
        )
        if not found:
            raise ValueError("no part has a 'goal', so nothing is put in place")
        # Sections do not change once they are made; this one is being made.
        object.__setattr__(self, "steps", found)
        return self

    @model_validator(mode="after")
    def _with_best_order(self) -> PartsSection:
        if self.products is not None and self.products.order == "best":
            names = self.products.variants
            try:
                changes = [[self._seconds_between(a, b) for b in names] for a in names]
            except ScenarioError as error:
                words = "order: best needs durations of changeovers without files"
                raise ValueError(f"{words}: {error}") from None
            self.products.set_changes(tuple(map(tuple, changes)))
            self.products.sequence(1)  # ValueError: too much to be compared
        return self

    def _seconds_between(self, before: str, after: str) -> float:
        """Return the longest mean duration of the changeovers between two variants [s]."""
        both, means = (self.of_variant(before), self.of_variant(after)), [0.0]
        for item in self.changeovers:
            time = item.between(before, after)
            if time is not None and all(own.steps_at(item.machine)[0] for own in both):
                means.append(time.mean)
        return max(means)

    @property
    def placed(self) -> tuple[str, ...]:
        """Names of the parts that are put in place, in the order of the steps."""
        return tuple(step.place for step in self.steps if step.place and not step.at)

    @property
    def taken(self) -> tuple[str, ...]:
        """Names of these parts in the order in which they are taken first."""
        return tuple(dict.fromkeys(step.place for step in self.steps if step.place))

    def steps_of(self, variant: str) -> tuple[int, ...]:
        """Return the indices of the steps of a variant, from 0."""
        steps = enumerate(self.steps)
        return tuple(k for k, own in steps if variant in (own.variants or (variant,)))

    def of_variant(self, variant: str) -> PartsSection:
        """Return the assembly with the steps of one variant, and what they refer to."""
        if not self.products or not self.products.variants:
            return self
        steps = [self.steps[k] for k in self.steps_of(variant)]
        known = {step.known_as for step in steps}
        others = {*self.placed} - {step.place for step in steps}
        return self.changed(
            steps=tuple(
                step.changed(
                    after=tuple(x for x in step.follows if x.step in known),
                    until=step.until if step.until in known else None,
                )
                for step in steps
            ),
            joined=tuple(
                joint
                for joint in self.joined
                if others.isdisjoint(joint.parts) and joint.by in {None, *known}
            ),
            fits=tuple(fit for fit in self.fits if others.isdisjoint(fit.parts)),
        )

    def machine_of(self, step: StepSection) -> MachineSection | None:
        """Return the machine that works at the part of a step; None for other steps."""
        process = self.processes.get(step.process or "")
        return self.machines.get(process.machine or "") if process else None

    def steps_at(self, machine: str | None) -> tuple[list[int], list[int]]:
        """Return the steps that first and last concern a machine, or all of them without one, from 1.

        They put a part down where it works, and take it on from there; where it works at a part in its place, they
        are the work itself.
        """
        if machine is None:
            steps = list(range(1, len(self.steps) + 1))
            return steps, steps
        begin, end = list[int](), list[int]()
        for k, step in enumerate(self.steps):
            process = self.processes.get(step.process or "")
            if process is None or process.machine != machine or step.at is None:
                continue
            moves = [n for n, own in enumerate(self.steps) if own.place == step.at.part]
            put = max((n for n in moves if n < k), default=k)
            begin.append((k if self.steps[put].at is None else put) + 1)
            end.append(min((n for n in moves if n > k), default=k) + 1)
        return begin, end
