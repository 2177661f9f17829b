"""Input of all audit rules (execution, plan, expectations, world), and the violations that they report.

The module also contains one rule: no node starts until its type-2 predecessors (nodes of other robots) are complete.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from planning.cell.robot_model import ToolGrip
from planning.cell.workcell import PlacedRobot
from planning.errors import OutputError
from planning.files import read_file
from planning.json_files import parse_json
from planning.transforms import Array, Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audits.expectations import ChangedTool, Expectations
from twin.audits.motion.executed import Recording, ReplayedRun, RobotRows
from twin.audits.worlds.world import AuditWorld, WatchedShape, shapes_by_entity

ViolationKind = Literal[
    "contact",
    "jump",
    "joint-limit",
    "joint-speed",
    "joint-acceleration",
    "joint-jerk",
    "joint-effort",
    "joint-motion",
    "tool-speed",
    "edge-order",
    "hanging",
    "balance",
    "grip",
    "place",
    "support",
    "process",
    "tool",
    "hand",
    "duration",
]

_TICK = 1e-9
"""Times are whole nanoseconds [s]."""

_LARGEST_LOG = 256 << 20
"""Most bytes of an event log."""

_NODE_EVENTS = ("started", "completed", "recovered")
"""Kinds of events with which nodes begin or end."""

_WITHOUT = ToolGrip((0.0, 0.0), "no tool")
"""How a robot holds that has left its tool in the rack."""


@dataclass(frozen=True)
class Violation:
    """A violation in a run.

    Attributes:
        t_start, t_end: first and last moment at which it was seen [s].
        first, second: who and what. Of a ``contact`` two entities, such as ``"left/arm"``,
            ``"right/tool"``, ``"b3"``, ``"plate"``; of a ``jump`` the object and
            ``"jump"``; of the kinds of joints the robot and
            its joint, or ``"all joints"``; of a ``tool-speed`` the robot and ``"tool"``; of an ``edge-order`` the robots, the one that must be complete first; of
            ``hanging`` the object and the nearest thing that stands; of ``balance`` what falls and
            ``"gravity"``; of a ``grip`` the object and its holder; of a ``place`` the object and its place; of a ``support`` the object
            and who is nearest to being its support, or the two robots of a handover; of a ``process`` what was to be done and the thing at
            which, or two steps of which the first began too early; of a ``tool`` the tool and the
            robot that has it on it, or ``"rack"``. Of plans of others also of a ``hand`` the robot and the object that it
            cannot take or give; of a ``duration`` the robot and its work; of a ``jump`` the robot and its joint.
        depth_m: greatest overlap, 0 for robots that just touch; of a jump its length; of what
            hangs, a grip or a support the distance; of a place or a tool how far off; 0 for kinds that are
            no lengths [m].
        detail: the links that overlapped most, or what is wrong, and how much.
        kind: kind of violation.
    """

    t_start: float
    t_end: float
    first: str
    second: str
    depth_m: float
    detail: str = ""
    kind: ViolationKind = "contact"


@dataclass(frozen=True)
class NodeSpans:
    """Executed begin and end of each node of a robot.

    Attributes:
        begin, end: infinite where that never happened, shape (nodes,) [s].
    """

    begin: Array
    end: Array


def edge_violations(
    tpg: TemporalPlanGraph, spans: Mapping[str, NodeSpans], seen_in: str
) -> Iterator[Violation]:
    """Yield type-2 edges whose target node began before the source node ended.

    Args:
        tpg: the plan.
        spans: of the nodes of each robot of the plan; of others nothing is known.
        seen_in: name of the record, for people.
    """
    for a, u, b, v in tpg.edges.tolist():
        first, second = tpg.chains[a].robot, tpg.chains[b].robot
        if first not in spans or second not in spans:
            continue
        over, begins = float(spans[first].end[u]), float(spans[second].begin[v])
        if np.isfinite(begins) and begins < over - _TICK:
            late = "never was" if np.isinf(over) else f"was {over - begins:.6g} s later"
            detail = f"node {v} began before node {u} of {first} was over, which {late}"
            end = begins if np.isinf(over) else over
            yield Violation(
                begins, end, first, second, 0.0, f"{detail} ({seen_in})", "edge-order"
            )


def tasks_along(
    tpg: TemporalPlanGraph, robots: Mapping[str, RobotRows], robot: str, times: Array
) -> list[frozenset[int]]:
    """Return the tasks of a robot at each of some times [s]: two at a border, and while it stands."""
    index = tpg.chain_index.get(robot)
    if index is None:
        return [frozenset()] * len(times)
    tasks, rows = tpg.chains[index].task, robots[robot]
    task = tasks[np.clip(rows.node, 0, len(tasks) - 1)].tolist()
    spans, number = np.unique(rows.rows_around(times), axis=0, return_inverse=True)
    found = [frozenset(task[first:end]) for first, end in spans.tolist()]
    return [found[k] for k in number.ravel().tolist()]


def moved_spans(
    tpg: TemporalPlanGraph, robots: Mapping[str, RobotRows]
) -> dict[str, NodeSpans]:
    """Return the intervals of motion in nodes, from trajectories.

    A node in which its robot only stands is over when the next one moves; it begins never.
    Machines do not move.
    """
    out = {}
    machines = tpg.machine_chains()
    for k, chain in enumerate(tpg.chains):
        if k in machines:
            continue
        rows = robots[chain.robot]
        begin = np.full(len(chain), np.inf)
        end = np.full(len(chain), np.inf)
        end[: min(int(rows.node.max(initial=-1)) + 1, len(chain))] = 0.0
        travel = np.abs(np.diff(rows.q, axis=0)).max(axis=1, initial=0.0)
        steps = np.flatnonzero((travel > 0.0) & ~_standing(rows, travel))
        nodes = rows.node[steps + 1]
        inside = (nodes >= 0) & (nodes < len(chain))
        steps, nodes = steps[inside], nodes[inside]
        end[nodes] = 0.0
        np.minimum.at(begin, nodes, rows.t[steps])
        np.maximum.at(end, nodes, rows.t[steps + 1])
        out[chain.robot] = NodeSpans(begin, end)
    return out


def _standing(rows: RobotRows, travel: Array) -> npt.NDArray[np.bool_]:
    """Return which steps between rows belong to a pushed robot at rest, shape (k - 1,).

    Such a step leads to a row that is repeated as the first one of the next node.

    Args:
        rows: of the robot.
        travel: largest joint displacement in each step, shape (k - 1,).
    """
    again = (np.diff(rows.t) == 0.0) & (np.diff(rows.node) != 0)
    found = np.append(again[1:], False)[: len(travel)]
    return np.asarray(found & (travel <= rows.still))


def logged_spans(tpg: TemporalPlanGraph, path: Path) -> dict[str, NodeSpans]:
    """Return start and end of nodes from the event log; a failed node ends with its recovery.

    Raises:
        OutputError: a line is no event of this plan.
    """
    out = {
        chain.robot: NodeSpans(np.full(len(chain), np.inf), np.full(len(chain), np.inf))
        for chain in tpg.chains
    }
    try:
        lines = read_file(path, _LARGEST_LOG).decode("utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise OutputError(f"{path}: cannot be read: {error}") from error
    for number, line in enumerate(lines, 1):
        if not any(f'"{kind}"' in line for kind in _NODE_EVENTS):
            continue
        try:
            event = parse_json(line)
            if event["kind"] in _NODE_EVENTS and event["robot"]:
                own, node = out[event["robot"]], event["node"]
                times = own.begin if event["kind"] == "started" else own.end
                if type(node) is not int or node < 0:
                    raise ValueError("node must be a whole number of at least 0")
                times[node] = float(event["t_s"])
        except (ValueError, LookupError, TypeError, OverflowError) as error:
            raise OutputError(
                f"{path}:{number}: is no event of this plan: {error}"
            ) from error
    return out


@dataclass(frozen=True)
class Hand:
    """Tool with which a robot holds objects at a time.

    Attributes:
        shapes: of its tool, in their places.
        grip: its grip; None if not given.
        frames: tool frames, each a pose in the flange frame.
        opening: how far the fingers stand open [m].
    """

    shapes: list[WatchedShape]
    grip: ToolGrip | None
    frames: Mapping[str, Transform]
    opening: float

    def closes_by(self, shape: WatchedShape) -> float:
        """Return the largest travel of each finger to close on the thinnest edge of a shape [m]."""
        return max(0.0, 0.5 * (self.opening - 2.0 * float(np.min(shape.half))))


class AuditCase(ReplayedRun):
    """An execution with all data of its audit.

    Args:
        world: measures distances.
        tpg: the plan.
        recording: the execution.
        wanted: expectations of the scenario on places and holds.
        logged: start and end times of nodes, by robot or machine; empty without a log.

    Attributes:
        world, tpg, wanted, logged: as given.
        moved: when robots moved in their nodes, by robot.
        shapes: of each fixture and object, by name.
        numbers: indices of the robots, by name.
    """

    def __init__(
        self,
        world: AuditWorld,
        tpg: TemporalPlanGraph,
        recording: Recording,
        wanted: Expectations | None = None,
        logged: Mapping[str, NodeSpans] | None = None,
    ) -> None:
        super().__init__(tpg.cell, recording)
        self.world, self.tpg = world, tpg
        self.wanted, self.logged = wanted or Expectations(), logged or {}
        self.moved = moved_spans(tpg, self.robots)
        self.shapes = shapes_by_entity((*world.fixtures, *world.objects))
        self.numbers = {robot.name: k for k, robot in enumerate(self.cell.robots)}

    @cached_property
    def reaches(self) -> Mapping[str, float]:
        """Bounding radius of each fixture and object about its frame, by name [m]."""
        return {
            name: max(
                float(np.linalg.norm(shape.at(np.eye(4))[:3, 3]))
                + float(np.linalg.norm(shape.centre))
                + shape.radius
                for shape in shapes
            )
            for name, shapes in self.shapes.items()
        }

    def flange(self, robot: str, t: float) -> Transform:
        """Return the flange pose of a robot at a time [s]."""
        q = self.robots[robot].at(np.array([t]))
        (pose,) = self.world.flange_poses(self.numbers[robot], q)
        return np.asarray(pose)

    def put(self, name: str, pose: Transform) -> list[WatchedShape]:
        """Place a fixture or an object in the world; return its shapes."""
        for shape in self.shapes[name]:
            self.world.place(shape, shape.at(pose))
        return self.shapes[name]

    def tool_on(self, robot: str, t: float) -> ChangedTool | None:
        """Return the exchangeable tool mounted on a robot at a time, None for none."""
        for tool in self.wanted.tools:
            stay = self.place(tool.name, t)
            if tool.robot == robot and stay is not None and stay.holder == robot:
                return tool
        return None

    def hand(self, robot: str, t: float) -> Hand:
        """Return the holding tool of a robot at its pose at a time [s], placed in the world."""
        placed, number = self.cell.robot(robot), self.numbers[robot]
        self.world.configure(number, self.robots[robot].at(np.array([t]))[0])
        tool = self.tool_on(robot, t)
        stay = None if tool is None else self.place(tool.name, t)
        if tool is not None and stay is not None:
            shapes = self.put(tool.name, self.flange(robot, t) @ stay.pose)
            grip, frames = tool.grip, tool_frames(placed, tool)
        else:
            changes = any(tool.robot == robot for tool in self.wanted.tools)
            grip = _WITHOUT if changes else placed.model.grip
            shapes, frames = self.world.tool_shapes(number), placed.model.frames
        opening = self.wanted.opening_m
        if grip is not None:
            opening = 0.0 if grip.opening is None else grip.opening[1]
        return Hand(shapes, grip, frames, opening)


def tool_frames(robot: PlacedRobot, tool: ChangedTool) -> Mapping[str, Transform]:
    """Return the frames of a tool on a robot, each a pose in the flange frame."""
    first = f"{tool.name}/"
    frames = robot.model.frames.items()
    return {k.removeprefix(first): pose for k, pose in frames if k.startswith(first)}
