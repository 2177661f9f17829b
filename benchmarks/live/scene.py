"""A cell in franky-sim: its robots behind libfranka's protocol, its fixtures and objects in MuJoCo's world.

The simulator has a process of its own, as controllers have computers of their own. It keeps to the clock on
the wall where it is fast enough; what it is asked for is answered between two of its steps of 1 ms.
"""

from __future__ import annotations

import gc
import multiprocessing
import select
import time
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

import numpy as np

from planning.cell.workcell import Workcell
from planning.transforms import Array, Transform, quat_wxyz

OPENING = 0.06
"""How far hands are open at the start [m]."""

_STIFFNESS = (4500.0, 4500.0, 3500.0, 3500.0, 2000.0, 2000.0, 2000.0)
"""Of the joints' controllers: franky-sim's own [N m/rad]."""

_LAG_S = 0.03
"""Their damping over their stiffness: by how much joints are behind what they are told [s].

That of franky-sim is 0.1 s. It is more than steps of 1 ms keep stable at the wrist: torques swing from limit
to limit there, by which what the hand holds creeps out of it.
"""

_LATE_S = 0.02
"""How long the simulator waits for the command of a robot that moves [s]."""

_DEBT_S = 0.02
"""By how much the simulator tries to catch up with the clock at most [s]."""


