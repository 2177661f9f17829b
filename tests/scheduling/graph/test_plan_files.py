"""A saved plan comes back as it was, also elsewhere; a damaged one is refused with a clear word."""

import dataclasses
import json
import shutil
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.cell.motion_limits import MotionLimits
from planning.cell.robot_model import RobotModel
from planning.cell.shape import box_shape
from planning.cell.workcell import Fixture, PlacedRobot, Workcell
from planning.errors import OutputError, RobotModelError
from planning.robots.registry import robot_model
from planning.transforms import identity, translation
from scheduling.build_tpg import build_tpg
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.corners.corners import round_corners
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.motion_times import assign_node_times
from tests.planning.robots.drawn_meshes import cone_obj
from tests.planning.robots.test_robot_models import joint, write
from tests.scheduling.mini_world import random_plan


@pytest.fixture(scope="module")
def tpg() -> TemporalPlanGraph:
    graph = build_tpg(random_plan(3, 7))
    assert len(graph.handlings) >= 3
    return graph


Numbers = dict[str, "np.ndarray[Any, Any]"]
Document = dict[str, Any]


def refused(
    tpg: TemporalPlanGraph,
    folder: Path,
    words: str,
    *,
    arrays: Callable[[Numbers], object] = lambda _: None,
    document: Callable[[Document], object] = lambda _: None,
) -> None:
    """A saved plan whose arrays or document were damaged, its sum made good, is refused."""
    save_plan(tpg, folder)
    with np.load(folder / "plan.npz") as archive:
        numbers = {name: archive[name] for name in archive.files}
    arrays(numbers)
    np.savez_compressed(folder / "plan.npz", **numbers)
    told = json.loads((folder / "plan.json").read_text())
    told["arrays_sha256"] = sha256((folder / "plan.npz").read_bytes()).hexdigest()
    document(told)
    (folder / "plan.json").write_text(json.dumps(told))
    with pytest.raises(OutputError, match=words):
        load_plan(folder, _models(tpg))


def _same(a: Any, b: Any, path: str = "tpg") -> None:
    """Compare two values field by field, arrays bit by bit."""
    if isinstance(a, RobotModel):
        assert a.name == b.name
        assert list(a.frames) == list(b.frames)
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, path
        assert np.array_equal(a, b), path
    elif dataclasses.is_dataclass(a):
        assert type(a) is type(b), path
        for f in dataclasses.fields(a):
            _same(getattr(a, f.name), getattr(b, f.name), f"{path}.{f.name}")
    elif isinstance(a, tuple):
        assert len(a) == len(b), path
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            _same(x, y, f"{path}[{i}]")
    else:
        assert a == b, path


def _without_motions(robot: PlacedRobot) -> TemporalPlanGraph:
    none = np.empty((0, 4), dtype=np.int64), np.empty(0, dtype=np.uint8)
    return TemporalPlanGraph(Workcell((robot,), (), ()), (), (), *none, (), ())


def _models(tpg: TemporalPlanGraph) -> dict[str, RobotModel]:
    return {r.model.name: r.model for r in tpg.cell.robots}


def test_a_plan_comes_back_as_it_was(tpg: TemporalPlanGraph, tmp_path: Path) -> None:
    save_plan(tpg, tmp_path / "deep" / "run")
    loaded = load_plan(tmp_path / "deep" / "run", _models(tpg))
    _same(tpg, loaded)
    check_invariant(DerivedTpg(loaded))


