"""Shapes, types and ranges that the arrays of plan.npz must have, see ``plan_files``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import MODEL as MACHINE
from planning.errors import OutputError
from planning.transforms import Indices
from scheduling.graph.drive import BY_EFFORT
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph

Arrays = Mapping[str, npt.NDArray[Any]]

Expected = tuple[str, type, tuple[int, ...]]
"""Name, type and shape of an array."""

LARGEST_BYTES = 2**30
"""Most that the arrays of a plan may take in memory: 500 times the largest shipped one."""

FARTHEST = 1e4
"""Greatest size, distance from the origin [m] and joint value [rad or m] that is believed."""

THINNEST = 1e-4
"""Least edge of a box [m], as in scenarios: thinner ones are flat to collision libraries."""

_SLACK = 1e-6  # of joint limits, for values that were rounded [rad or m]

LONGEST_S = 1e6
"""Longest node, and latest start, that is believed [s]: eleven days."""

_LARGEST = (
    *((f"_{name}", LONGEST_S) for name in ("duration", "planned_start")),
    *((f"_{name}", LONGEST_S) for name in ("cruise", "ramp", "lag", "slowed")),
    *((f"_{name}", 1e9) for name in ("limits", "caps")),
)
"""Greatest values of what is no length, by how the array's name ends."""


_DRIVE = dict.fromkeys(("cruise", "ramp", "lag", "slowed", "cap"), np.float64) | {
    "rests": np.bool_,
    "slowed_by": np.int64,
}


def check_arrays(document: Mapping[str, Any], arrays: Arrays) -> None:
    """Check the arrays of a plan whose plan.json has been checked.

    Raises:
        OutputError: an array has another type or shape than it should, or a value that is not
            finite, out of its range or out of order; the message names the array.
        KeyError: an array is missing.
    """
    for name, dtype, shape in _expected(document, arrays):
        values = arrays[name]
        if values.dtype != dtype or values.shape != shape:
            raise OutputError(
                f"{name} is {values.dtype} of shape {values.shape}, not {np.dtype(dtype)} of"
                f" shape {shape}"
            )
        if values.dtype.kind == "f":
            _require(np.isfinite(values), name, values, "is not finite")
            far = (most for end, most in _LARGEST if name.endswith(end))
            limit = next(far, FARTHEST)
            _require(abs(values) <= limit, name, values, f"is beyond {limit:g}")
    for name in ("fixture_size", "object_size"):
        sizes, least = arrays[name], f"must be at least {THINNEST:g}"
        _require(sizes >= THINNEST, name, sizes, least)
    for name in arrays:
        if name.endswith(("pose", "base", "start")) and arrays[name].shape[-2:] == (
            4,
            4,
        ):
            _check_poses(name, arrays[name])
    for i in range(len(document["chains"])):
        _check_chain(f"chain_{i}_", arrays, len(document["tasks"]))
    _check_references(document, arrays)


def check_limits(tpg: TemporalPlanGraph) -> None:
    """Check that robots stay within their joint limits.

    Raises:
        OutputError: a configuration is beyond them; the message names robot and joint.
    """
    for i, chain in enumerate(tpg.chains):
        model = tpg.cell.robot(chain.robot).model
        for name, q in (("start", chain.start[None]), ("waypoints", chain.waypoints)):
            inside = (q >= model.lower - _SLACK) & (q <= model.upper + _SLACK)
            _require(
                inside, f"chain_{i}_{name}", q, f"is beyond a limit of {model.name}"
            )


def _expected_of_shape(
    name: str, elements: Sequence[Mapping[str, Any]], arrays: Arrays
) -> Iterator[Expected]:
    """Yield what is expected of the arrays of what is no box."""
    yield f"shape_{name}_pose", np.float64, (len(elements), 4, 4)
    for k, element in enumerate(elements):
        if element["form"] != "mesh":
            continue
        key = f"shape_{name}_{k}"
        vertices, faces = arrays[f"{key}_vertices"], arrays[f"{key}_faces"]
        yield f"{key}_vertices", np.float64, (len(vertices), 3)
        yield f"{key}_faces", np.int64, (len(faces), 3)
        known = (faces >= 0) & (faces < len(vertices))
        _require(known, f"{key}_faces", faces, "is no vertex")
        yield f"{key}_corners", np.float64, (sum(element["hulls"]), 3)
        yield f"{key}_centre", np.float64, (3,)