@dataclass(frozen=True, eq=False)
class Body:
    """Something of the cell as MuJoCo takes it: boxes of one pose.

    Attributes:
        name: in the cell.
        pose: in the world.
        boxes: edge lengths and pose of each in that frame.
        mass: [kg]; None for what never moves.
        colour: red, green, blue.
    """

    name: str
    pose: Transform
    boxes: tuple[tuple[Array, Transform], ...]
    mass: float | None
    colour: tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What the simulator has at one moment.

    Attributes:
        seconds: its own clock [s].
        poses: of objects by name, in the world.
    """

    seconds: float
    poses: dict[str, Transform]


def bodies_of(cell: Workcell) -> list[Body]:
    """Return the fixtures and objects of a cell, which are boxes.

    Raises:
        ValueError: one of them is something else.
    """
    fixed = [(f.name, f.pose, f.shape, None, f.colour) for f in cell.fixtures]
    movable = [(o.name, o.start, o.shape, o.mass, o.colour) for o in cell.objects]
    found = []
    for name, pose, shape, mass, colour in (*fixed, *movable):
        boxes = []
        for element in shape.elements:
            size = getattr(element.form, "size", None)
            if size is None:
                raise ValueError(f"{name} is not made of boxes")
            boxes.append((np.array(size), element.pose))
        found.append(Body(name, pose, tuple(boxes), mass, colour or (150, 150, 150)))
    return found


def _numbers(values: Any) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)


def _placed(element: ET.Element, pose: Transform) -> None:
    element.set("pos", _numbers(pose[:3, 3]))
    element.set("quat", _numbers(quat_wxyz(pose)))


def _add(world: ET.Element, body: Body) -> None:
    element = ET.SubElement(world, "body", name=body.name)
    _placed(element, body.pose)
    if body.mass is not None:
        ET.SubElement(element, "freejoint", name=f"{body.name}_free")
    for size, pose in body.boxes:
        geom = ET.SubElement(element, "geom", type="box", size=_numbers(size / 2))
        _placed(geom, pose)
        geom.set("rgba", _numbers([*(c / 255 for c in body.colour), 1]))
        # As rubber on wood: fingers hold by friction, also against turning in the hand. What is held slips by
        # its change of speed times half the time of the contact, 20 ms unless it is said.
        geom.set("friction", "1 0.01 0.001")
        geom.set("condim", "4")
        geom.set("solref", "0.0025 1")
        geom.set("priority", "1")
        if body.mass is not None:
            geom.set("mass", f"{body.mass / len(body.boxes):.9g}")


def _await_command(robot: Any) -> None:
    """Wait for the command of a robot that moves: a computer with a real-time kernel is in time with it.

    What is late is as good as lost: the robot leaves its path then, as its joints are slowed each by itself.

    Args:
        robot: franky-sim's server of it.
    """
    heard = getattr(robot, "_FrankaServer__udp_socket", None)
    if heard is not None and robot.current_motion_id:
        select.select([heard], [], [], _LATE_S)


def _begin_where_told(server: Any) -> None:
    """Have motions begin at the joint positions that were commanded last, as those of real robots do.

    Version 1.0.4 of franky-sim begins at the measured ones: what is commanded jumps then, and what it
    says of commanded speeds and accelerations with it.

    Args:
        server: franky-sim's class of servers of robots.
    """
    begin, command = server.start_motion, "_FrankaRobotServer__current_control_command"

    def start_motion(self: Any, *given: Any) -> None:
        told = self.robot.state.q_d
        begin(self, *given)
        setattr(self, command, replace(getattr(self, command), q_c=tuple(told)))

    server.start_motion = start_motion


def _serve(
    connection: Connection, robots: list[tuple[Transform, Array]], bodies: list[Body]
) -> None:
    """Simulate until told to stop: the work of the process."""
    from franky_sim import FrankaRobotServer, SimulationServer
    from franky_sim.mujoco_simulator import MujocoSimulator

    _begin_where_told(FrankaRobotServer)
    simulator = MujocoSimulator()
    option = simulator.scene.find("option")
    if option is not None:
        # Without these, what is held by friction creeps under its weight.
        option.set("cone", "elliptic")
        option.set("impratio", "10")
    for base, q in robots:
        simulator.add_robot(
            initial_q=q.tolist(),
            initial_hand_width=OPENING,
            kp=_STIFFNESS,
            kv=tuple(_LAG_S * stiffness for stiffness in _STIFFNESS),
        )
        _placed(simulator.worldbody[-1], base)
    ground = simulator.worldbody.find("geom[@name='ground']")
    if ground is not None:
        ground.set("pos", "0 0 -0.8")
    for body in bodies:
        _add(simulator.worldbody, body)
    names = [body.name for body in bodies if body.mass is not None]
    with simulator, SimulationServer(simulator) as server:
        connection.send([each.hostname for each in server.robot_servers])
        # Collecting garbage again and again takes a tenth of the time; there are no cycles to speak of.
        gc.collect()
        gc.disable()
        due = time.perf_counter()
        while True:
            if connection.poll():
                if connection.recv() == "stop":
                    break
                data = simulator.data
                poses = {}
                for name in names:
                    pose = np.eye(4)
                    pose[:3, :3] = data.body(name).xmat.reshape(3, 3)
                    pose[:3, 3] = data.body(name).xpos
                    poses[name] = pose
                connection.send(Snapshot(float(data.time), poses))
            # As run_once of the server, which gives up the processor in every step.
            for robot in server.robot_servers:
                _await_command(robot)
                robot.process_commands()
            simulator.step()
            for robot in server.robot_servers:
                robot.send_state()
            now = time.perf_counter()
            due = max(due + 0.001, now - _DEBT_S)
            if due > now:
                time.sleep(due - now)


class Scene:
    """A cell in a simulator that runs; leaving the ``with`` block ends it.

    Args:
        cell: robots with Franka's hands, boxes.
        starts: joint positions of the robots at the start, by name.
    """

    def __init__(self, cell: Workcell, starts: dict[str, Array]) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, far = context.Pipe()
        robots = [(robot.base, starts[robot.name]) for robot in cell.robots]
        self._process = context.Process(
            target=_serve, args=(far, robots, bodies_of(cell)), daemon=True
        )
        self._names = [robot.name for robot in cell.robots]
        self.addresses: dict[str, str] = {}

    def __enter__(self) -> Scene:
        self._process.start()
        if not self._connection.poll(60.0):
            raise TimeoutError("the simulator does not start")
        hosts = self._connection.recv()
        self.addresses = dict(zip(self._names, hosts, strict=True))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._connection.send("stop")
        self._process.join(10.0)
        if self._process.is_alive():
            self._process.kill()

    def look(self) -> Snapshot:
        """Return what the simulator has now."""
        self._connection.send("look")
        found: Snapshot = self._connection.recv()
        return found
