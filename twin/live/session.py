"""A session: the drivers of all robots of a plan, and the execution that they take part in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from planning.cell.workcell import Workcell
from twin.live.driver_end import DriverEnd
from twin.live.drivers_file import DriversSection, ServiceDriver
from twin.live.link import Link
from twin.live.live_execution import LiveExecution
from twin.live.simulated_arm import SimulatedArm
from twin.live.wire import LocalWire, Wire, started_now

if TYPE_CHECKING:
    from twin.live.service import Service

_EVERY_S, _LEAST_S = 0.01, 0.001
"""Time between reports of drivers in this process, in that of the run, and at least by the clock [s]."""


@dataclass(frozen=True)
class Session:
    """Drivers of the robots of a cell, for one run.

    Attributes:
        name: of the run.
        drivers: who moves each robot.
        folder: where relative paths of the drivers file start.
    """

    name: str
    drivers: DriversSection
    folder: Path = Path()

    def execution(
        self, cell: Workcell, written: Callable[[], None]
    ) -> Callable[..., LiveExecution]:
        """Return what makes the state of the run.

        Args:
            cell: with the robots.
            written: sees to it that all events so far are on the disk.
        """
        links, wires = {}, dict[str, Wire]()
        service = self._service(cell)
        for robot in cell.robots:
            links[robot.name] = Link(
                self.name,
                robot.name,
                robot.home,
                self.drivers.lease_s,
            )
            if isinstance(self.drivers.driver_of(robot.name), ServiceDriver):
                assert service is not None
                wires[robot.name] = service.wire(robot.name, robot.model.dof)
            else:
                links[robot.name].ahead_s = None
                wires[robot.name] = self._local(robot.name)
        return partial(
            LiveExecution,
            links=links,
            wires=wires,
            written=written,
            out_s=self.drivers.out_s,
            pace=self.drivers.pace,
        )

    def _service(self, cell: Workcell) -> Service | None:
        """Return where drivers beyond this process ask, None where there are none."""
        every = [self.drivers.driver_of(robot.name) for robot in cell.robots]
        if not any(isinstance(own, ServiceDriver) for own in every):
            return None
        from twin.live.service import Service, certificates_of

        held = certificates_of(self.drivers.certificates, self.folder)
        return Service(self.drivers.listen, held)

    def _local(self, robot: str) -> Wire:
        pace = self.drivers.pace
        end = DriverEnd(SimulatedArm(pace=pace), robot, started_now())
        return LocalWire(end, max(_EVERY_S / pace, _LEAST_S))
