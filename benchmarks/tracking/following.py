"""Lets a plant follow what a file commands, and measures how well it does.

Distances of robots from each other, by Bullet, from the shapes of their descriptions.
"""

import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from benchmarks.tracking.controller import PERIOD_S, ComputedTorque, Controller
from benchmarks.tracking.described_robot import DescribedRobot, Payload
from benchmarks.tracking.exported_motion import ExportedMotion, States
from benchmarks.tracking.plant import STEP_S, Flaws, Plant, load_body, new_world
from planning.transforms import Array
from twin.audit.worlds.bullet_world import MARGIN
from twin.audit.worlds.link_chain import one_shape_a_link

FAR_M = 0.5
"""What is farther away counts as so far [m]."""


class RobotDistances:
    """The robots of a cell in a world without dynamics; close it after use.

    Args:
        robots: at least two.
    """

    def __init__(self, robots: Sequence[DescribedRobot]) -> None:
        self._bullet = new_world()
        self._bodies: list[int] = []
        self._joints: list[list[int]] = []
        self._margins: list[dict[int, float]] = []
        for robot in robots:
            self._load(robot)
        self._set = self._bullet.resetJointStatesMultiDof
        self._closest = self._bullet.getClosestPoints

    def close(self) -> None:
        """Disconnect from Bullet."""
        self._bullet.disconnect()

    def _load(self, robot: DescribedRobot) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "robot.urdf")
            path.write_text(robot.urdf, encoding="utf-8")
            # Names of meshes are absolute.
            text, shapes = one_shape_a_link(path, (Path("/"),), MARGIN)
        body = load_body(self._bullet, robot, text)
        infos = [
            self._bullet.getJointInfo(body, j)
            for j in range(self._bullet.getNumJoints(body))
        ]
        joints = {info[1].decode(): info[0] for info in infos}
        links = {info[12].decode(): info[0] for info in infos}
        self._bodies.append(body)
        self._joints.append([joints[name] for name in robot.joints])
        self._margins.append({links[shape.link]: shape.margin for shape in shapes})

    def least(self, configurations: Sequence[Array]) -> float:
        """Return the least distance of any two robots at a configuration of each [m]."""
        for body, joints, q in zip(
            self._bodies, self._joints, configurations, strict=True
        ):
            self._set(body, joints, [[value] for value in q.tolist()])
        least = FAR_M
        for a, b in combinations(range(len(self._bodies)), 2):
            points = self._closest(self._bodies[a], self._bodies[b], least)
            for point in points:
                margin = self._margins[a][point[3]] + self._margins[b][point[4]]
                least = min(least, point[8] + margin)
        return least

    def along(self, motions: Sequence[Array]) -> Array:
        """Return the least distances along motions, each of shape (t, n): shape (t,) [m]."""
        return np.array([self.least(row) for row in zip(*motions, strict=True)])


SETTLING_S = 1.0
"""Robots stand at their first configuration for so long before the motion begins."""

LOOKS_S = 0.02
"""How often distances are measured [s]."""

CLOSEST = 50
"""Looks at which robots are nearest to each other, and around which every period is measured."""

FOLLOWING_ERROR = 0.1
"""From this distance of a joint from its reference on, drives stop [rad or m]."""


@dataclass(frozen=True, eq=False)
class Followed:
    """How one robot followed its reference, at every period of its controller.

    Attributes:
        commanded, reached: configurations at the same instants, shape (t, n).
        torque: what was asked for without effort limits, without its sign, shape (t, n) [N m or N].
    """

    commanded: Array
    reached: Array
    torque: Array

    @property
    def error(self) -> Array:
        """Distance of each joint from its reference at the same instant, shape (t, n)."""
        return np.abs(self.reached - self.commanded)


