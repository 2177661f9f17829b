"""A session: the drivers of all robots of a plan, and the execution that they take part in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from planning.cell.workcell import Workcell
from twin.live.driver_end import DriverEnd
from twin.live.drivers_file import DriversSection, SimulatedDriver
from twin.live.link import Link
from twin.live.live_execution import LiveExecution
from twin.live.simulated_arm import SimulatedArm
from twin.live.wire import LocalWire, Wire, started_now

_EVERY_S, _LEAST_S = 0.01, 0.001
"""Time between reports of drivers in this process, in that of the run, and at least by the clock [s]."""


@dataclass(frozen=True)
class Session:
    """Drivers of the robots of a cell, for one run.

    Attributes:
        name: of the run.
        drivers: who moves each robot.
    """

    name: str
    drivers: DriversSection

    def execution(
        self, cell: Workcell, written: Callable[[], None]
    ) -> Callable[..., LiveExecution]:
        """Return what makes the state of the run.

        Args:
            cell: with the robots.
            written: sees to it that all events so far are on the disk.
        """
        links, wires = {}, dict[str, Wire]()
        for robot in cell.robots:
            links[robot.name] = Link(
                self.name,
                robot.name,
                robot.home,
                self.drivers.lease_s,
                ahead_s=None,
            )
            wires[robot.name] = self._wire(robot.name)
        return partial(
            LiveExecution,
            links=links,
            wires=wires,
            written=written,
            out_s=self.drivers.out_s,
            pace=self.drivers.pace,
        )

    def _wire(self, robot: str) -> Wire:
        chosen, pace = self.drivers.driver_of(robot), self.drivers.pace
        assert isinstance(chosen, SimulatedDriver)
        end = DriverEnd(SimulatedArm(pace=pace), robot, started_now())
        return LocalWire(end, max(_EVERY_S / pace, _LEAST_S))
