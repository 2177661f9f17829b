"""A cell of two GP4 arms for audit tests, and runs of it written by hand."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.kinematics.kinematics import frame_pose, inverse_kinematics
from planning.tasks.task import AllowedContact, Task
from planning.transforms import (
    Array,
    Transform,
    inverse,
    quat_wxyz,
    rotation,
    translation,
)
from scheduling.graph.plan_files import save_plan
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    TemporalPlanGraph,
    pose_nodes,
)
from tests.scheduling.two_arms import two_arms

BRICK = np.array([0.0158, 0.0318, 0.0096])
TOP = 0.19
"""Height of the plate's top face above the floor that both bases stand on [m]."""

CONTACT = TOP + BRICK[2]
"""Height of the top face of a brick on the plate [m]."""

PLATE_CENTRE = (0.44, 0.0)


def fixture(name: str, size: Sequence[float], pose: Transform) -> Fixture:
    return Fixture(name, box_shape(name, size), pose)


def brick(name: str, x: float, y: float, layer: float = 1) -> CellObject:
    """A 2 x 4 brick whose centre is at (x, y), on the plate for layer 1."""
    pose = translation(x, y, TOP + (layer - 0.5) * BRICK[2])
    return CellObject(name, "2x4", box_shape(name, BRICK), pose)


def two_arm_cell(objects: Sequence[CellObject] = (), gap: float = 0.88) -> Workcell:
    plate = translation(*PLATE_CENTRE, TOP - 0.0025)
    table = translation(*PLATE_CENTRE, TOP - 0.015)
    fixtures = (
        fixture("plate", [0.3, 0.4, 0.005], plate),
        fixture("table", [0.5, 1.0, 0.02], table),
    )
    return replace(two_arms(tuple(objects), gap), fixtures=fixtures)


def reach(cell: Workcell, robot: str, x: float, y: float, z: float) -> Array:
    """A configuration that puts the tool frame at a point, pointing down."""
    placed = cell.robot(robot)
    down = translation(x, y, z) @ rotation("y", np.pi)
    found = inverse_kinematics(placed, "tool", down, placed.home)
    assert found, f"{robot} cannot reach {(x, y, z)}"
    return found[0]


def along(
    cell: Workcell, robot: str, start: Array, way: Sequence[float], rows: int
) -> Array:
    """Configurations along a straight line of the tool frame, shape (rows, 6).

    Args:
        cell: the cell.
        robot: who goes.
        start: the first configuration.
        way: from there to the last one, in the world [m].
        rows: how many there are.
    """
    placed, out = cell.robot(robot), [start]
    pose = frame_pose(placed, start, "tool")
    for share in np.linspace(0.0, 1.0, rows)[1:]:
        target = translation(*(share * np.asarray(way))) @ pose
        out.append(inverse_kinematics(placed, "tool", target, out[-1])[0])
    return np.array(out)


def straight_down(
    cell: Workcell, robot: str, x: float, y: float, high: float, low: float, rows: int
) -> Array:
    """Configurations along a vertical line of the tool frame, shape (rows, 6)."""
    start = reach(cell, robot, x, y, high)
    return along(cell, robot, start, (0.0, 0.0, low - high), rows)


def down_and_up(cell: Workcell, x: float, y: float, low: float) -> tuple[Array, Array]:
    """Times and configurations of ``left`` that goes down and up again, 60 mm.

    It reaches its lowest point at 3 s, 1 mm every 50 ms.
    """
    path = straight_down(cell, "left", x, y, low + 0.06, low, 61)
    return np.linspace(0, 6, 121), np.vstack([path, path[-2::-1]])


def in_hand(cell: Workcell, robot: str, q: Array, pose: Transform) -> Transform:
    """The pose, in the flange frame, of something at ``pose`` while the robot is at ``q``."""
    return inverse(frame_pose(cell.robot(robot), q)) @ pose


