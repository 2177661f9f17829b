"""Violations of the safety guarantee of a plan, and their messages."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph

_Node = tuple[int, int]
"""Index of a chain, and index of a node in it."""


@dataclass(frozen=True)
class Moment:
    """A motion or rest of one robot, object or fixture that is involved in a violation.

    Attributes:
        robot: name of the robot, None for an object or fixture at rest.
        node: the node, or the node before which the robot stands, -1 where there is none.
        task: its task, -1 where there is none.
        standing: True when the robot stands before the node.
        body: what comes close: ``"<robot>/arm"``, ``"<robot>/tool"``, object or fixture.
    """

    robot: str | None
    node: int
    task: int
    standing: bool
    body: str

    def __str__(self) -> str:
        """Describe it in one phrase."""
        if self.robot is None:
            return f"{self.body} at rest"
        if self.standing:
            return f"{self.body} of {self.robot!r} standing before node {self.node}"
        return f"{self.body} of {self.robot!r} in node {self.node} (task {self.task})"


@dataclass(frozen=True)
class Problem:
    """A violation of the guarantee.

    Attributes:
        kind: ``"cycle"``, ``"order"`` (an edge or a chain against the planned order),
            ``"dependency"``, ``"handling"``, ``"jump"`` (of an object), ``"task"`` (what is done is
            not what the task says), ``"path"`` (a robot jumps), ``"nodes"``, ``"hold"``, ``"rest"``,
            ``"itself"`` (a robot touches itself, or what it carries) or ``"grip"`` (what is in a
            hand is too deep in it).
        message: one sentence.
        first, second: the two sides, None for a cycle, and where there is one side.
        distance_m: distance measured where it was first seen, NaN where none was [m].
    """

    kind: str
    message: str
    first: Moment | None = None
    second: Moment | None = None
    distance_m: float = math.nan


def node_problem(tpg: TemporalPlanGraph, kind: str, node: _Node, text: str) -> Problem:
    """Return a problem of one node, by chain and number."""
    moment, name = _named(tpg, node)
    return Problem(kind, f"{name}: {text}", moment)


def pair_problem(
    tpg: TemporalPlanGraph, kind: str, u: _Node, v: _Node, text: str
) -> Problem:
    """Return a problem of two nodes, by chain and number."""
    (first, one), (second, other) = _named(tpg, u), _named(tpg, v)
    return Problem(kind, f"{one} and {other}: {text}", first, second)


def _named(tpg: TemporalPlanGraph, node: _Node) -> tuple[Moment, str]:
    chain, number = tpg.chains[node[0]], node[1]
    task = int(chain.task[number])
    moment = Moment(chain.robot, number, task, False, chain.robot)
    return moment, f"node {number} of {chain.robot!r} (task {task})"