def follow(
    robots: Sequence[DescribedRobot],
    motion: ExportedMotion,
    flaws: Flaws = Flaws(),  # noqa: B008 - frozen
    controller: type[Controller] = ComputedTorque,
) -> tuple[Followed, ...]:
    """Let robots follow a motion, all by one clock.

    Args:
        robots: their descriptions; controllers believe them.
        motion: what is commanded.
        flaws: in what the plant differs from the descriptions.
        controller: of each robot.

    Returns:
        For each robot, from the end of the settling time until the end of the motion, or until a joint
        is FOLLOWING_ERROR from its reference.
    """
    times = np.arange(-SETTLING_S, motion.end_s, PERIOD_S)
    commands = [motion.robots[robot.name].states_at(times) for robot in robots]
    reached = [np.empty_like(q) for q, _, _ in commands]
    asked = [np.empty_like(q) for q, _, _ in commands]
    changes = list(_changes(robots, motion))
    hands: list[frozenset[Payload]] = [frozenset()] * len(robots)
    done = 0
    with ExitStack() as stack:
        plant = stack.enter_context(closing(Plant(robots, flaws)))
        controllers = [
            stack.enter_context(closing(controller(robot))) for robot in robots
        ]
        for r, (q, v, _) in enumerate(commands):
            plant.put(r, q[0], v[0])
        for k, time_s in enumerate(times):
            while changes and changes[0][0] <= time_s:
                _, r, payload, holds = changes.pop(0)
                plant.carry(r, payload, holds)
                hands[r] = hands[r] | {payload} if holds else hands[r] - {payload}
                controllers[r].hold(hands[r])
            torques = []
            for r in range(len(robots)):
                state = plant.state(r)
                now = [series[k] for series in commands[r]]
                torque, wanted = controllers[r].torque(now, state)
                torques.append(torque)
                reached[r][k] = state[0]
                asked[r][k] = np.abs(wanted)
            done = k + 1
            if _lost(commands, reached, k):
                break
            plant.advance(torques, round(PERIOD_S / STEP_S))
    begin = int(np.searchsorted(times, 0.0))
    return tuple(
        Followed(command[0][begin:done], own[begin:done], torque[begin:done])
        for command, own, torque in zip(commands, reached, asked, strict=True)
    )


def _lost(commands: Sequence[States], reached: Sequence[Array], k: int) -> bool:
    """Return whether drives stop because a joint is too far from its reference."""
    return any(
        bool(np.any(np.abs(command[0][k] - own[k]) >= FOLLOWING_ERROR))
        for command, own in zip(commands, reached, strict=True)
    )


def _changes(
    robots: Sequence[DescribedRobot], motion: ExportedMotion
) -> Iterator[tuple[float, int, Payload, bool]]:
    """Yield when robots take hold of parts and let go of them, in the order of time."""
    index = {robot.name: k for k, robot in enumerate(robots)}
    held: dict[str, tuple[int, Payload]] = {}
    taken: dict[tuple[str, str], int] = defaultdict(int)
    for item in motion.handlings:
        if item.part in held:
            yield item.time_s, *held.pop(item.part), False
        if item.holder is not None:
            k = index[item.holder]
            payload = robots[k].holds[item.part][taken[item.holder, item.part]]
            taken[item.holder, item.part] += 1
            held[item.part] = k, payload
            yield item.time_s, k, payload, True


def least_distances(
    robots: Sequence[DescribedRobot], followed: Sequence[Followed]
) -> tuple[float, float]:
    """Return the least distance of any two robots as commanded, and as reached [m].

    Commanded motions are looked at every LOOKS_S; both are, at every period, around the CLOSEST looks
    at which robots are nearest to each other.
    """
    every = round(LOOKS_S / PERIOD_S)
    count = len(followed[0].commanded)
    with closing(RobotDistances(robots)) as world:
        looks = np.arange(0, count, every)
        coarse = world.along([robot.commanded[looks] for robot in followed])
        nearest = looks[np.argsort(coarse)[:CLOSEST]]
        near = np.unique(nearest[:, None] + np.arange(-every, every))
        near = near[(near >= 0) & (near < count)]
        commanded = world.along([robot.commanded[near] for robot in followed])
        reached = world.along([robot.reached[near] for robot in followed])
    return float(np.min(commanded)), float(np.min(reached))
