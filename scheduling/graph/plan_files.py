"""Files of a temporal plan graph: plan.json with its structure and plan.npz with its arrays.

plan.json is a ``PlanDocument`` with format, version and the hash of plan.npz. For each robot, ``model`` is a name
in the registry of robot models, or null if the robot is read from ``urdf``, which is stored with its meshes next
to the plan. ``sha256`` is the hash of the URDF file and the collision meshes. A plan is refused if it differs.

plan.npz has the columns of ``TemporalPlanGraph``, and those of its chains with the prefixes ``chain_<i>_`` and
``chain_<i>_rounded_``. Rows have the order of plan.json. Poses are (4, 4) matrices, and units are SI units:
    robot_<i>_base (4, 4), robot_<i>_home (n,), robot_<i>_frames (f, 4, 4); if the robot has timing limits,
    robot_<i>_limits (3, n) and robot_<i>_caps (3,), in which 0 means no limit
    shape_<name>_pose (e, 4, 4); if element k is a mesh, shape_<name>_<k>_{vertices (v, 3),
    faces (f, 3), corners (of all hulls, 3), centre (3,)}
    fixture_size (f, 3), fixture_pose (f, 4, 4), object_size (o, 3), object_start (o, 4, 4)
    task_path (all values), task_shape (tasks, 2), task_handling_pose (h, 4, 4),
    handling_pose (h, 4, 4), products (tasks,) if there are several
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from planning.bounds import LIMIT_SLACK
from planning.cell.robot_model import RobotModel
from planning.errors import OutputError
from planning.files import (
    NPZ_ERRORS,
    digest_parts,
    read_file,
    read_npz,
    replace_atomically,
    require_own_files,
)
from planning.json_files import parse_json
from planning.robots.descriptions.description_files import copy_description
from planning.tasks.task import Handling, Task, TimeWindow
from scheduling.graph.columns import require_values
from scheduling.graph.document import (
    PlanDocument,
    first_problem,
    read_graph,
    write_graph,
)
from scheduling.graph.temporal_plan_graph import (
    BY_EFFORT,
    Drive,
    NodeChain,
    NodeHandling,
    RoundedCorners,
    TemporalPlanGraph,
)

FORMAT = "assembly-twin temporal plan graph"
VERSION = 1

_LARGEST_BYTES = 2**28
"""Most that the arrays of a plan may take in memory: 100 times the largest shipped one."""

_AGAIN = "it was written by another version of this program; plan again"


def _check_plan(tpg: TemporalPlanGraph) -> None:
    """Check that indices are known, chains in order, and robots within joint limits.

    Raises:
        OutputError: something is not; the message names the place.
    """
    for i, chain in enumerate(tpg.chains):
        prefix = f"chain_{i}_"
        _check_chain(prefix, chain, len(tpg.tasks))
        if chain.drive is not None:
            _check_drive(prefix, chain, chain.drive)
        if chain.corners is not None:
            _check_corners(f"{prefix}rounded_", chain, chain.corners)
        model = tpg.cell.robot(chain.robot).model
        for name, q in (("start", chain.start[None]), ("waypoints", chain.waypoints)):
            inside = (q >= model.lower - LIMIT_SLACK) & (q <= model.upper + LIMIT_SLACK)
            require_values(
                inside, f"{prefix}{name}", q, f"is beyond a limit of {model.name}"
            )
    _check_edges(tpg)
    _check_handlings(tpg)


def _check_chain(prefix: str, chain: NodeChain, tasks: int) -> None:
    first, task, points = chain.first, chain.task, len(chain.waypoints)
    if not len(task):
        raise OutputError(f"{prefix}task is empty: a chain has nodes")
    require_values(np.diff(first) > 0, f"{prefix}first", first, "does not rise")
    if len(first) != len(task) + 1 or first[0] != 0 or first[-1] != points:
        raise OutputError(
            f"{prefix}first does not run from 0 to {points} in {len(task)} nodes"
        )
    known = (task >= 0) & (task < tasks)
    require_values(known, f"{prefix}task", task, f"must be 0 to {tasks - 1}")
    for name in ("task", "planned_start"):
        values = getattr(chain, name)
        rises = values[1:] >= values[:-1]
        require_values(rises, f"{prefix}{name}", values, "falls afterwards")
    fraction, ends = chain.fraction, np.zeros(points, dtype=bool)
    ends[first[1:] - 1] = True
    rises = (np.diff(fraction, append=0.0) >= 0) | ends
    require_values(rises, f"{prefix}fraction", fraction, "falls within its node")
    whole = (fraction == 1.0) | ~ends
    require_values(whole, f"{prefix}fraction", fraction, "ends a node, must be 1")


def _check_drive(prefix: str, chain: NodeChain, drive: Drive) -> None:
    slowed_by, joints = drive.slowed_by, len(chain.start)
    known = (slowed_by >= -joints) & (slowed_by < BY_EFFORT + joints)
    wrong = f"must be {-joints} to {BY_EFFORT + joints - 1}"
    require_values(known, f"{prefix}slowed_by", slowed_by, wrong)
    require_values(drive.cap > 0.0, f"{prefix}cap", drive.cap, "must be above 0")
    ramp, lag, rests = drive.ramp, drive.lag, drive.rests
    moves, alike = rests.copy(), rests.copy()
    moves[:-1] |= (ramp[1:] > 0.0) & (ramp[:-1] > 0.0)
    require_values(moves, f"{prefix}ramp", ramp, "is 0 within a stretch")
    alike[:-1] |= lag[1:] == lag[:-1]
    require_values(alike, f"{prefix}lag", lag, "is another one within a stretch")
    for name, values in (("duration", chain.duration), ("cruise", drive.cruise)):
        some = (values > 0) | (ramp == 0)
        require_values(some, f"{prefix}{name}", values, "must be above 0")


def _check_corners(name: str, chain: NodeChain, corners: RoundedCorners) -> None:
    """Check that rounded corners are pose nodes of a stretch, bend by bend."""
    begin, stop, length = corners.begin, corners.stop, corners.length
    bend, at, window = corners.bend, corners.at, corners.window
    after = np.append(0, stop[:-1])
    ok = (begin >= after) & (begin < stop)
    require_values(ok, f"{name}begin", begin, "is out of order")
    require_values(stop <= len(chain), f"{name}stop", stop, "is the index of no node")
    steps = np.diff(bend, prepend=-1)
    require_values((steps >= 0) & (steps <= 1), f"{name}bend", bend, "is out of order")
    if len(bend) == 0 or bend[-1] != len(begin) - 1:
        raise OutputError(f"{name}bend does not run from 0 to {len(begin) - 1}")
    # Windows are as long as they are, and in order, where a bend begins and ends.
    low, high = at - 0.5 * window, at + 0.5 * window
    slack = 1e-9 * length[bend]
    ok = (window > 0) & (low >= -slack) & (high <= length[bend] + slack)
    ok &= (steps != 0) | (np.diff(at, prepend=0.0) > 0)
    for edge in (low, high):
        ok &= (steps != 0) | (np.diff(edge, prepend=0.0) >= -slack)
    require_values(ok, f"{name}window", window, "does not fit the bend")
    if chain.drive is None:
        raise OutputError(
            f"{name}begin: robots rest at corners where nothing is limited"
        )
    for k, (a, b) in enumerate(zip(begin.tolist(), stop.tolist(), strict=True)):
        if np.any(chain.skill[a:b]) or np.any(chain.drive.rests[a : b - 1]):
            raise OutputError(f"{name}begin[{k}] is {a}: the robot rests in that bend")


def _check_edges(tpg: TemporalPlanGraph) -> None:
    counts = np.array([len(chain) for chain in tpg.chains])
    robots, nodes = tpg.edges[:, [0, 2]], tpg.edges[:, [1, 3]]
    ok = (robots >= 0) & (robots < len(counts))
    require_values(ok, "edges", robots, "is the index of no chain")
    ok = (nodes >= 0) & (nodes < counts[robots])
    require_values(ok, "edges", nodes, "is the index of no node")
    apart = robots[:, 0] != robots[:, 1]
    require_values(apart, "edges", robots[:, 0], "joins nodes of one robot")
    require_values(tpg.cause <= 1, "cause", tpg.cause, "must be 0 or 1")
    done = {int(task) for chain in tpg.chains for task in np.unique(chain.task)}
    for k, window in enumerate(tpg.windows):
        if not window.own <= done or window.due == TimeWindow.EARLIER:
            raise OutputError(f"windows.{k}: is of a task that has no node")
    needs = tpg.dependencies
    ok = (needs >= 0) & (needs < len(tpg.tasks))
    require_values(ok, "dependencies", needs, "is the index of no task")


def _check_handlings(tpg: TemporalPlanGraph) -> None:
    for k, task in enumerate(tpg.tasks):
        _check_waypoints(f"tasks.{k}", task.handlings, len(task.path))
        _check_actuations(f"tasks.{k}.actuations", task)
    for k, h in enumerate(tpg.handlings):
        place = f"handlings.{k}"
        if h.robot >= len(tpg.chains) or h.node >= len(tpg.chains[h.robot]):
            raise OutputError(f"{place}: there is no node {h.node} of chain {h.robot}")
        first = tpg.chains[h.robot].first
        _check_waypoints(place, (h,), int(first[h.node + 1] - first[h.node]))


def _check_actuations(place: str, task: Task) -> None:
    """Check that actuations are in order, and that the robot of the task stands in each."""
    before = 0
    for act in task.actuations:
        if not before < act.waypoint <= len(task.path):
            raise OutputError(f"{place}: waypoint {act.waypoint} is out of order")
        before = act.waypoint
        # Where the path begins is not said by the task.
        path = task.path[max(0, act.waypoint - 2) : act.waypoint]
        if np.any(path[0] != path[-1]):
            raise OutputError(f"{place}: the robot moves up to waypoint {before}")


def _check_waypoints(
    place: str, handlings: Sequence[Handling | NodeHandling], most: int
) -> None:
    for handling in handlings:
        if handling.waypoint > most:
            raise OutputError(f"{place}: has no waypoint {handling.waypoint}")


def save_plan(tpg: TemporalPlanGraph, folder: Path) -> None:
    """Write ``plan.json`` and ``plan.npz`` into a folder, which is created if needed.

    Args:
        tpg: the graph.
        folder: where the files go; older ones are replaced.

    Raises:
        OutputError: the files cannot be written, or ``load_plan`` would refuse the plan.
    """
    try:
        _check_plan(tpg)
        described, arrays = write_graph(tpg)
    except OutputError as error:
        raise OutputError(
            f"this plan cannot be kept: {error}; a duration, speed, size or place of the scenario is"
            " out of proportion"
        ) from None
    for robot, placed in zip(described.cell.robots, tpg.cell.robots, strict=True):
        if robot.model is None and robot.sha256 is not None:
            own = folder / "robots" / robot.sha256[:12]
            copied = copy_description(placed.model, own)
            robot.urdf = copied.relative_to(folder).as_posix()
    buffer = BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    content = buffer.getvalue()
    document = {
        "format": FORMAT,
        "version": VERSION,
        "arrays_sha256": sha256(content).hexdigest(),
        **described.model_dump(mode="json", by_alias=True),
    }
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write the plan to {folder}: {error}") from error
    for name, written in (("plan.npz", content), ("plan.json", text.encode())):
        with replace_atomically(folder / name) as temporary:
            temporary.write_bytes(written)


def plan_sha256(tpg: TemporalPlanGraph) -> str:
    """Return a hash of the content of a plan, wherever its robots' descriptions are."""
    document, arrays = write_graph(tpg)
    for robot in document.cell.robots:
        robot.urdf = ""
    digest = sha256(document.model_dump_json().encode())
    for piece in digest_parts(arrays):
        digest.update(piece)
    return digest.hexdigest()