def test_what_few_cells_say_goes_with_their_plans(
    tpg: TemporalPlanGraph, tmp_path: Path
) -> None:
    """Colours of fixtures, how deep joined bars may be, and how deep one pair may."""
    shape = box_shape("box", (0.1, 0.1, 0.1))
    fixtures = (
        Fixture("red", shape, translation(5, 0, 0), colour=(255, 0, 10)),
        Fixture("plain", shape, translation(6, 0, 0)),
    )
    clearances = dataclasses.replace(tpg.cell.clearances, contact_depth=0.008)
    cell = dataclasses.replace(tpg.cell, fixtures=fixtures, clearances=clearances)
    first, *others = tpg.allowed
    allowed = (dataclasses.replace(first, depth=0.0125), *others)
    special = dataclasses.replace(tpg, cell=cell, allowed=allowed)
    save_plan(special, tmp_path)
    again = load_plan(tmp_path, _models(tpg))
    _same(special, again)
    assert [contact.depth for contact in again.allowed] == [
        0.0125,
        *(None for _ in others),
    ]
    text = (tmp_path / "plan.json").read_text()
    assert text.count('"depth_m"') == 1
    save_plan(tpg, tmp_path)
    assert '"depth_m"' not in (tmp_path / "plan.json").read_text()


def test_the_same_plan_makes_the_same_bytes(
    tpg: TemporalPlanGraph, tmp_path: Path
) -> None:
    for name in ("a", "b"):
        save_plan(tpg, tmp_path / name)
    for file in ("plan.json", "plan.npz"):
        assert (tmp_path / "a" / file).read_bytes() == (
            tmp_path / "b" / file
        ).read_bytes()


def test_a_registered_robot_is_found_again(tmp_path: Path) -> None:
    model = robot_model("gp4")
    frames = {**model.frames, "extra": identity()}
    robot = PlacedRobot(
        "left", dataclasses.replace(model, frames=frames), identity(), model.home
    )
    save_plan(_without_motions(robot), tmp_path)
    found = load_plan(tmp_path).cell.robot("left").model
    assert found.parts is model.parts
    assert list(found.frames) == list(frames)


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="nowhere"):
        load_plan(tmp_path / "nowhere")


@pytest.mark.parametrize("cut", [0, 100, -3])
def test_cut_arrays_are_refused(
    tpg: TemporalPlanGraph, tmp_path: Path, cut: int
) -> None:
    save_plan(tpg, tmp_path)
    file = tmp_path / "plan.npz"
    file.write_bytes(file.read_bytes()[:cut])
    with pytest.raises(OutputError, match=r"plan\.npz is damaged"):
        load_plan(tmp_path, _models(tpg))


def test_a_cut_or_foreign_document_is_refused(
    tpg: TemporalPlanGraph, tmp_path: Path
) -> None:
    save_plan(tpg, tmp_path)
    file = tmp_path / "plan.json"
    text = file.read_text()
    later = json.dumps({**json.loads(text), "version": 2})
    for content, words in (
        (text[: len(text) // 2], "damaged"),
        ("[]", "holds no temporal plan graph"),
        (later, r"version 2: .*plan again \(valid: 1\)"),
    ):
        file.write_text(content)
        with pytest.raises(OutputError, match=words):
            load_plan(tmp_path, _models(tpg))


@pytest.mark.parametrize("key", ["dependencies", "slots"])
def test_a_plan_of_another_version_is_to_be_made_again(
    tpg: TemporalPlanGraph, tmp_path: Path, key: str
) -> None:
    """It has other arrays; their sums are right all the same."""
    words = f"no '{key}': .*another version.*plan again"
    refused(tpg, tmp_path, words, arrays=lambda numbers: numbers.pop(key))


def _spoilt(name: str, place: int, value: float) -> Callable[[Numbers], None]:
    def spoil(arrays: Numbers) -> None:
        arrays[name].reshape(-1)[place] = value

    return spoil


def _replaced(name: str, make: Callable[[Any], Any]) -> Callable[[Numbers], None]:
    def spoil(arrays: Numbers) -> None:
        arrays[name] = make(arrays[name])

    return spoil


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_spoilt("chain_0_duration", 0, -50.0), r"duration\[0\] is -50.0: must be at"),
        (_spoilt("chain_0_waypoints", 1, np.nan), "is nan: is not finite"),
        (_spoilt("chain_0_waypoints", 1, 99.0), "is 99.0: is beyond a limit of"),
        (_spoilt("chain_0_planned_start", 0, 1e300), "is beyond 9e"),
        (_spoilt("chain_0_first", 1, 0), "does not rise"),
        (_spoilt("chain_0_task", 0, 10**6), "must be 0 to"),
        (_spoilt("chain_0_fraction", 0, 1.5), "must be 0 to 1"),
        (_spoilt("edges", 1, 10**6), "is the index of no node"),
        (_spoilt("edges", 0, 77), "is the index of no chain"),
        (_spoilt("cause", 0, 9), "must be 0 or 1"),
        (_spoilt("robot_0_base", 0, 2.0), "is no pose"),
        (_spoilt("object_size", 0, 0.0), "must be at least 0.0001"),
        (_replaced("edges", lambda a: a[:, :2]), "is int64 of shape"),
        (_replaced("cause", lambda a: a.astype(float)), "is float64 of shape"),
        (_replaced("chain_0_skill", lambda a: a[:-1]), "chain_0_skill is bool of"),
        (_replaced("slots", lambda a: a.astype(str)), "holds <U21"),
    ],
)
def test_numbers_that_no_plan_has_are_refused(
    tpg: TemporalPlanGraph,
    tmp_path: Path,
    spoil: Callable[[Numbers], None],
    words: str,
) -> None:
    refused(tpg, tmp_path, words, arrays=spoil)


