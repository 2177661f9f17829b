"""Messages between the dispatcher, which releases nodes, and the drivers, which move robots; independent of transport.

Each message contains the complete target or actual state. Duplicates therefore have no effect, and the content of a
lost message is repeated by the next one. Outdated messages are recognised by their number and dropped. Nodes are sent
again until they are acknowledged.
"""

from __future__ import annotations

from dataclasses import dataclass

from planning.transforms import Array
from twin.drivers.driver import ClearedNode, DriverState, ToolOrder


@dataclass(frozen=True, eq=False)
class Command:
    """Command to a driver.

    Attributes:
        session: name of the run; a driver serves one at a time.
        robot: the addressed robot.
        instance: of the addressed driver, the last that reported; 0 without one.
        number: increasing, also across restarts of the dispatcher.
        start: where the plan has the robot stand after ``done`` nodes, shape (n,).
        done: nodes that a restarted driver shall skip.
        version: number of the graph that ``nodes`` are from, from 1.
        nodes: that the robot is cleared for, one after another; none where it has all.
        heard: how many samples have come, counted from the driver's first one on.
        held: whether the robot shall stop.
        leave: whether nothing more will come.
        tool: the last order of its tool, None for none.
    """

    session: str
    robot: str
    instance: int
    number: int
    start: Array
    done: int
    version: int
    nodes: tuple[ClearedNode, ...] = ()
    heard: int = 0
    held: bool = False
    leave: bool = False
    tool: ToolOrder | None = None


@dataclass(frozen=True, eq=False)
class Report:
    """Report of a driver.

    Attributes:
        session: its session, empty before the first command.
        robot: its robot.
        instance: increases with every restart of the driver.
        number: greater than of all before of this instance.
        at_s: when, by the clock of its samples [s].
        seen: number of the last command processed.
        version: number of the graph that its last nodes are from, 0 before the first.
        have: how many nodes it knows, from the robot's first one on.
        state: state of the driver; its samples are new, and now and then all unacknowledged ones.
        first: number of the first of the samples.
        kept: number of the oldest sample that it can resend.
    """

    session: str
    robot: str
    instance: int
    number: int
    at_s: float
    seen: int
    version: int
    have: int
    state: DriverState
    first: int = 0
    kept: int = 0
