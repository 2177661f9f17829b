"""What a robot is to the dispatcher: it takes nodes that it is cleared for, and says how far it is.

A driver passes the nodes of its robot in their order and is at rest at the end of the last one that it has
been cleared for, whatever happens to whoever clears it. What it is cleared for is never taken back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from planning.tasks.task import Actuation
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph

Mode = Literal["standing", "moving", "held", "fault"]
"""What a robot does: it stands as it is cleared for no more, it moves, it is held, or it can do no more."""


@dataclass(frozen=True)
class ToolOrder:
    """What the tool of a robot that stands is to do, as another robot brings it something.

    Attributes:
        name: of the order; one of the same name is done once.
        act: ``close`` or ``open``.
        seconds: how long that takes as planned [s].
        object: what it is about.
    """

    name: str
    act: str
    seconds: float
    object: str = ""


@dataclass(frozen=True, eq=False)
class ClearedNode:
    """A node of a plan as its driver knows it.

    Attributes:
        node: its number among those of the robot.
        task: number of its task in the plan.
        kind: of the task: ``transit``, or the name of a skill.
        label: of the task, for people.
        waypoints: what is passed after the end of the node before, shape (w, n); joints in radians or metres.
        seconds: when each of them is passed as planned, since the node began, shape (w,) [s].
        act: what the tool does meanwhile: ``close``, ``open``, or nothing, which is empty.
        object: what the task is about, empty where there is nothing.
    """

    node: int
    task: int
    kind: str
    label: str
    waypoints: Array
    seconds: Array
    act: str = ""
    object: str = ""

    def passed_s(self, leg: int, share: float) -> float:
        """Return when a point of its path is passed as planned, since the node began [s].

        Args:
            leg: the leg that ends at the waypoint of that number.
            share: how far along it the point is, from 0 to 1.
        """
        begin = float(self.seconds[leg - 1]) if leg else 0.0
        return begin + share * (float(self.seconds[leg]) - begin)


def tool_order_of_node(
    tpg: TemporalPlanGraph, chain: int, node: int, acts: Mapping[int, Actuation]
) -> tuple[str, ToolOrder] | None:
    """Return which other robot's tool closes or opens in a node and how, None where none does."""
    own, act = tpg.chains[chain], acts.get(node)
    if act is None or act.robot == own.robot:
        return None
    about = tpg.tasks[int(own.task[node])].object or ""
    name = f"{own.robot}:{node}"
    return act.robot, ToolOrder(name, act.act, float(own.duration[node]), about)


def cleared_node(
    tpg: TemporalPlanGraph, chain: int, node: int, acts: Mapping[int, Actuation]
) -> ClearedNode:
    """Return a node of a plan as its driver knows it.

    One in which another robot's tool acts takes no time, as it is passed once that has been done.

    Args:
        tpg: the plan.
        chain, node: which one.
        acts: what tools do in which nodes of the chain, see ``actuation_nodes``.
    """
    own = tpg.chains[chain]
    rows = slice(int(own.first[node]), int(own.first[node + 1]))
    task, act = tpg.tasks[int(own.task[node])], acts.get(node)
    mine = act is not None and act.robot == own.robot
    seconds = own.fraction[rows] * own.duration[node]
    return ClearedNode(
        node,
        task.index,
        task.kind,
        task.label,
        own.waypoints[rows],
        seconds if act is None or mine else np.zeros_like(seconds),
        act.act if act is not None and mine else "",
        task.object or "",
    )


@dataclass(frozen=True, eq=False)
class Sample:
    """Where a robot was at one time.

    Attributes:
        at_s: when, by the clock of its driver [s].
        q: measured joint positions, shape (n,) [rad or m].
        begun, done: nodes that it had begun, and was through with, from its first one on.
    """

    at_s: float
    q: Array
    begun: int
    done: int


@dataclass(frozen=True, eq=False)
class DriverState:
    """How far a robot is.

    Attributes:
        begun: nodes that it has begun, from its first one on.
        done: nodes that it is through with.
        mode: what it does.
        q: measured joint positions, shape (n,) [rad or m].
        dq: measured joint speeds, shape (n,) [rad/s or m/s].
        off: greatest distance of a joint from the path since the last time [rad or m].
        failed: the node of a skill that has failed, -1 for none; the robot is back where that began.
        words: why it has failed or can do no more, for people.
        samples: where it was since the last time that it was asked, in order; none where only ``q`` is known.
        acted: name of the last order of its tool that is done, empty for none.
    """

    begun: int
    done: int
    mode: Mode
    q: Array
    dq: Array
    off: float = 0.0
    failed: int = -1
    words: str = ""
    samples: tuple[Sample, ...] = ()
    acted: str = ""


class Driver(Protocol):
    """A robot that executes nodes; its methods return at once."""

    def begin(self, start: Array, done: int) -> None:
        """Be told where the plan has it stand, after so many of its nodes.

        Args:
            start: joint positions, shape (n,).
            done: nodes that it need not do any more.
        """
        ...

    def take(self, nodes: list[ClearedNode]) -> None:
        """Take nodes that come after those that it has: it is cleared up to the last one.

        After a skill that failed they come after the first node of that, which counts as done.
        """
        ...

    def state(self) -> DriverState:
        """Return how far it is."""
        ...

    def act(self, order: ToolOrder) -> None:
        """Close or open the tool; the robot stands at the end of all that it has."""
        ...

    def hold(self, held: bool) -> None:
        """Stand as soon as it can, or go on."""
        ...

    def leave(self) -> None:
        """Stand, and let go of the robot; nothing more is asked of it."""
        ...
