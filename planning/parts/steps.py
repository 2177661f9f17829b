"""Steps of an assembly of parts: a part is put somewhere, a process is done, a machine works."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from planning.transforms import Transform


@dataclass(frozen=True, kw_only=True)
class Step(ABC):
    """A step of an assembly of parts.

    Attributes:
        name: what other steps call it, None if they cannot.
        after: names of the steps that must be complete before it.
        robots: who may do it, None for anyone.
        hold: part that another robot grips where it lies meanwhile, None for nothing.
    """

    name: str | None = None
    after: tuple[str, ...] = ()
    robots: tuple[str, ...] | None = None
    hold: str | None = None

    @property
    @abstractmethod
    def words(self) -> str:
        """What it is, for people."""

    def done_by(self, robot: str) -> bool:
        """Tell whether a robot may do it."""
        return self.robots is None or robot in self.robots


@dataclass(frozen=True)
class Stop:
    """A place where a part is put down on its way, such as the nest of a machine.

    Attributes:
        at: where, for people, such as ``"vise/nest"``.
        fixture: name of the fixture that ``pose`` belongs to, None for the world.
        frame: name of a frame of that fixture, None for the fixture's own.
        pose: of the frame of the part there.
    """

    at: str
    fixture: str | None
    frame: str | None
    pose: Transform


@dataclass(frozen=True, kw_only=True)
class Place(Step):
    """A part is picked where it is by then and put in its place, or down on its way.

    Attributes:
        part: its name.
        stop: where it is put down on its way, None where it comes to its place.
        until: name of the step until which is complete its robot keeps hold of it, None to let
            go of it at once, or when nothing falls any more.
    """

    part: str
    stop: Stop | None = None
    until: str | None = None

    @property
    def words(self) -> str:
        """What it is, for people."""
        way = "" if self.stop is None else f" at {self.stop.at}"
        return f"pick and place {self.part}{way}"


@dataclass(frozen=True)
class Process:
    """A process of one robot, such as screwing: what its tool does at a place of work.

    Attributes:
        name: its name, the kind of the tasks in which it is done.
        tool: name of the tool that a robot must have, None for any.
        frame: name of the tool frame that comes to the place, its z axis opposite to the
            place's.
        approach: straight way along that axis to the place and back [m].
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
        at: where, for people, such as ``"cover/hole"``.
        owner: name of the part or fixture that the frame belongs to, None for the world.
        frame: name of a frame of that fixture, None for the fixture's own, and of parts.
        pose: of the place of work in that frame, in the part's own frame, or in the world.
    """

    process: Process
    at: str
    owner: str | None
    frame: str | None = None
    pose: Transform

    @property
    def words(self) -> str:
        """What it is, for people."""
        return f"{self.process.name} {self.at}"


@dataclass(frozen=True, kw_only=True)
class MachineWork(Step):
    """A machine works at a part where it lies, or time alone does: no robot is needed.

    Attributes:
        process: what is done, the kind of its task.
        machine: the chain whose task it is.
        part: what is worked at.
        door: object that is there for as long as it works and keeps robots out, None for none.
    """

    process: str
    machine: str
    part: str
    door: str | None = None

    @property
    def words(self) -> str:
        """What it is, for people."""
        return f"{self.process} {self.part}"


AnyStep = Place | Work | MachineWork


def placed_parts(steps: Sequence[Step]) -> tuple[str, ...]:
    """Return the names of the parts that are put in their places, in the order of the steps."""
    return tuple(
        step.part for step in steps if isinstance(step, Place) and step.stop is None
    )


def moves_on(steps: Sequence[Step]) -> set[str]:
    """Return the names of the parts that are put down on their way, and taken on from there."""
    return {s.part for s in steps if isinstance(s, Place) and s.stop is not None}