def handled(*names: str, robot: str = "left", task: int = 0) -> list[AllowedContact]:
    """The tool may touch the bricks; bricks may touch each other and the plate."""
    pairs = [(f"{robot}/tool", name) for name in names]
    pairs += combinations((*names, "plate"), 2)
    return [AllowedContact(*pair, frozenset([task])) for pair in pairs]


@dataclass
class HandWrittenRun:
    """A run folder, written row by row; each robot's rows are its nodes."""

    cell: Workcell
    allowed: list[AllowedContact] = field(default_factory=list)
    motions: dict[str, tuple[Array, Array]] = field(default_factory=dict)
    placements: list[tuple[float, str, str | None, Transform]] = field(
        default_factory=list
    )

    edges: list[tuple[int, int, int, int]] = field(default_factory=list)

    def move(
        self, robot: str, times: npt.ArrayLike, q: Array | Sequence[Array]
    ) -> None:
        """Let a robot pass configurations at times; the k-th row (from 1) ends node k - 1."""
        self.motions[robot] = (np.asarray(times, dtype=float), np.asarray(q))

    def stand(self, robot: str, seconds: float, q: Array | None = None) -> None:
        """Let a robot stand, at HOME by default."""
        here = self.cell.robot(robot).home if q is None else q
        self.move(robot, [0.0, seconds], np.stack([here, here]))

    def put(self, t: float, name: str, robot: str | None, pose: Transform) -> None:
        """From a time on, an object is in a hand or at rest."""
        self.placements.append((t, name, robot, pose))

    def tpg(self) -> TemporalPlanGraph:
        """Each robot's nodes are one task: 0 for the first robot with rows, 1 for the next."""
        chains: list[NodeChain] = []
        tasks: list[Task] = []
        for robot in self.cell.robots:
            if robot.name not in self.motions:
                continue
            t, q = self.motions[robot.name]
            task = len(tasks)
            tasks.append(Task(task, robot.name, "pick", 1, "by hand", q[1:]))
            chains.append(pose_nodes(robot.name, q[0], q[1:], task, np.diff(t), t[:-1]))
        return TemporalPlanGraph(
            self.cell,
            tuple(tasks),
            tuple(chains),
            np.array(self.edges, dtype=np.int64).reshape(-1, 4),
            np.zeros(len(self.edges), dtype=np.uint8),
            (),
            tuple(self.allowed),
        )

    def write(self, folder: Path) -> Path:
        """Write plan.json, plan.npz, trajectory.parquet and objects.parquet."""
        save_plan(self.tpg(), folder)
        rows = [
            {
                "t_s": float(t),
                "robot": robot,
                **{f"q_{j}": float(v) for j, v in enumerate(q)},
                "node": k - 1,
            }
            for robot, (times, path) in self.motions.items()
            for k, (t, q) in enumerate(zip(times, path, strict=True))
        ]
        pq.write_table(pa.Table.from_pylist(rows), folder / "trajectory.parquet")
        start = [(0.0, o.name, None, o.start) for o in self.cell.objects]
        table = [
            {
                "t_s": t,
                "object": name,
                "parent": "world" if robot is None else f"{robot}/flange",
                "xyz": pose[:3, 3].tolist(),
                "quat_wxyz": quat_wxyz(pose).tolist(),
            }
            for t, name, robot, pose in [*start, *self.placements]
        ]
        numbers, text = pa.list_(pa.float64()), pa.string()
        kinds = (pa.float64(), text, text, numbers, numbers)
        names = ("t_s", "object", "parent", "xyz", "quat_wxyz")
        schema = pa.schema(list(zip(names, kinds, strict=True)))
        pq.write_table(
            pa.Table.from_pylist(table, schema=schema), folder / "objects.parquet"
        )
        return folder


def with_fixture(cell: Workcell, item: Fixture) -> Workcell:
    """The cell with one more fixture."""
    return replace(cell, fixtures=(*cell.fixtures, item))
