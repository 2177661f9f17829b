"""Messages between dispatcher and driver, whatever carries them.

Both say how things are to be, or are, as a whole: what arrives twice changes nothing, what is lost comes again
with the next one, and what is overtaken on its way is left aside by its number. Only nodes are not repeated
once the driver has them.
"""

from __future__ import annotations

from dataclasses import dataclass

from planning.transforms import Array
from twin.drivers.driver import ClearedNode, DriverState, ToolOrder


@dataclass(frozen=True, eq=False)
class Command:
    """What a driver is told.

    Attributes:
        session: name of the run; a driver serves one at a time.
        robot: who is meant.
        instance: of the driver that is meant, the last one that was heard of; 0 where none was.
        number: greater than of all before, also after the dispatcher was started anew.
        start: where the plan has the robot stand after ``done`` nodes, shape (n,).
        done: nodes that a driver that was started anew need not do.
        version: number of the graph that ``nodes`` are from, from 1.
        nodes: that the robot is cleared for, one after another; none where it has all.
        heard: how many samples have come, counted from the driver's first one on.
        held: whether it is to stand.
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
    """What a driver says.

    Attributes:
        session: that it serves, empty before it was told.
        robot: who it is.
        instance: greater whenever the driver is started anew.
        number: greater than of all before of this instance.
        at_s: when, by the clock of its samples [s].
        seen: number of the last command that it has taken note of.
        version: number of the graph that its last nodes are from, 0 before the first.
        have: how many nodes it knows, from the robot's first one on.
        state: how far it is; its samples are new, and now and then all that have not been heard of.
        first: number of the first of the samples.
        kept: number of the oldest sample that it can tell again.
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
