"""Interface between the dispatcher and a robot driver, which executes released nodes and reports its progress.

A node is a piece of the planned motion of one robot. A driver executes the nodes of its robot in order and stops at the
end of the last released one, even if the dispatcher fails. A released node is never withdrawn.
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
"""Activity of a robot: at rest without further clearance, moving, held, or faulty."""


@dataclass(frozen=True)
class ToolOrder:
    """Tool action of a standing robot that another robot hands something.

    Attributes:
        name: of the order; one of the same name is done once.
        act: ``close`` or ``open``.
        seconds: how long that takes as planned [s].
        object: the handled object.
    """

    name: str
    act: str
    seconds: float
    object: str = ""


@dataclass(frozen=True, eq=False)
class ClearedNode:
    """A node of a plan, as sent to its driver.

    Attributes:
        node: its number among those of the robot.
        task: number of its task in the plan.
        kind: of the task: ``transit``, or the name of a skill.
        label: of the task, for people.
        waypoints: configurations after the end of the previous node, shape (w, n); joints in
            radians or metres.
        seconds: when each of them is passed as planned, since the node began, shape (w,) [s].
        act: tool action during the node: ``close``, ``open``, or empty for none.
        object: object of the task, empty without one.
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
        """Return the planned time of a point of its path, from the node's start [s].

        Args:
            leg: the leg that ends at the waypoint of that number.
            share: how far along it the point is, from 0 to 1.
        """
        begin = float(self.seconds[leg - 1]) if leg else 0.0
        return begin + share * (float(self.seconds[leg]) - begin)


def tool_order_of_node(
    tpg: TemporalPlanGraph, chain: int, node: int, acts: Mapping[int, Actuation]
) -> tuple[str, ToolOrder] | None:
    """Return the tool action of another robot in a node, None without one."""
    own, act = tpg.chains[chain], acts.get(node)
    if act is None or act.robot == own.robot:
        return None
    about = tpg.tasks[int(own.task[node])].object or ""
    name = f"{own.robot}:{node}"
    return act.robot, ToolOrder(name, act.act, float(own.duration[node]), about)


def cleared_node(
    tpg: TemporalPlanGraph, chain: int, node: int, acts: Mapping[int, Actuation]
) -> ClearedNode:
    """Return a node of a plan in the form sent to its driver.

    A node in which the tool of another robot acts has no duration: the driver continues once that action is done.

    Args:
        tpg: the plan.
        chain, node: of the node.
        acts: tool actions by node of the chain, see ``actuation_nodes``.
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
    """Measured configuration of a robot at one time.

    Attributes:
        at_s: when, by the clock of its driver [s].
        q: measured joint positions, shape (n,) [rad or m].
        begun, done: numbers of nodes, from the first one on, that it had begun and completed.
    """

    at_s: float
    q: Array
    begun: int
    done: int


@dataclass(frozen=True, eq=False)
class DriverState:
    """State of a driver: progress of its robot.

    Attributes:
        begun: nodes that it has begun, from its first one on.
        done: nodes that it is through with.
        mode: its current activity.
        q: measured joint positions, shape (n,) [rad or m].
        dq: measured joint speeds, shape (n,) [rad/s or m/s].
        off: greatest distance of a joint from the path since the last time [rad or m].
        failed: the node of a skill that has failed, -1 for none; the robot is back where that began.
        words: reason of a failure or fault, for people.
        samples: samples since the last call, in order; empty where only ``q`` is known.
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
    """A robot that executes nodes; its methods do not block."""

    def begin(self, start: Array, done: int) -> None:
        """Start at the planned configuration after a number of its nodes.

        Args:
            start: joint positions, shape (n,).
            done: nodes that it need not do any more.
        """
        ...

    def take(self, nodes: list[ClearedNode]) -> None:
        """Append cleared nodes.

        After a skill that failed they come after the first node of that, which counts as done.
        """
        ...

    def state(self) -> DriverState:
        """Return the state of the robot; called before ``begin``, too."""
        ...

    def act(self, order: ToolOrder) -> None:
        """Close or open the tool; the robot stands at the end of its cleared nodes."""
        ...

    def hold(self, held: bool) -> None:
        """Stop as soon as possible, or continue."""
        ...

    def leave(self) -> None:
        """Stop and release the robot; no further call follows."""
        ...