@pytest.mark.parametrize("row", [0, 1, 2])
def test_robots_that_keep_to_limits_have_a_speed_and_an_acceleration(
    tpg: TemporalPlanGraph, tmp_path: Path, row: int
) -> None:
    first = tpg.cell.robots[0]
    joints = np.ones((3, first.model.dof))
    joints[row, 1] = np.inf
    limited = dataclasses.replace(first, limits=MotionLimits(*joints))
    robots = (limited, *tpg.cell.robots[1:])
    cell = dataclasses.replace(tpg.cell, robots=robots)
    save_plan(dataclasses.replace(tpg, cell=cell), tmp_path)
    if row == 2:
        assert load_plan(tmp_path, _models(tpg)).cell.robots[0].limits is not None
        return
    message = (
        rf"robot_0_limits\[{row}, 1\] is 0.0: speed and acceleration must be above"
    )
    with pytest.raises(OutputError, match=message):
        load_plan(tmp_path, _models(tpg))


def _of_task(key: str, value: object) -> Callable[[Document], None]:
    def spoil(document: Document) -> None:
        document["tasks"][0][key] = value

    return spoil


def _renamed(name: str) -> Callable[[Document], None]:
    """Call an object by another name wherever it is named."""

    def spoil(document: Document) -> None:
        old = document["cell"]["objects"][0]["name"]
        text = json.dumps(document).replace(json.dumps(old), json.dumps(name))
        document.update(json.loads(text))

    return spoil


def _held_by_nobody(document: Document) -> None:
    idle = {**document["cell"]["robots"][0], "name": "idle"}
    document["cell"]["robots"].append(idle)
    document["handlings"][0]["holder"] = "idle"


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            _of_task("object", "../x"),
            r"tasks\.0\.object: there is no '\.\./x' \(valid: ",
        ),
        (_of_task("robot", 1), r"tasks\.0\.robot: Input should be a valid string"),
        (_renamed("../x"), r"cell\.objects\.0\.name: String should match pattern"),
        (_renamed("x" * 200), r"cell\.objects\.0\.name: .* at most 128 characters"),
        (_held_by_nobody, r"handlings\.0\.holder: there is no 'idle' \(valid: "),
    ],
)
def test_names_that_no_plan_has_are_refused(
    tpg: TemporalPlanGraph,
    tmp_path: Path,
    spoil: Callable[[Document], None],
    words: str,
) -> None:
    refused(tpg, tmp_path, words, document=spoil)


def test_arrays_that_unpack_to_more_than_a_plan_has_are_not_unpacked(
    tpg: TemporalPlanGraph, tmp_path: Path
) -> None:
    vast = _replaced("edges", lambda _: np.zeros(2**27 + 1))
    refused(tpg, tmp_path, "take more than 256 MiB", arrays=vast)