def load_plan(
    folder: Path, models: Mapping[str, RobotModel] | None = None
) -> TemporalPlanGraph:
    """Return the graph that ``save_plan`` wrote into a folder.

    Args:
        folder: where ``plan.json`` and ``plan.npz`` are.
        models: robot types by name, used before the registry and URDF files.

    Raises:
        OutputError: a file is missing, damaged, of another version, or not of one plan.
        RobotModelError: a robot description is not there any more.
    """
    try:
        require_own_files(folder, ("plan.json", "plan.npz", "robots"))
        text = read_file(path := folder / "plan.json")
        document = parse_json(text)
        content = read_file(path := folder / "plan.npz", _LARGEST_BYTES)
    except OSError as error:
        raise OutputError(
            f"cannot read the plan in {folder}: {path.name}: {error}"
        ) from error
    except ValueError as error:
        raise OutputError(f"{path} is damaged: {error}") from error
    path = folder / "plan.json"
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise OutputError(f"{path} holds no temporal plan graph")
    if document.get("version") != VERSION:
        raise OutputError(
            f"{path} has format version {document.get('version')}: {_AGAIN}",
            choices=(str(VERSION),),
        )
    if sha256(content).hexdigest() != document.get("arrays_sha256"):
        raise OutputError(
            f"{folder / 'plan.npz'} is damaged or belongs to another plan.json"
        )
    try:
        described = PlanDocument.model_validate_json(text)
        described.check_names()
        arrays = read_npz(content, kinds="fiub", most=_LARGEST_BYTES)
        for name, values in arrays.items():
            # Robots stay as cells build them: numba recompiles for read-only arrays.
            if not name.startswith("robot_"):
                values.setflags(write=False)
        tpg = read_graph(described, arrays, models or {}, folder)
        _check_plan(tpg)
    except KeyError as error:
        # The arrays are those that belong to it, so what is missing was not written.
        raise OutputError(
            f"{folder / 'plan.npz'} has no {error.args[0]!r}: {_AGAIN}"
        ) from error
    except OutputError as error:
        raise OutputError(f"{path} with plan.npz is damaged: {error}") from None
    except ValidationError as error:
        raise OutputError(f"{path} is damaged: {first_problem(error)}") from None
    except NPZ_ERRORS as error:
        raise OutputError(f"{folder / 'plan.npz'} holds no arrays: {error}") from error
    return tpg
