"""What has happened while a plan was executed, who plans for that, and the plan that comes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.forecast import Clock
from twin.uncertainty.node_times import NodeTimes


@dataclass(frozen=True)
class Failure:
    """A skill that has failed for good.

    Attributes:
        chain, node: its first node.
        lost: whether its object is lost.
        missing: whether it was not tried, as what it is about was not there.
    """

    chain: int
    node: int
    lost: bool = False
    missing: bool = False


@dataclass(frozen=True)
class Incident:
    """What has happened since the last plan.

    Attributes:
        failures: skills that failed.
        out: robots that are out.
        unwanted: steps that are not wanted any more, by number.
        released: how many nodes of each chain have been released.
        ago: how long ago the tasks ended that opened windows of time, by their index [s].
        clock: what has been executed; None where there is no time.
        due: whether nothing has happened but that more is to be planned.
        more: products that have been ordered since the beginning.
    """

    failures: tuple[Failure, ...]
    out: frozenset[str]
    unwanted: frozenset[int]
    released: tuple[int, ...]
    ago: Mapping[int, float] = field(default_factory=dict)
    clock: Clock | None = None
    due: bool = False
    more: int = 0


@dataclass(frozen=True)
class Version:
    """A graph that takes the place of the one that is executed.

    Attributes:
        tpg: what was executed, is still, and what is new.
        counts: how many nodes of each chain are not new.
        new: robots that have new nodes.
        times: of the new nodes, an entry for each of these robots.
        planning_ns: how long planning it takes in the simulation [ns].
        cpu_s: processor seconds that planning it took.
        cause: why, for people.
        recovered: what becomes of each failure, for people; one entry each.
    """

    tpg: TemporalPlanGraph
    counts: tuple[int, ...]
    new: tuple[str, ...]
    times: NodeTimes
    planning_ns: int
    cpu_s: float
    cause: str
    recovered: tuple[str, ...] = ()


class Planner(Protocol):
    """Plans what is left of an assembly while it is executed."""

    @property
    def given_up(self) -> Mapping[int, str]:
        """Steps that are not done any more in what is executed, by number, with the reason."""
        ...

    @property
    def short(self) -> bool:
        """Whether less is made, by what is executed, than is wanted."""
        ...

    def plan(self, tpg: TemporalPlanGraph, incident: Incident) -> Version:
        """Return what is to take the place of a graph; nothing beyond its counts is executed any more.

        It may be asked again for the same graph, with more that has happened, before it takes its place.
        """
        ...

    def begun(self, tpg: TemporalPlanGraph, counts: Sequence[int]) -> set[int]:
        """Return the steps that have begun once so many nodes of each chain are executed."""
        ...

    def due(self, tpg: TemporalPlanGraph, released: Sequence[int]) -> bool:
        """Tell whether it is time to plan more of what is executed, though nothing has failed."""
        ...

    def swapped(self) -> None:
        """Take note that what was planned last has taken its place."""
        ...