def test_the_hash_of_a_plan_is_that_of_its_content(
    tpg: TemporalPlanGraph, tmp_path: Path
) -> None:
    save_plan(tpg, tmp_path)
    again = load_plan(tmp_path, _models(tpg))
    assert plan_sha256(again) == plan_sha256(tpg)
    other = dataclasses.replace(tpg, cause=1 - tpg.cause)
    assert plan_sha256(other) != plan_sha256(tpg)


@pytest.fixture(scope="module")
def rounded() -> TemporalPlanGraph:
    plan = random_plan(2, 1, rounds=8)
    robots = tuple(
        dataclasses.replace(
            robot,
            limits=MotionLimits(
                velocity=np.full(robot.model.dof, 1.5),
                acceleration=np.full(robot.model.dof, 3.0),
                jerk=np.full(robot.model.dof, 60.0),
            ),
        )
        for robot in plan.cell.robots
    )
    cell = dataclasses.replace(plan.cell, robots=robots)
    graph = assign_node_times(
        round_corners(build_tpg(dataclasses.replace(plan, cell=cell)))
    )
    assert graph.chains[0].corners is not None
    return graph


def test_rounded_corners_come_back(rounded: TemporalPlanGraph, tmp_path: Path) -> None:
    save_plan(rounded, tmp_path)
    _same(rounded, load_plan(tmp_path, _models(rounded)))


@pytest.mark.parametrize(
    ("field", "change", "message"),
    [
        ("begin", lambda a: a + 10**6, "rounded_begin|rounded_stop"),
        ("stop", lambda a: a * 0, "rounded_begin"),
        ("bend", lambda a: a + 1, "rounded_bend"),
        ("window", lambda a: a * 100.0, "rounded_window"),
        ("window", lambda a: -a, "rounded_window"),
        ("length", lambda a: a * 0.1, "rounded_window"),
    ],
)
def test_damaged_corners_are_refused(
    rounded: TemporalPlanGraph,
    field: str,
    change: Callable[[Any], Any],
    message: str,
    tmp_path: Path,
) -> None:
    spoil = _replaced(f"chain_0_rounded_{field}", change)
    refused(rounded, tmp_path, message, arrays=spoil)


def _plan(folder: Path) -> TemporalPlanGraph:
    """Return a plan without motions of an arm whose first link is a mesh."""
    meshes = folder / "arm" / "meshes"
    meshes.mkdir(parents=True)
    (meshes / "cone.obj").write_text(cone_obj())
    path = write(folder, joint("spin", "a", "b"), links="ab")
    mesh = '<mesh filename="package://arm/meshes/cone.obj"/>'
    path.write_text(path.read_text().replace('<box size="0.1 0.1 0.4"/>', mesh, 1))
    model = robot_model("arm.urdf", folder)
    robot = PlacedRobot("one", model, identity(), model.home)
    return _without_motions(robot)


def test_a_plan_can_be_moved_without_the_robots_own_folder(tmp_path: Path) -> None:
    own, run, moved = tmp_path / "own", tmp_path / "run", tmp_path / "elsewhere"
    own.mkdir()
    tpg = _plan(own)
    save_plan(tpg, run)
    shutil.rmtree(own)
    shutil.move(run, moved)
    model = load_plan(moved).cell.robots[0].model
    assert model.urdf.is_relative_to(moved)
    assert model.joint_names == ("spin",)
    ours = tpg.cell.robots[0].model
    assert [len(p.body.vertices) for p in model.parts] == [
        len(p.body.vertices) for p in ours.parts
    ]


def test_a_mesh_that_has_changed_is_noticed(tmp_path: Path) -> None:
    own, run = tmp_path / "own", tmp_path / "run"
    own.mkdir()
    save_plan(_plan(own), run)
    (mesh,) = run.glob("robots/*/arm/meshes/cone.obj")
    mesh.write_text(mesh.read_text().replace("v ", "v  ", 1) + "# moved\n")
    with pytest.raises(RobotModelError, match="a mesh of it is not as it was"):
        load_plan(run)
