"""Assemblies of parts as data: where every part goes, the steps in order, and the grips on it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from planning.cell.robot_model import ToolGrip
from planning.contacts.precedence import Overlaps
from planning.statics.standing import BalanceRules, Joint
from planning.tasks.work import Supply
from planning.transforms import Array, Transform, readonly


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
class StopOnTheWay:
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
class PlacePart(Step):
    """A part is picked where it is by then and put in its place, or down on its way.

    Attributes:
        part: its name.
        stop: where it is put down on its way, None where it comes to its place.
        until: name of the step until which is complete its robot keeps hold of it, None to let
            go of it at once, or when nothing falls any more.
    """

    part: str
    stop: StopOnTheWay | None = None
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


AnyStep = PlacePart | Work | MachineWork


def placed_parts(steps: Sequence[Step]) -> tuple[str, ...]:
    """Return the names of the parts that are put in their places, in the order of the steps."""
    return tuple(
        step.part for step in steps if isinstance(step, PlacePart) and step.stop is None
    )


def moves_on(steps: Sequence[Step]) -> set[str]:
    """Return the names of the parts that are put down on their way, and taken on from there."""
    return {s.part for s in steps if isinstance(s, PlacePart) and s.stop is not None}


DOWN = (0.0, 0.0, -1.0)
"""The direction of a tool that points straight down, in the world."""

UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class GripRules:
    """Rules for the grips that are tried.

    A tool frame's z axis points out of the hand and its fingers close along y.

    Attributes:
        frame: name of the tool frame, a key of ``RobotModel.frames``.
        positions: number of places along a part's longest edge.
        end_margin: distance of the outermost place from the end of the part [m].
        opening: widest edge that fits between the fingers [m].
        least_opening: narrowest that they hold [m].
        depth: how far the tool frame goes below the face it comes from; never beyond the
            middle of the part [m].
        directions: unit vectors in the world along which the tool may point, each (3,).
        steepest: largest angle between the tool and the nearest of them, where a part is
            picked and where it is placed [rad].
        tilts: leanings of the tool about the axis along which its fingers close [rad].
        around: step in which the tool is turned about a bar, and about the direction in which it
            closes on a mesh [rad].
        finger_width: of the fingers, along x [m].
        finger_depth: how much room a finger takes beside a part when it is open, along y [m].
        suction: whether the tool holds by suction, with its frame at the face.
        cup: radius of the spot that must be flat then [m].
    """

    frame: str = "tool"
    positions: int = 5
    end_margin: float = 0.02
    opening: float = 0.04
    depth: float = 0.03
    directions: tuple[tuple[float, float, float], ...] = (DOWN,)
    steepest: float = float(np.radians(60.0))
    tilts: tuple[float, ...] = (0.0,)
    around: float = float(np.radians(45.0))
    finger_width: float = 0.02
    finger_depth: float = 0.01
    suction: bool = False
    cup: float = 0.01
    least_opening: float = 0.0


@dataclass(frozen=True)
class PartHandling:
    """Grips of a part, and its straight ways out of where it lies and into its place.

    Attributes:
        grips: which grips are tried.
        approach: way straight towards it before it is gripped, and along the insertion before
            it is in place [m].
        leave: way straight out with it after it is gripped, and straight back from it after it
            is put in place [m].
        insertion: direction in the world in which it is led into its place, of length one.
        extraction: direction in which it is led out of where it lies, of length one.
    """

    grips: GripRules
    approach: float
    leave: float
    insertion: tuple[float, float, float] = DOWN
    extraction: tuple[float, float, float] = UP


@dataclass(frozen=True)
class PartAssembly:
    """An assembly of parts: goal poses of parts, and the steps in order.

    Attributes:
        goals: pose in the world of the frame of every part that is placed, of boxes the centre.
        steps: what is done, in this order.
        approach: way straight towards a part before it is gripped, and straight down with it
            before it is put in place [m].
        leave: way straight up with a part after it is gripped, and straight back from it after
            it is put in place [m].
        touch: parts that are nearer to each other than this touch [m].
        grips: which grips are tried.
        balance: friction and joints under which it must stand; None if that is not looked at.
        overlaps: how deep parts that are joined may be in each other.
        own_handling: of the parts that are handled in another way than this says, by name.
        supply: what comes up and leaves meanwhile.
    """

    goals: Mapping[str, Transform]
    steps: tuple[AnyStep, ...]
    approach: float = 0.06
    leave: float = 0.06
    touch: float = 0.002
    grips: GripRules = field(default_factory=GripRules)
    balance: BalanceRules | None = None
    overlaps: Overlaps = field(default_factory=Overlaps)
    supply: Supply = field(default_factory=Supply)
    own_handling: Mapping[str, PartHandling] = field(default_factory=dict)

    def handling(self, part: str) -> PartHandling:
        """Return how a part is gripped and led."""
        return self.own_handling.get(part) or PartHandling(
            self.grips, self.approach, self.leave
        )

    @property
    def placed(self) -> tuple[str, ...]:
        """Names of the parts that are placed, in the order of the steps."""
        return placed_parts(self.steps)

    @property
    def joints(self) -> tuple[Joint, ...]:
        """What is joined, where it is looked at what stands."""
        return tuple(item.joint for item in self.balance.joined) if self.balance else ()

    def joined_to(self, part: str) -> tuple[str, ...]:
        """Return what a part is joined to: it may touch nothing of what is there before it."""
        found = (joint.ends for joint in self.joints if part in joint.ends)
        return tuple(a if b == part else b for a, b in found)


_AXES = "xyz"


@dataclass(frozen=True)
class Grip:
    """A grip on a part.

    Attributes:
        pose: of the tool frame in the frame of the part.
        words: what it is, for messages.
        tool: how the tool that it is for holds; None for tools of which nothing is known.
    """

    pose: Transform
    words: str
    tool: ToolGrip | None = None


def box_grips(
    size: Array, start: Transform, goal: Transform, rules: GripRules
) -> list[Grip]:
    """Return the grips with which a box can be taken up and put down.

    The tool points into a face, its fingers close on the two faces beside it, and it may lean
    about the closing axis. What is left are grips whose tool points in a wanted direction both
    where the box is picked and where it is placed, and whose fingers span the box. Places
    nearest to the middle come first.

    Args:
        size: edge lengths, shape (3,) [m].
        start, goal: poses of the box centre in the world.
        rules: which grips are tried.
    """
    longest = int(np.argmax(size))
    out: list[tuple[float, Grip]] = []
    for face, sign, closing, turned in _holds(size, rules):
        along = 3 - face - closing
        for offset, tilt in product(
            _offsets(size, rules) if along == longest else [0.0],
            dict.fromkeys(rules.tilts),
        ):
            pose = np.eye(4)
            pose[:3, :3] = _tool_axes(face, sign, closing, turned) @ _about_y(tilt)
            if not all(points_well(pose, box, rules) for box in (start, goal)):
                continue
            pose[along, 3] = offset
            # From the middle towards the face that the tool comes from.
            pose[face, 3] = sign * max(0.0, 0.5 * size[face] - rules.depth)
            side = f"{'+' if sign > 0 else '-'}{_AXES[face]}"
            words = f"grip {offset * 1e3:+.0f} mm from {side}"
            words += " turned" if turned else ""
            words += f" leaning {np.degrees(tilt):+.0f} deg" if tilt else ""
            out.append((abs(offset), Grip(readonly(pose), words)))
    return [grip for _, grip in sorted(out, key=lambda entry: round(entry[0], 9))]


def _offsets(size: Array, rules: GripRules) -> list[float]:
    """Return the places along the longest edge [m]."""
    reach = max(0.0, 0.5 * float(size.max()) - rules.end_margin)
    if rules.positions == 1 or reach == 0.0:
        return [0.0]
    return [float(at) for at in np.linspace(-reach, reach, rules.positions)]


def _holds(size: Array, rules: GripRules) -> Iterator[tuple[int, int, int, bool]]:
    """Yield face axis, its sign, closing axis, and whether the fingers are turned round."""
    for face, sign, closing, turned in product(range(3), (1, -1), range(3), (0, 1)):
        if face != closing and rules.least_opening <= size[closing] <= rules.opening:
            yield face, sign, closing, bool(turned)


def _tool_axes(face: int, sign: int, closing: int, turned: bool) -> Array:
    """Return the tool's axes in the box frame: z into the face, y along the closing axis."""
    z, y = np.zeros(3), np.zeros(3)
    z[face] = -sign
    y[closing] = -1.0 if turned else 1.0
    return np.column_stack([np.cross(y, z), y, z])


def _about_y(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def points_well(grip: Transform, box: Transform, rules: GripRules) -> bool:
    """Return whether the tool points along one of the wanted directions."""
    pointing = box[:3, :3] @ grip[:3, 2]
    nearest = max(float(np.dot(pointing, wanted)) for wanted in rules.directions)
    return nearest >= math.cos(rules.steepest) - 1e-9
