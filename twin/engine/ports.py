"""Ports of an execution: robots, objects that arrive late, replanning, and people beside the cell.

``Execution`` owns the graph, the clock and the dispatcher. Whatever differs between a simulation, an operation and
a run with drivers is behind one of these protocols.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, Protocol, TypeVar

import simpy

from planning.transforms import Array
from twin.recorders.observers import Recorder
from twin.runs.execution_record import Measured, Outcome
from twin.uncertainty.node_times import NodeTimes

T = TypeVar("T")

Steps = Generator[simpy.Event, Any, None]
"""A process of the simulation, or a part of one."""


class RobotPort(Protocol):
    """Robots, which execute released nodes and report them complete.

    Attributes:
        driven: whether robots pass borders of nodes at speed, and so need to know how far they may go.
        upcoming: waits for the next event and returns its time [ns]; infinity at the end of the run.
    """

    driven: bool
    upcoming: Callable[[], float]

    def begin(self) -> None:
        """Get robots ready at the beginning of a run; by default they are."""
        return

    def close(self) -> None:
        """Release robots at the end of a run, however it ends."""
        return

    def execute(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        """Execute a node once it is released; return whether its task failed for good."""
        ...

    def skip(self, chain: int, node: int) -> None:
        """Forget the drawn standstills of a skill that is not attempted."""
        return

    def rests_before(self, _chain: int, _node: int) -> bool:
        """Return whether a robot is at rest before a node, however far it is cleared."""
        return True

    def extended(self) -> None:
        """Take note that the graph has been extended."""
        return

    def compute(self, work: Callable[[], T]) -> Generator[simpy.Event, Any, T]:
        """Return the result of a computation that takes no time of the simulation."""
        yield from ()
        return work()

    def node_times(self) -> NodeTimes:
        """Return how long nodes took, and where robots stood."""
        ...

    def commands(self) -> tuple[Array, ...]:
        """Return what each robot was commanded, see ``ExecutionRecord``; empty without limits."""
        return ()

    def measured(self) -> dict[str, Measured]:
        """Return the measured positions of robots, by name; none of simulated ones."""
        return {}


class SupplyPort(Protocol):
    """Objects that machines bring at times that nobody knows beforehand.

    Attributes:
        coming: objects that have not been brought yet, by chain of the machine.
    """

    coming: dict[int, str]

    def lift_unknown(self) -> None:
        """Lift edges from machines whose object nobody has missed yet."""
        ...

    def missing(self, chain: int, node: int) -> str | None:
        """Return the object of a skill that begins with a node, where that is not there yet."""
        ...

    def miss(self, chain: int, node: int) -> bool:
        """Let a skill fail for good whose object is not there; return whether it is so."""
        ...


class Replanner(Protocol):
    """Extension of the graph while it is executed."""

    @property
    def planning(self) -> bool:
        """Whether a revision of the plan is being made, or is about to take over."""
        ...

    @property
    def short(self) -> bool:
        """Whether the plan that is executed makes less than is wanted."""
        ...

    @property
    def out(self) -> frozenset[str]:
        """Robots that are out of service."""
        ...

    def begin(self) -> None:
        """Take note that the run begins."""
        ...

    def recover(self, chain: int, node: int) -> Steps:
        """Wait for a revision of the plan after a skill that begins with a node has failed for good."""
        ...

    def revised(self) -> simpy.Event:
        """Return the event with which the next revision takes over."""
        ...

    def outage(self, robot: str, at_ns: int) -> None:
        """Take a robot out of service at a time [ns]."""
        ...


class Audience(Recorder, Protocol):
    """People beside the cell: they give orders, answer questions and see how far the run is."""

    def obey(self) -> None:
        """Execute orders given since the last call."""
        ...

    def look(self, now_s: float) -> None:
        """Show how far the run is, some times a second, by the clock of the robots [s]."""
        ...

    def show_planning(self) -> None:
        """Show that a revision of the plan is being made."""
        ...

    def answered(self, question: Any) -> Steps:
        """Wait until somebody has answered a question."""
        ...

    def finish(self, outcome: Outcome | None) -> None:
        """Show how the run has ended; None after an error."""
        ...
