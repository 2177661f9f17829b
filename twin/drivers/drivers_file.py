"""Configuration file of robot drivers: the driver of each robot, and the network address to which drivers connect."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from planning.files import read_file
from twin.document.section import Name, Section
from twin.document.validation import (
    FileProblem,
    InvalidScenarioError,
    parse_document,
    unknown_name,
    validate_document,
)
from twin.document.yaml_text import Mark
from twin.registry import DRIVERS

_Seconds = Annotated[float, Field(gt=0, le=86_400)]


class SimulatedDriver(Section):
    """A simulated arm, which executes its nodes in real time."""

    kind: Literal["simulated"]


class ServiceDriver(Section):
    """A program of your own that requests the nodes of its robot by gRPC, see ``cell.proto``."""

    kind: Literal["grpc"]


class FrankaArm(Section):
    """A robot of Franka Robotics with its hand, by libfranka; see ``twin.drivers.franka``.

    Attributes:
        address: of its controller.
        width_m: of what its hand grips, between the fingers.
        within_m: largest difference from that width; with more, the grasp has failed.
        opening_m: to which the hand opens.
        force_n: with which it presses.
        speed_m_s: of its fingers.
        goal_m: width to which it is told to close; by default ``width_m``.
        realtime: whether this computer has a real-time kernel, which real robots require.
    """

    kind: Literal["franka"]
    address: Annotated[str, Field(min_length=1)]
    width_m: Annotated[float, Field(ge=0, le=0.08)] = 0.04
    within_m: Annotated[float, Field(gt=0, le=0.08)] = 0.005
    opening_m: Annotated[float, Field(gt=0, le=0.08)] = 0.06
    force_n: Annotated[float, Field(gt=0, le=140)] = 30.0
    speed_m_s: Annotated[float, Field(gt=0, le=0.2)] = 0.05
    goal_m: Annotated[float, Field(ge=0, le=0.08)] | None = None
    realtime: bool = True


class RegisteredDriver(Section):
    """A driver that a package or a script adds to the registry.

    Attributes:
        name: of the driver in the registry.
        options: passed to it, such as an address.
    """

    kind: Literal["registered"]
    name: Name
    options: dict[Name, Any] = Field(default_factory=dict)


AnyDriver = Annotated[
    SimulatedDriver | ServiceDriver | FrankaArm | RegisteredDriver,
    Field(discriminator="kind"),
]
"""Driver of a robot."""


class DriversSection(Section):
    """Drivers of the robots of a cell, for ``twin operate --drivers``.

    Attributes:
        robots: driver of each robot, by its name; robots that are not named are simulated.
        listen: address at which programs request the nodes of their robots.
        certificates: folder of certificates for mutual authentication; without one, only programs on this machine
            can connect.
        lease_s: time without a message from a driver after which it is cleared no further nodes [s].
        out_s: time without a message after which a driver counts as lost [s].
        tolerance: farthest that a joint may be from its path [rad or m]; beyond it all robots stop, and the run
            ends.
        pace: how many times as fast as the clock the run's time goes, where all arms are simulated.
    """

    robots: dict[Name, AnyDriver] = Field(default_factory=dict)
    listen: str = "127.0.0.1:50551"
    certificates: str | None = None
    lease_s: _Seconds = 2.0
    out_s: _Seconds = 60.0
    tolerance: Annotated[float, Field(gt=0, le=10)] = 0.02
    pace: Annotated[float, Field(gt=0, le=1e6)] = 1.0

    def driver_of(self, robot: str) -> AnyDriver:
        """Return the driver section of a robot."""
        return self.robots.get(robot, SimulatedDriver(kind="simulated"))


def read_drivers(path: Path, robots: tuple[str, ...]) -> DriversSection:
    """Read a drivers file.

    Args:
        path: of the file.
        robots: of the cell.

    Raises:
        InvalidScenarioError: with all that is wrong, each with its line.
    """
    try:
        text = read_file(path).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        problem = FileProblem(Mark(1, 1), f"cannot be read: {error}")
        raise InvalidScenarioError(path, [problem], ()) from error
    document = parse_document(path, text)
    section = validate_document(
        document, DriversSection, DriversSection.model_json_schema
    )
    problems = [
        *document.problems,
        *(
            document.problem(
                ("robots", name, "[key]"), unknown_name("robot", name, robots)
            )
            for name in section.robots
            if name not in robots
        ),
    ]
    problems += [
        document.problem(
            ("robots", robot, "name"),
            unknown_name("driver", own.name, DRIVERS.names()),
        )
        for robot, own in section.robots.items()
        if isinstance(own, RegisteredDriver) and own.name not in DRIVERS
    ]
    real = [
        robot
        for robot, own in section.robots.items()
        if isinstance(own, FrankaArm | RegisteredDriver)
    ]
    if section.pace != 1.0 and real:
        words = f"pace: {real[0]} is a real robot, whose speed cannot be scaled: leave it out"
        problems.append(document.problem(("pace",), words))
    if problems:
        raise InvalidScenarioError(path, problems, document.lines)
    return section
