"""Assemblies of parts as data: goal poses, ordered steps, and straight insertion paths."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias, Union

from planning.contacts.interference import Overlaps
from planning.grips.grip import DOWN, UP, GripRules
from planning.parts.supply import Supply
from planning.statics.standing_rules import Joint, StandingRules
from planning.transforms import Transform

AnyStep: TypeAlias = Union["PlacePart", "Work", "MachineWork"]
"""A step of an assembly of parts."""


@dataclass(frozen=True)
class Spot:
    """A place where a part is put down temporarily, or where a process is done.

    Attributes:
        words: where, for people, such as ``"vise/nest"``.
        owner: name of the fixture or part that it belongs to, None for the world.
        frame: name of a frame of that fixture, None for the fixture's own, and of parts.
        pose: of the place in that frame, in the part's own, or in the world.
    """

    words: str
    owner: str | None
    frame: str | None
    pose: Transform


@dataclass(frozen=True, kw_only=True)
class Step(ABC):
    """A step of an assembly of parts.

    Attributes:
        name: what other steps call it, None if they cannot.
        after: names of the steps that must be complete before it.
        lags: least and greatest times after some of them.
        robots: the robots that may do it, None for any.
        hold: part that another robot grips where it lies meanwhile, None for nothing.
    """

    name: str | None = None
    after: tuple[str, ...] = ()
    lags: tuple[TimeLag, ...] = ()
    robots: tuple[str, ...] | None = None
    hold: str | None = None

    @property
    @abstractmethod
    def words(self) -> str:
        """Description for people."""

    def done_by(self, robot: str) -> bool:
        """Tell whether a robot may do it."""
        return self.robots is None or robot in self.robots


@dataclass(frozen=True, kw_only=True)
class PlacePart(Step):
    """A part is picked at its current place and put in its final place, or down temporarily.

    Attributes:
        part: its name.
        stop: where it is put down temporarily, None where it is put in its place.
        until: name of the step until which is complete its robot keeps holding it, None to let
            go of it at once, or when nothing falls any more.
    """

    part: str
    stop: Spot | None = None
    until: str | None = None

    @property
    def words(self) -> str:
        """Description for people."""
        way = "" if self.stop is None else f" at {self.stop.words}"
        return f"pick and place {self.part}{way}"


@dataclass(frozen=True)
class Process:
    """A process of one robot, such as screwing: the tool motion at a workplace.

    Attributes:
        name: its name, the kind of the tasks in which it is done.
        tool: name of the tool that a robot must have, None for any.
        frame: name of the tool frame that comes to the place, its z axis opposite to the
            place's.
        approach: straight path along that axis to the place and back [m].
        path: poses in the frame of the place that the tool goes through, in straight lines; the
            place itself where there are none.
        turns: angles by which the tool may be turned about the place's z axis; one of them is
            chosen [rad].
    """

    name: str
    tool: str | None = None
    frame: str = "tool"
    approach: float = 0.05
    path: tuple[Transform, ...] = ()
    turns: tuple[float, ...] = (0.0,)


@dataclass(frozen=True, kw_only=True)
class Work(Step):
    """A process is done at a frame of a part, of a fixture or of the world.

    Attributes:
        process: what is done.
        spot: where; its z axis points out of the surface.
    """

    process: Process
    spot: Spot

    @property
    def words(self) -> str:
        """Description for people."""
        return f"{self.process.name} {self.spot.words}"


@dataclass(frozen=True, kw_only=True)
class MachineWork(Step):
    """Work of a machine on parts at rest, or a waiting time: no robot is needed.

    Attributes:
        process: what is done, the kind of its task.
        machine: the chain whose task it is.
        parts: what is worked at; several are a batch. The first is the object of the task.
        door: object that is there for as long as it works and keeps robots out, None for none.
    """

    process: str
    machine: str
    parts: tuple[str, ...]
    door: str | None = None

    @property
    def part(self) -> str:
        """The object of the task."""
        return self.parts[0]

    @property
    def words(self) -> str:
        """Description for people."""
        others = len(self.parts) - 1
        return f"{self.process} {self.part}" + (f" and {others} more" if others else "")


@dataclass(frozen=True)
class PartHandling:
    """Grips of a part, and its straight paths out of its start and into its place.

    Attributes:
        grips: which grips are tried.
        approach: way straight towards it before it is gripped, and along the insertion before
            it is in place [m].
        leave: way straight out with it after it is gripped, and straight back from it after it
            is put in place [m].
        insertion: direction in the world in which it is led into its place, of length one.
        extraction: direction in which it is led out of where it lies, of length one.
    """

    grips: GripRules = field(default_factory=GripRules)
    approach: float = 0.06
    leave: float = 0.06
    insertion: tuple[float, float, float] = DOWN
    extraction: tuple[float, float, float] = UP


@dataclass(frozen=True)
class PartAssembly:
    """An assembly of parts: goal poses of parts, and the steps in order.

    Attributes:
        goals: pose in the world of the frame of every part that is placed, of boxes the centre.
        steps: what is done, in this order.
        usual: how parts are gripped and led.
        own: handling of the parts that differ, by name.
        touch: parts that are nearer to each other than this touch [m].
        balance: friction and joints under which it must stand; None if that is not looked at.
        overlaps: how deep parts that are joined may be in each other.
        supply: what comes up and leaves meanwhile.
        alike: groups of parts any of which may go where another one of its group has its goal; those
            without a goal stay where they are.
        returns: whether robots end with the tools that they have at the start, as the plan is repeated.
    """

    goals: Mapping[str, Transform]
    steps: tuple[AnyStep, ...]
    usual: PartHandling = field(default_factory=PartHandling)
    own: Mapping[str, PartHandling] = field(default_factory=dict)
    touch: float = 0.002
    balance: StandingRules | None = None
    overlaps: Overlaps = field(default_factory=Overlaps)
    supply: Supply = field(default_factory=Supply)
    alike: tuple[tuple[str, ...], ...] = ()
    returns: bool = False

    def handling(self, part: str) -> PartHandling:
        """Return the grips and straight paths of a part."""
        return self.own.get(part, self.usual)

    def lags_after(self, name: str | None) -> tuple[TimeLag, ...]:
        """Return the minimum time lags after a step, each with a machine of its own."""
        lags = (lag for step in self.steps for lag in step.lags)
        return tuple(lag for lag in lags if lag.step == name and lag.machine)

    @property
    def friction(self) -> float:
        """Coefficient of friction of all contacts."""
        return (self.balance or StandingRules()).friction

    @property
    def frame(self) -> str:
        """Name of the tool frame with which all parts are gripped."""
        return self.usual.grips.frame

    @property
    def placed(self) -> tuple[str, ...]:
        """Names of the placed parts, in the order of the steps."""
        places = (step for step in self.steps if isinstance(step, PlacePart))
        return tuple(step.part for step in places if step.stop is None)

    @property
    def joints(self) -> tuple[Joint, ...]:
        """Joints between parts, where stability is checked."""
        return self.balance.joints if self.balance else ()

    def joined_to(self, part: str) -> tuple[str, ...]:
        """Return the parts that a part is joined to; a joined part needs no contact."""
        found = (joint.ends for joint in self.joints if part in joint.ends)
        return tuple(a if b == part else b for a, b in found)


@dataclass(frozen=True)
class TimeLag:
    """Least and greatest time from an earlier step to the start of a step.

    Attributes:
        step: name of the earlier step.
        least: time that passes at least [s].
        most: time that may pass at most, None for any [s].
        machine: chain of the task that lasts for the least time, None where there is none to wait for.
    """

    step: str
    least: float = 0.0
    most: float | None = None
    machine: str | None = None
