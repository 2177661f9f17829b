"""Expected results of a run: final places of objects, their supports, and processes.

They come from the scenario, so the audit does not take them from the plan that it checks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from planning.cell.robot_model import ToolGrip
from planning.statics.standing_rules import StandingRules
from planning.transforms import Transform
from twin.registry import EXPECTATIONS
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario

TOUCH = 0.002
"""What is nearer than this touches, where the scenario says nothing else [m]."""

Hold = Literal["weight", "studs", "joints"]
"""What keeps an object at rest: it lies on others, its studs hold it from either side, or
whatever it touches."""


@dataclass(frozen=True, eq=False)
class Place:
    """Place where an object must be at the end.

    Attributes:
        words: description for messages.
        pose: of the object's centre in the world.
        kind: of the object.
        object: its name; None if any of its kind will do, turned by half a turn or not, or any of some.
        any_of: names of those any of which will do, if that is not all of the kind.
        held: whether another robot must hold its counterpart meanwhile.
        temporary: whether it only helps there, and is no part of what is built.
        name: of the step that puts it there, where others refer to it.
        after: names of the steps that must be complete before that.
    """

    words: str
    pose: Transform
    kind: str
    object: str | None = None
    held: bool = False
    temporary: bool = False
    name: str | None = None
    after: tuple[str, ...] = ()
    any_of: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class ExpectedProcess:
    """A process that must be done once.

    Attributes:
        words: description for messages.
        process: its name, the kind of its task.
        owner: object in whose frame ``pose`` is, None for the world.
        pose: of the place.
        path: poses in the frame of the place that the tool comes to, in order.
        frame: tool frame that does.
        robots: the robots that may do it, None for any.
        tool: mounted tool that is required of a robot with several, None for any.
        hold: object that another robot holds meanwhile, None for nothing.
        name: of the step, where others refer to it.
        after: names of the steps that must be complete before it.
        step: its number, where a plan may begin after it.
    """

    words: str
    process: str
    owner: str | None
    pose: Transform
    path: tuple[Transform, ...]
    frame: str = "tool"
    robots: tuple[str, ...] | None = None
    tool: str | None = None
    hold: str | None = None
    name: str | None = None
    after: tuple[str, ...] = ()
    step: int | None = None


@dataclass(frozen=True, eq=False)
class ExpectedRest:
    """Intermediate rest of a part: on its path, or during a process without a robot.

    Attributes:
        words: description for messages.
        part: its name.
        pose: where it lies, in the world.
        process: what is done to it there meanwhile, the kind of the task; None for nothing.
        machine: the machine that does it, None for none.
        name: of the step, where others refer to it.
        after: names of the steps that must be complete before it.
        step: its number, from 1.
    """

    words: str
    part: str
    pose: Transform
    process: str | None = None
    machine: str | None = None
    name: str | None = None
    after: tuple[str, ...] = ()
    step: int = 0


@dataclass(frozen=True, eq=False)
class ChangedTool:
    """A tool that a robot takes from its rack and returns to it.

    Attributes:
        name: of the tool, and of the object that it is.
        robot: whose tool it is.
        mount: pose of it in the flange frame when it is mounted.
        rack: pose of it in the world where it lies in its rack.
        grip: kind of grip; None where not stated.
        first: whether it is mounted at the start.
    """

    name: str
    robot: str
    mount: Transform
    rack: Transform
    grip: ToolGrip | None = None
    first: bool = False


@dataclass(frozen=True)
class Expectations:
    """Expectations of a scenario on the end of a run and on its intermediate states.

    Attributes:
        places: of all that is put somewhere; any order.
        hold: what keeps objects at rest.
        touch_m: what is nearer than this touches, between named objects in their places and
            fixtures; ``TOUCH`` for others, and at least [m].
        opening_m: how far fingers stand open in the geometry of tools: they close on what they
            hold from there; 0 for tools that do not close [m].
        gripped_at: tool frame with which objects are gripped between pads that close along its y
            axis, or under a cup; None where tools hold in other ways, such as bricks by their studs.
        by_suction: objects that are held by suction by tools of which nothing is said.
        helpers: whether further objects may stay where they only help, such as temporary bricks.
        processes: that are to be done, in any order but for what they are to come after.
        joined: pairs of objects, or of an object and a fixture, that hold each other in their
            places, each with the room between the two [m].
        overlaps_m: how deep pairs of these, or others, may be in each other [m].
        rests: where parts lie on their way and are worked at without a robot, in order for each.
        doors: objects that machines hold, so that they rest on nothing.
        tools: that robots change; their racks hold them.
        keeps: by part, the name of the step until which is complete its robot keeps holding it.
        lags: least time that passes from the end of a step to the begin of a later one, by the names of the
            later and the earlier one [s].
        statics: friction and joints by which named objects in their places must always stand;
            None if that is not looked at.
    """

    places: tuple[Place, ...] = ()
    hold: Hold = "joints"
    touch_m: float = TOUCH
    opening_m: float = 0.0
    gripped_at: str | None = None
    by_suction: frozenset[str] = frozenset()
    helpers: bool = False
    processes: tuple[ExpectedProcess, ...] = ()
    joined: Mapping[frozenset[str], float] = field(default_factory=dict)
    overlaps_m: Mapping[frozenset[str], float] = field(default_factory=dict)
    rests: tuple[ExpectedRest, ...] = ()
    doors: frozenset[str] = frozenset()
    tools: tuple[ChangedTool, ...] = ()
    keeps: Mapping[str, str] = field(default_factory=dict)
    lags: Mapping[tuple[str, str], float] = field(default_factory=dict)
    statics: StandingRules | None = None

    def renamed(self, names: Mapping[str, str]) -> Expectations:
        """Return the expectations with objects renamed where others came to their places."""
        if all(name == own for name, own in names.items()):
            return self

        def of(name: str) -> str:
            return names.get(name, name)

        def maybe(name: str | None) -> str | None:
            return None if name is None else of(name)

        def pairs(given: Mapping[frozenset[str], float]) -> dict[frozenset[str], float]:
            return {frozenset(map(of, pair)): room for pair, room in given.items()}

        statics = self.statics
        if statics is not None:
            joints = (
                replace(j, first=of(j.first), second=of(j.second))
                for j in statics.joints
            )
            statics = replace(statics, joints=tuple(joints))
        return replace(
            self,
            places=tuple(replace(p, object=maybe(p.object)) for p in self.places),
            processes=tuple(
                replace(p, owner=maybe(p.owner), hold=maybe(p.hold))
                for p in self.processes
            ),
            by_suction=self.by_suction.union(map(of, self.by_suction)),
            joined=pairs(self.joined),
            overlaps_m=pairs(self.overlaps_m),
            keeps={of(n): step for n, step in self.keeps.items()},
            statics=statics,
        )

    def order(self) -> Iterator[tuple[str, str]]:
        """Yield pairs of steps of which the first must begin after the end of the second."""
        named = [(place.name, place.after) for place in self.places]
        named += [(process.name, process.after) for process in self.processes]
        for name, after in named:
            if name is not None:
                yield from ((name, before) for before in after)


def scenario_expectations(scenario: Scenario) -> Expectations:
    """Return the expectations of a scenario, none for a kind of assembly that states none."""
    name, kind = scenario.assembly.kind, assembly_kind(scenario.assembly)
    if name not in EXPECTATIONS:
        return Expectations()
    found: Expectations = EXPECTATIONS.load(name)(kind, scenario.cell)
    return found