def _expected(document: Mapping[str, Any], arrays: Arrays) -> Iterator[Expected]:
    """Yield what is expected of every array, those first on which others depend."""
    cell, tasks = document["cell"], document["tasks"]
    joints = dict.fromkeys(cell.get("machines", ()), MACHINE.dof)
    joints |= {robot["name"]: len(robot["joints"]) for robot in cell["robots"]}
    yield from _expected_of_cell(cell, joints, arrays)
    dof = np.array([joints[task["robot"]] for task in tasks], dtype=np.int64)
    yield from _expected_of_tasks(tasks, dof, arrays)
    yield "handling_pose", np.float64, (len(document["handlings"]), 4, 4)
    for i, robot in enumerate(document["chains"]):
        yield from _expected_of_chain(f"chain_{i}_", joints[robot], arrays)
    yield "edges", np.int64, (len(arrays["edges"]) if arrays["edges"].ndim else 0, 4)
    yield "cause", np.uint8, (len(arrays["edges"]),)
    yield "dependencies", np.int64, (arrays["dependencies"].size // 2, 2)
    yield "slots", np.int64, (len(tasks) if arrays["slots"].size else 0,)
    if "products" in arrays:
        yield "products", np.int64, (len(tasks),)


def _expected_of_cell(
    cell: Mapping[str, Any], joints: Mapping[str, int], arrays: Arrays
) -> Iterator[Expected]:
    for i, robot in enumerate(cell["robots"]):
        dof = joints[robot["name"]]
        yield f"robot_{i}_base", np.float64, (4, 4)
        yield f"robot_{i}_home", np.float64, (dof,)
        yield f"robot_{i}_frames", np.float64, (len(robot["frames"]), 4, 4)
        if f"robot_{i}_limits" in arrays:
            yield f"robot_{i}_limits", np.float64, (3, dof)
            yield f"robot_{i}_caps", np.float64, (3,)
            for name in (f"robot_{i}_limits", f"robot_{i}_caps"):
                values = arrays[name]
                _require(values >= 0.0, name, values, "is negative; 0 is no limit")
            rates = arrays[f"robot_{i}_limits"][:2]
            wrong = (
                "speed and acceleration must be above 0; jerk may be 0, for no limit"
            )
            _require(rates > 0.0, f"robot_{i}_limits", rates, wrong)
    for what, pose in (("fixture", "pose"), ("object", "start")):
        count = len(cell[f"{what}s"])
        yield f"{what}_size", np.float64, (count, 3)
        yield f"{what}_{pose}", np.float64, (count, 4, 4)
    for item in (*cell["fixtures"], *cell["objects"]):
        if item.get("shape") is not None:
            yield from _expected_of_shape(item["name"], item["shape"], arrays)


def _expected_of_tasks(
    tasks: Sequence[Mapping[str, Any]], dof: Indices, arrays: Arrays
) -> Iterator[Expected]:
    yield "task_shape", np.int64, (len(tasks), 2)
    shape = arrays["task_shape"]
    _require(shape >= 0, "task_shape", shape, "must be at least 0")
    _require(shape <= 10**6, "task_shape", shape, "is beyond 1e6")
    of_path = shape[:, 1]
    _require(of_path == dof, "task_shape", of_path, "is not the number of joints")
    yield "task_path", np.float64, (int(shape.prod(axis=1).sum()),)
    handlings = sum(len(task["handlings"]) for task in tasks)
    yield "task_handling_pose", np.float64, (handlings, 4, 4)


def _expected_of_chain(prefix: str, dof: int, arrays: Arrays) -> Iterator[Expected]:
    nodes, points = arrays[f"{prefix}task"].size, arrays[f"{prefix}fraction"].size
    yield f"{prefix}start", np.float64, (dof,)
    yield f"{prefix}waypoints", np.float64, (points, dof)
    yield f"{prefix}fraction", np.float64, (points,)
    yield f"{prefix}first", np.int64, (nodes + 1,)
    yield f"{prefix}task", np.int64, (nodes,)
    yield f"{prefix}skill", np.bool_, (nodes,)
    yield f"{prefix}duration", np.float64, (nodes,)
    yield f"{prefix}planned_start", np.float64, (nodes,)
    if f"{prefix}cruise" in arrays:
        for name, kind in _DRIVE.items():
            yield f"{prefix}{name}", kind, (nodes,)
    if f"{prefix}rounded_begin" in arrays:
        rounded = f"{prefix}rounded_"
        bends, count = arrays[f"{rounded}begin"].size, arrays[f"{rounded}bend"].size
        for name in ("begin", "stop"):
            yield f"{rounded}{name}", np.int64, (bends,)
        yield f"{rounded}length", np.float64, (bends,)
        yield f"{rounded}bend", np.int64, (count,)
        for name in ("at", "window"):
            yield f"{rounded}{name}", np.float64, (count,)
        yield f"{rounded}corner", np.float64, (count, dof)


def _require(
    ok: npt.NDArray[np.bool_], name: str, values: npt.NDArray[Any], wrong: str
) -> None:
    if not np.all(ok):
        place = tuple(np.argwhere(~ok)[0].tolist())
        raise OutputError(f"{name}{list(place)} is {values[place]}: {wrong}")


def _check_poses(name: str, poses: npt.NDArray[Any]) -> None:
    turn = poses[..., :3, :3]
    apart = abs(turn @ np.swapaxes(turn, -1, -2) - np.eye(3)).max(axis=(-1, -2))
    rigid = (apart < 1e-6) & (np.linalg.det(turn) > 0)
    rigid &= np.all(poses[..., 3, :] == (0.0, 0.0, 0.0, 1.0), axis=-1)
    if not np.all(rigid):
        place = np.argwhere(~rigid)[:1].ravel().tolist()
        raise OutputError(f"{name}{place or ''} is no pose: rotation and translation")


def _check_chain(prefix: str, arrays: Arrays, tasks: int) -> None:
    first, task = arrays[f"{prefix}first"], arrays[f"{prefix}task"]
    fraction, points = arrays[f"{prefix}fraction"], len(arrays[f"{prefix}waypoints"])
    if not len(task):
        raise OutputError(f"{prefix}task is empty: a chain has nodes")
    _require(np.diff(first) > 0, f"{prefix}first", first, "does not rise")
    if first[0] != 0 or first[-1] != points:
        raise OutputError(f"{prefix}first does not run from 0 to {points}")
    _require(
        (task >= 0) & (task < tasks), f"{prefix}task", task, f"must be 0 to {tasks - 1}"
    )
    _require(np.diff(task) >= 0, f"{prefix}task", task, "falls afterwards")
    for key in ("duration", "planned_start"):
        values = arrays[f"{prefix}{key}"]
        _require(values >= 0, f"{prefix}{key}", values, "must be at least 0")
    starts = arrays[f"{prefix}planned_start"]
    _require(np.diff(starts) >= 0, f"{prefix}planned_start", starts, "falls afterwards")
    if f"{prefix}cruise" in arrays:
        _check_drive(prefix, arrays)
    if f"{prefix}rounded_begin" in arrays:
        _check_corners(prefix, arrays)
    inside = (fraction >= 0) & (fraction <= 1)
    _require(inside, f"{prefix}fraction", fraction, "must be 0 to 1")
    ends = np.zeros(points, dtype=bool)
    ends[first[1:] - 1] = True
    rises = (np.diff(fraction, append=0.0) >= 0) | ends
    _require(rises, f"{prefix}fraction", fraction, "falls within its node")
    _require(
        (fraction == 1.0) | ~ends,
        f"{prefix}fraction",
        fraction,
        "ends a node, must be 1",
    )


def _check_drive(prefix: str, arrays: Arrays) -> None:
    for key in ("cruise", "ramp", "lag", "slowed"):
        values = arrays[f"{prefix}{key}"]
        _require(values >= 0, f"{prefix}{key}", values, "must be at least 0")
    slowed_by, joints = arrays[f"{prefix}slowed_by"], arrays[f"{prefix}start"].size
    known = (slowed_by >= -joints) & (slowed_by < BY_EFFORT + joints)
    wrong = f"must be {-joints} to {BY_EFFORT + joints - 1}"
    _require(known, f"{prefix}slowed_by", slowed_by, wrong)
    ramp, rests = arrays[f"{prefix}ramp"], arrays[f"{prefix}rests"]
    lag, cap = arrays[f"{prefix}lag"], arrays[f"{prefix}cap"]
    _require((cap > 0) & (cap <= 1), f"{prefix}cap", cap, "must be above 0, at most 1")
    moves = rests.copy()
    moves[:-1] |= (ramp[1:] > 0.0) & (ramp[:-1] > 0.0)
    _require(moves, f"{prefix}ramp", ramp, "is 0 within a stretch")
    alike = rests.copy()
    alike[:-1] |= lag[1:] == lag[:-1]
    _require(alike, f"{prefix}lag", lag, "is another one within a stretch")
    for key in ("duration", "cruise"):
        values = arrays[f"{prefix}{key}"]
        _require(
            (values > 0) | (ramp == 0), f"{prefix}{key}", values, "must be above 0"
        )


def _check_corners(prefix: str, arrays: Arrays) -> None:
    """Check that rounded corners are pose nodes of a stretch, one bend after another."""
    name = f"{prefix}rounded_"
    begin, stop, length = (arrays[f"{name}{k}"] for k in ("begin", "stop", "length"))
    bend, at, window = (arrays[f"{name}{k}"] for k in ("bend", "at", "window"))
    after = np.append(0, stop[:-1])
    ok = (begin >= after) & (begin < stop)
    _require(ok, f"{name}begin", begin, "is out of order")
    skill = arrays[f"{prefix}skill"]
    _require(stop <= len(skill), f"{name}stop", stop, "is the index of no node")
    ok = (np.diff(bend, prepend=-1) >= 0) & (np.diff(bend, prepend=-1) <= 1)
    _require(ok, f"{name}bend", bend, "is out of order")
    if len(bend) == 0 or bend[-1] != len(begin) - 1:
        raise OutputError(f"{name}bend does not run from 0 to {len(begin) - 1}")
    # Windows are as long as they are, and in order, where a bend begins and ends.
    low, high = at - 0.5 * window, at + 0.5 * window
    slack = 1e-9 * length[bend]
    ok = (window > 0) & (low >= -slack) & (high <= length[bend] + slack)
    same = np.diff(bend, prepend=-1) == 0
    ok &= ~same | (np.diff(at, prepend=0.0) > 0)
    for edge in (low, high):
        ok &= ~same | (np.diff(edge, prepend=0.0) >= -slack)
    _require(ok, f"{name}window", window, "does not fit the bend")
    if f"{prefix}cruise" not in arrays:
        raise OutputError(
            f"{name}begin: robots rest at corners where nothing is limited"
        )
    rests = arrays[f"{prefix}rests"]
    for k, (a, b) in enumerate(zip(begin.tolist(), stop.tolist(), strict=True)):
        if np.any(skill[a:b]) or np.any(rests[a : b - 1]):
            raise OutputError(f"{name}begin[{k}] is {a}: the robot rests in that bend")


def _check_references(document: Mapping[str, Any], arrays: Arrays) -> None:
    counts = np.array(
        [arrays[f"chain_{i}_task"].size for i in range(len(document["chains"]))]
    )
    edges, tasks = arrays["edges"], len(document["tasks"])
    robots, nodes = edges[:, [0, 2]], edges[:, [1, 3]]
    ok = (robots >= 0) & (robots < len(counts))
    _require(ok, "edges", robots, "is the index of no chain")
    _require(
        (nodes >= 0) & (nodes < counts[robots]),
        "edges",
        nodes,
        "is the index of no node",
    )
    _require(
        robots[:, 0] != robots[:, 1], "edges", robots[:, 0], "joins nodes of one robot"
    )
    cause = arrays["cause"]
    _require(cause <= 1, "cause", cause, "must be 0 or 1")
    needs = arrays["dependencies"]
    _require(
        (needs >= 0) & (needs < tasks), "dependencies", needs, "is the index of no task"
    )
    for name in ("slots", "products"):
        values = arrays.get(name, np.empty(0, dtype=np.int64))
        _require(values >= 0, name, values, "must be at least 0")
    for k, entry in enumerate(document["handlings"]):
        chain, node = entry["chain"], entry["node"]
        if chain >= len(counts) or node >= counts[chain]:
            raise OutputError(
                f"handlings.{k}: there is no node {node} of chain {chain}"
            )
        first = arrays[f"chain_{chain}_first"]
        if entry["waypoint"] > first[node + 1] - first[node]:
            raise OutputError(
                f"handlings.{k}: node {node} has no waypoint {entry['waypoint']}"
            )
    for k, task in enumerate(document["tasks"]):
        for handling in task["handlings"]:
            if handling["waypoint"] > arrays["task_shape"][k, 0]:
                raise OutputError(f"tasks.{k}: has no waypoint {handling['waypoint']}")
