"""Conversion of a temporal plan graph to the content of plan.json and plan.npz, and back."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    Field,
    PlainSerializer,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)

from planning.bounds import DEEPEST_M, LATEST_S, LONGEST_NAME
from planning.cell.robot_model import RobotModel
from planning.errors import OutputError, format_names
from planning.tasks.task import Actuation, AllowedContact, Handling, Task, TimeWindow
from scheduling.graph.columns import (
    Arrays,
    Column,
    read_columns,
    require_values,
    write_columns,
)
from scheduling.graph.stored_cell import (
    POSES,
    CellEntry,
    Entry,
    Index,
    from_entry,
    read_cell,
    stack,
    to_entry,
    write_cell,
)
from scheduling.graph.temporal_plan_graph import (
    Drive,
    NodeChain,
    NodeHandling,
    RoundedCorners,
    TemporalPlanGraph,
)

_NUMBERS = Column(("rows",), np.int64, least=0)
Seconds = Annotated[float, Field(ge=0, le=LATEST_S)]
_VALUES = Column(("values",))
_SHAPES = Column(("rows", 2), np.int64, least=0, most=10**6)


class _Handling(Entry):
    object: str
    waypoint: Index
    holder: str | None


class _Actuation(Entry):
    waypoint: Index
    act: Literal["close", "open"]
    robot: str
    tool: str | None


class _Task(Entry):
    index: Index
    robot: str
    kind: Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]
    step: Index
    label: str
    object: str | None
    goal: bool
    handlings: tuple[_Handling, ...]
    actuations: tuple[_Actuation, ...] = ()


class _NodeHandling(_Handling):
    robot: Annotated[Index, Field(alias="chain")]
    node: Index


class _Allowed(Entry):
    first: str
    second: str
    tasks: Annotated[frozenset[Index], PlainSerializer(sorted)]
    grazing: bool
    depth: Annotated[float, Field(ge=0, le=DEEPEST_M)] | None = Field(
        None, alias="depth_m"
    )

    @model_serializer(mode="wrap")
    def _without_defaults(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: v for k, v in write(self).items() if v is not None}


class _Window(Entry):
    begun: Annotated[int, Field(ge=TimeWindow.EARLIER)]
    done: Annotated[int, Field(ge=TimeWindow.EARLIER)]
    due: Index
    least: Seconds = Field(alias="least_s")
    most: Seconds | None = Field(alias="most_s")
    words: str
    ago: Seconds = Field(0.0, alias="ago_s")

    @model_serializer(mode="wrap")
    def _without_defaults(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: v for k, v in write(self).items() if k != "ago_s" or v}


class PlanDocument(Entry):
    """Content of plan.json, except format, version and the hash of the arrays."""

    cell: CellEntry
    tasks: tuple[_Task, ...]
    chains: tuple[str, ...]
    handlings: tuple[_NodeHandling, ...]
    allowed: tuple[_Allowed, ...]
    windows: tuple[_Window, ...] = ()

    @model_serializer(mode="wrap")
    def _without_defaults(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {k: v for k, v in write(self).items() if k != "windows" or v}

    def check_names(self) -> None:
        """Check that every name is known, and unique.

        Raises:
            OutputError: one is not; the message names the place.
        """
        names = [robot.name for robot in self.cell.robots]
        robots = _unique("cell.robots", names)
        movers = _unique("cell.machines", [*names, *self.cell.machines])
        items = [*self.cell.fixtures, *self.cell.objects]
        _unique("cell.fixtures and cell.objects", [item.name for item in items])
        objects = {item.name for item in self.cell.objects}
        chains = _unique("chains", self.chains)
        for k, name in enumerate(self.chains):
            _check_name(f"chains.{k}", name, movers)
        handlings: list[tuple[str, _Handling]] = []
        handlings += [(f"handlings.{k}", h) for k, h in enumerate(self.handlings)]
        for k, task in enumerate(self.tasks):
            if task.index != k:
                raise OutputError(f"tasks.{k}.index: is {task.index}")
            _check_name(f"tasks.{k}.robot", task.robot, chains)
            if task.object is not None:
                _check_name(f"tasks.{k}.object", task.object, objects)
            handlings += [(f"tasks.{k}.handlings", h) for h in task.handlings]
            for act in task.actuations:
                _check_name(f"tasks.{k}.actuations", act.robot, robots & chains)
        for place, handling in handlings:
            _check_name(f"{place}.object", handling.object, objects)
            if handling.holder not in (None, Handling.GONE):
                _check_name(f"{place}.holder", str(handling.holder), robots & chains)


def _unique(place: str, names: Sequence[str]) -> set[str]:
    if len(set(names)) < len(names):
        raise OutputError(f"{place}: a name is given twice")
    return set(names)


def _check_name(place: str, name: str, known: Collection[str]) -> None:
    if name not in known:
        valid = format_names(sorted(known)) or "none"
        raise OutputError(f"{place}: there is no {name!r} (valid: {valid})")


def write_graph(tpg: TemporalPlanGraph) -> tuple[PlanDocument, Arrays]:
    """Return a graph as the content of plan.json and plan.npz, see the head of plan_files.

    Raises:
        OutputError: a quantity is beyond the bounds of ``planning.bounds``; the message names it.
    """
    tasks, arrays = tpg.tasks, write_columns(tpg, "")
    if len(tpg.products):
        arrays["products"] = tpg.products
    handed = [h for task in tasks for h in task.handlings]
    arrays |= {
        "handling_pose": stack([h.pose for h in tpg.handlings], 4, 4),
        "task_handling_pose": stack([h.pose for h in handed], 4, 4),
        "task_path": np.concatenate([*(t.path.ravel() for t in tasks), np.empty(0)]),
        "task_shape": np.array([t.path.shape for t in tasks], int).reshape(-1, 2),
    }
    for name in ("handling_pose", "task_handling_pose"):
        POSES.check(name, arrays[name], {})
    _VALUES.check("task_path", arrays["task_path"], {})
    for i, chain in enumerate(tpg.chains):
        arrays |= write_columns(chain, f"chain_{i}_")
        if chain.drive is not None:
            arrays |= write_columns(chain.drive, f"chain_{i}_")
        if chain.corners is not None:
            arrays |= write_columns(chain.corners, f"chain_{i}_rounded_")
    names = tuple(chain.robot for chain in tpg.chains)
    try:
        cell = write_cell(tpg.cell, arrays)
        return to_entry(PlanDocument, tpg, cell=cell, chains=names), arrays
    except ValidationError as error:
        raise OutputError(first_problem(error)) from None


def first_problem(error: ValidationError) -> str:
    """Return the place and the message of the first problem of a document."""
    first = error.errors()[0]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"


def read_graph(
    document: PlanDocument,
    arrays: Arrays,
    models: Mapping[str, RobotModel],
    folder: Path,
) -> TemporalPlanGraph:
    """Return the graph that plan.json and plan.npz describe.

    Args:
        document: content of plan.json.
        arrays: content of plan.npz.
        models: robot types by name, used before the registry and URDF files.
        folder: where URDF files are searched.

    Raises:
        KeyError: an array is missing.
        OutputError: one has another type, shape or range than it should.
        RobotModelError: a robot description is not there any more, or another one.
    """
    cell = read_cell(document.cell, arrays, models, folder)
    joints = {r.name: len(r.home) for r in (*cell.robots, *cell.machines)}
    tasks = _read_tasks(document.tasks, joints, arrays)
    chains = tuple(
        _read_chain(robot, f"chain_{i}_", joints[robot], arrays)
        for i, robot in enumerate(document.chains)
    )
    poses = POSES.read("handling_pose", arrays, {"rows": len(document.handlings)})
    pairs = zip(document.handlings, poses, strict=True)
    slots = len(tasks) if arrays["slots"].size else 0
    own = read_columns(TemporalPlanGraph, "", arrays, {"slots": slots})
    if "products" in arrays:
        own["products"] = _NUMBERS.read("products", arrays, {"rows": len(tasks)})
    return TemporalPlanGraph(
        cell=cell,
        tasks=tasks,
        chains=chains,
        handlings=tuple(from_entry(NodeHandling, h, pose=pose) for h, pose in pairs),
        allowed=tuple(
            from_entry(AllowedContact, contact) for contact in document.allowed
        ),
        windows=tuple(from_entry(TimeWindow, window) for window in document.windows),
        **own,
    )


def _read_tasks(
    entries: Sequence[_Task], joints: Mapping[str, int], arrays: Arrays
) -> tuple[Task, ...]:
    shape = _SHAPES.read("task_shape", arrays, {"rows": len(entries)})
    dof = np.array([joints[entry.robot] for entry in entries], dtype=np.int64)
    of_path = shape[:, 1]
    require_values(of_path == dof, "task_shape", of_path, "is not the number of joints")
    ends = np.cumsum(shape.prod(axis=1))
    values = _VALUES.read(
        "task_path", arrays, {"values": int(ends[-1]) if len(ends) else 0}
    )
    paths = map(np.reshape, np.split(values, ends[:-1]), shape)
    handed = sum(len(entry.handlings) for entry in entries)
    poses = iter(POSES.read("task_handling_pose", arrays, {"rows": handed}))
    return tuple(
        from_entry(
            Task,
            entry,
            path=path,
            handlings=tuple(
                from_entry(Handling, h, pose=next(poses)) for h in entry.handlings
            ),
            actuations=tuple(from_entry(Actuation, a) for a in entry.actuations),
        )
        for entry, path in zip(entries, paths, strict=False)
    )


def _read_chain(robot: str, prefix: str, joints: int, arrays: Arrays) -> NodeChain:
    sizes = {"joints": joints}
    own: dict[str, Any] = dict(read_columns(NodeChain, prefix, arrays, sizes))
    if f"{prefix}cruise" in arrays:
        own["drive"] = Drive(**read_columns(Drive, prefix, arrays, sizes))
    if f"{prefix}rounded_begin" in arrays:
        corners = read_columns(RoundedCorners, f"{prefix}rounded_", arrays, sizes)
        own["corners"] = RoundedCorners(**corners)
    return NodeChain(robot, **own)
