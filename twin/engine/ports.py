"""Interfaces of an execution to robots, object deliveries, replanning, and people next to the cell.

``Execution`` owns the graph, the clock and the dispatcher. Simulation, operation with people, and runs with robot
drivers implement these interfaces differently.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
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


class RobotPort(ABC):
    """Robots, which execute released nodes and report them complete.

    What is not abstract has the answer of robots that are simulated from rest to rest.

    Attributes:
        driven: whether robots pass borders of nodes at speed, and so need to know how far they may go.
        upcoming: waits for the next event and returns its time [ns]; infinity at the end of the run.
    """

    driven: bool
    upcoming: Callable[[], float]

    def begin(self) -> None:
        """Get robots ready at the beginning of a run."""
        return

    def close(self) -> None:
        """Release robots at the end of a run, however it ends."""
        return

    @abstractmethod
    def execute(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        """Execute a node once it is released; return whether its task failed for good."""

    def skip(self, chain: int, node: int) -> None:
        """Forget the drawn standstills of a skill that is not attempted."""
        return

    def rests_before(self, _chain: int, _node: int) -> bool:
        """Return whether a robot is at rest before a node, however far it is cleared."""
        return True

    def extended(self) -> None:
        """Handle an extension of the graph."""
        return

    def compute(self, work: Callable[[], T]) -> Generator[simpy.Event, Any, T]:
        """Return the result of a computation that takes no time of the simulation."""
        yield from ()
        return work()

    @abstractmethod
    def node_times(self) -> NodeTimes:
        """Return node durations and standstills."""

    def commands(self) -> tuple[Array, ...]:
        """Return the commands of each robot, see ``ExecutionRecord``; empty without limits."""
        return ()

    def measured(self) -> dict[str, Measured]:
        """Return the measured positions of robots, by name; none of simulated ones."""
        return {}


class SupplyPort(Protocol):
    """Objects delivered by machines at times unknown in advance.

    Attributes:
        arriving: objects that have not been brought yet, by chain of the machine.
    """

    arriving: dict[int, str]

    def lift_unknown(self) -> None:
        """Remove edges from machines whose object no robot has missed yet."""
        ...

    def missing(self, chain: int, node: int) -> str | None:
        """Return the object of a skill that begins with a node, if it has not arrived."""
        ...

    def miss(self, chain: int, node: int) -> bool:
        """Let a skill fail for good if its object is missing; return whether it is."""
        ...


class Replanner(Protocol):
    """Extension of the graph while it is executed; ``twin.operations.replanner`` implements it."""

    @property
    def planning(self) -> bool:
        """Whether a plan revision is in progress or about to take over."""
        ...

    @property
    def short(self) -> bool:
        """Whether the executed plan lacks wanted steps."""
        ...

    @property
    def out(self) -> frozenset[str]:
        """Robots that are out of service."""
        ...

    def begin(self) -> None:
        """Handle the start of the run."""
        ...

    def recover(self, chain: int, node: int) -> Steps:
        """Wait for a plan revision after the skill that begins with a node has failed for good."""
        ...

    def revised(self) -> simpy.Event:
        """Return the event with which the next revision takes over."""
        ...

    def outage(self, robot: str, at_ns: int) -> None:
        """Take a robot out of service at a time [ns]."""
        ...


class Audience(Recorder, Protocol):
    """People next to the cell: they give orders, answer questions and see the progress."""

    def obey(self) -> None:
        """Execute orders given since the last call."""
        ...

    def show_progress(self, now_s: float) -> None:
        """Show the progress at the robots' time [s]; called some times a second."""
        ...

    def show_planning(self) -> None:
        """Show that replanning is in progress."""
        ...

    def answered(self, question: Any) -> Steps:
        """Wait until a question is answered."""
        ...

    def finish(self, outcome: Outcome | None) -> None:
        """Show how the run has ended; None after an error."""
        ...
