"""Session with the drivers of all robots of a cell, through which one run moves real or simulated robots."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planning.cell.workcell import PlacedRobot, Workcell
from twin.cluster.address import on_this_machine
from twin.drivers.driver import Driver
from twin.drivers.drivers_file import (
    DriversSection,
    RegisteredDriver,
    ServiceDriver,
)
from twin.drivers.simulated_arm import SimulatedArm
from twin.engine.execution import Ports
from twin.live.driver_end import DriverEnd, LocalWire, Wire, new_instance_number
from twin.live.link import Link
from twin.live.measured import History
from twin.live.remote_robots import RemoteRobots
from twin.registry import DRIVERS

if TYPE_CHECKING:
    from twin.live.service import Service

_REPORT_EVERY_S = 0.01
"""Time of the run between reports of a driver in this process [s]."""

_LEAST_INTERVAL_S = 0.001
"""Least time by the clock between such reports [s]."""


@dataclass(frozen=True)
class Session:
    """Drivers of the robots of a cell, for one run.

    Attributes:
        name: of the run.
        drivers: driver of each robot.
        folder: where relative paths of the drivers file start.
    """

    name: str
    drivers: DriversSection
    folder: Path = Path()

    def content(self) -> dict[str, Any]:
        """Return the session as an entry of a manifest."""
        folder = str(self.folder.resolve())
        return {"drivers": self.drivers.model_dump(mode="json"), "folder": folder}

    @classmethod
    def of(cls, name: str, content: Mapping[str, Any]) -> Session:
        """Return the session of an entry of a manifest."""
        drivers = DriversSection.model_validate_json(json.dumps(content["drivers"]))
        return cls(name, drivers, Path(content["folder"]))

    def execution(
        self,
        cell: Workcell,
        written: Callable[[], None],
        measured: Path | None = None,
        history: History | None = None,
    ) -> Ports:
        """Return the ports of an execution whose robots are moved by the drivers.

        Args:
            cell: with the robots.
            written: flushes all events to the disk.
            measured: file to which samples are written.
            history: of an earlier dispatcher's log, which this run continues; None for a new run.
        """
        links, wires = {}, dict[str, Wire]()
        service = self._service()
        for robot in cell.robots:
            link = Link(self.name, robot.name, robot.home, self.drivers.lease_s)
            link.lower, link.upper = robot.model.lower, robot.model.upper
            links[robot.name] = link
            if isinstance(self.drivers.driver_of(robot.name), ServiceDriver):
                assert service is not None
                wires[robot.name] = service.wire(robot.name, robot.model.dof)
                link.near = on_this_machine(self.drivers.listen)
            else:
                link.ahead_s = None
                wires[robot.name] = LocalWire(
                    DriverEnd(self.driver(robot), robot.name, new_instance_number()),
                    max(_REPORT_EVERY_S / self.drivers.pace, _LEAST_INTERVAL_S),
                )
        robots = partial(
            RemoteRobots,
            links=links,
            wires=wires,
            written=written,
            out_s=self.drivers.out_s,
            tolerance=self.drivers.tolerance,
            pace=self.drivers.pace,
            measured=measured,
            history=history,
        )
        return Ports(robots)

    def require_servable(self) -> None:
        """Check early that drivers in other processes can be served as configured.

        Raises:
            RequestError: they cannot; the message says why.
        """
        if self._serves:
            from twin.live.service import certificates_of, grpc_module, require_private

            grpc_module()
            held = certificates_of(self.drivers.certificates, self.folder)
            require_private(self.drivers.listen, held)

    @property
    def _serves(self) -> bool:
        """Whether there are drivers in other processes."""
        return any(isinstance(d, ServiceDriver) for d in self.drivers.robots.values())

    def _service(self) -> Service | None:
        """Return the service for drivers in other processes, None without any."""
        if not self._serves:
            return None
        from twin.live.service import Service, certificates_of

        held = certificates_of(self.drivers.certificates, self.folder)
        return Service(self.drivers.listen, held)

    def driver(self, robot: PlacedRobot) -> Driver:
        """Return the driver of a robot in this process."""
        chosen = self.drivers.driver_of(robot.name)
        name = chosen.name if isinstance(chosen, RegisteredDriver) else chosen.kind
        if name in DRIVERS:
            driver: Driver = DRIVERS.load(name)(chosen, robot)
            return driver
        return SimulatedArm(pace=self.drivers.pace)
