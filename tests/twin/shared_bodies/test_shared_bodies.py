"""Two arms of one description, against pinocchio, which reads the whole of it at once."""

from collections import Counter
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import coal
import numpy as np
import pinocchio
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from planning.cell.differences import cell_differences
from planning.cell.workcell import Workcell
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_pose, joint_poses_of
from planning.transforms import Array, Transform
from scheduling.graph.plan_files import load_plan, save_plan
from scheduling.verification.verify import verify_plan
from tests.twin.scenarios.executed import executed
from tests.twin.shared_bodies.torsos import ARMS, built_cell, torso, written_cell
from twin.audits.worlds.world import AuditWorld, overlapping_at_home
from twin.drawing.looks import coloured_fixtures, painted_description
from twin.reading.scenario_file import load_scenario
from twin.trial.planning import plan_scenario

THROUGH = [0.09, -1.56, 1.83]
"""Configuration of the left arm with its second link in the chest."""

NEAR = 2e-4
"""Distances that are as near to a limit may be decided either way [m]."""


class Whole:
    """The whole description with all its joints, as pinocchio reads it."""

    def __init__(self, path: Path, base: Transform) -> None:
        self.model: Any = pinocchio.buildModelFromUrdf(str(path))
        kind = pinocchio.GeometryType.COLLISION
        self.shapes = pinocchio.buildGeomFromUrdf(self.model, str(path), kind)
        self._data, self._placed = self.model.createData(), self.shapes.createData()
        self._base = base

    def move(self, values: dict[str, float]) -> None:
        q = pinocchio.neutral(self.model)
        for name, value in values.items():
            q[self.model.joints[self.model.getJointId(name)].idx_q] = value
        pinocchio.framesForwardKinematics(self.model, self._data, q)
        pinocchio.updateGeometryPlacements(
            self.model, self._data, self.shapes, self._placed
        )

    def frame(self, name: str) -> Transform:
        return np.asarray(
            self._base @ self._data.oMf[self.model.getFrameId(name)].homogeneous
        )

    def corners(self) -> dict[str, Array]:
        """Return the corners of each link's box in the world."""
        out = {}
        signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
        for item, pose in zip(
            self.shapes.geometryObjects, self._placed.oMg, strict=True
        ):
            points = signs * item.geometry.halfSide
            world = self._base @ pose.homogeneous
            out[item.name] = points @ world[:3, :3].T + world[:3, 3]
        return out

    def gaps(self) -> dict[tuple[str, str], float]:
        """Return the distances of every two links [m]."""
        items = self.shapes.geometryObjects
        out = {}
        for i, j in combinations(range(len(items)), 2):
            gap = coal.distance(
                *(
                    part
                    for k in (i, j)
                    for part in (
                        items[k].geometry,
                        coal.Transform3s(
                            self._placed.oMg[k].rotation,
                            self._placed.oMg[k].translation,
                        ),
                    )
                ),
                coal.DistanceRequest(),
                coal.DistanceResult(),
            )
            out[items[i].name[:-2], items[j].name[:-2]] = gap
        return out


def are_same(body: Array, corners: Array) -> bool:
    """Tell whether two lists of corners are the same, in any order."""
    far = np.linalg.norm(body[:, None] - corners[None], axis=2)
    return bool((far.min(axis=0) < 1e-6).all() and (far.min(axis=1) < 1e-6).all())


def place_of(link: str) -> tuple[str, int]:
    """Return the arm of a link and the number of its joint; before the first it is nobody's."""
    side = next((arm for arm in ARMS if link.startswith(arm)), "")
    return side, int(link.removeprefix(side)) - 1 if side else -1


def values_of(cell: Workcell, state: dict[str, Array]) -> dict[str, float]:
    """Return all joint values of the description: those of both arms, and those that are held."""
    held = {"waist": 0.1}
    for robot in cell.robots:
        names = robot.model.joint_names
        held |= dict(zip(names, state[robot.name].tolist(), strict=True))
    return held


def whole_of(cell: Workcell, folder: Path) -> Whole:
    return Whole(folder / "body.urdf", cell.robots[0].base)


OUT = ", base: {xyz_m: [0.3, -0.2, 0.1], rpy_deg: [0, 0, 40]}"
HELD = ", joints: {waist: 0.1}" + OUT
"""Of both robots."""


@settings(max_examples=5, deadline=None, phases=[Phase.generate])
@given(
    shoulder=st.floats(0.2, 0.3),
    roll=st.floats(0.0, 3.0),
    length=st.floats(0.1, 0.3),
    seed=st.integers(0, 1000),
)
def test_every_body_is_there_once_and_where_pinocchio_has_it(
    shoulder: float, roll: float, length: float, seed: int
) -> None:
    """Flanges, bodies for planning, and shapes of the audit."""
    described = torso(shoulder=shoulder, roll=roll, length=length)
    with TemporaryDirectory() as name:
        folder = Path(name)
        cell = built_cell(written_cell(folder, described, left=HELD, right=HELD))
        whole, world = whole_of(cell, folder), AuditWorld(cell)
        for state in states(seed, 5):
            whole.move(values_of(cell, state))
            check_places(cell, whole, world, state)


def states(seed: int, count: int) -> list[dict[str, Array]]:
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(-1.9, 1.9, (count, 2, 3))
    return [dict(zip(ARMS, both, strict=True)) for both in drawn]


@pytest.mark.parametrize(
    ("roll", "met"), [(2.9, {"body.chest", "body.pedestal"}), (0.0, {"body.head"})]
)
def test_an_arm_is_free_where_the_whole_is(
    roll: float, met: set[str], tmp_path: Path
) -> None:
    """By distances of all pairs of the whole that must keep apart; both verdicts occur."""
    file = written_cell(tmp_path, torso(roll=roll), left=HELD, right=HELD)
    cell = built_cell(file)
    whole = whole_of(cell, tmp_path)
    whole.move(values_of(cell, {r.name: r.home for r in cell.robots}))
    at_home, hit = whole.gaps(), set()
    for state in states(0, 100):
        whole.move(values_of(cell, state))
        hit |= check_verdicts(cell, whole, at_home, state)
    assert hit >= {*met, None}


def check_places(
    cell: Workcell, whole: Whole, world: AuditWorld, state: dict[str, Array]
) -> None:
    bodies, wanted = [], whole.corners()
    for number, robot in enumerate(cell.robots):
        q = state[robot.name]
        flange = whole.frame(f"{robot.name}_tool0")
        assert np.allclose(frame_pose(robot, q), flange, atol=1e-9)
        assert np.allclose(world.robots[number].flange_pose(q), flange, atol=1e-9)
        poses = joint_poses_of(robot, q)
        bodies += [
            p.body.vertices @ poses[p.joint + 1][:3, :3].T + poses[p.joint + 1][:3, 3]
            for p in robot.model.parts
        ]
        world.configure(number, q)
    bodies += [
        piece.vertices @ pose[:3, :3].T + pose[:3, 3]
        for fixture in cell.fixtures
        for _, piece, pose in fixture.shape.placed(fixture.name, fixture.pose)
    ]
    found = [
        [link for link, corners in wanted.items() if are_same(body, corners)]
        for body in bodies
    ]
    assert sorted(found) == sorted([link] for link in wanted)
    # The audit has as many shapes, each where the whole has it.
    middles = {link: corners.mean(axis=0) for link, corners in wanted.items()}
    centres = {}
    for shape in world.robot_shapes:
        assert shape.robot is not None
        q = state[cell.robots[shape.robot].name]
        turns, places = world.link_frames(shape.robot, q[None])
        k = shape.joint + 1
        centres[shape.detail.partition("/")[2]] = (
            turns[0, k] @ shape.centre + places[0, k]
        )
    for shape in world.fixtures:
        pose = next(f.pose for f in cell.fixtures if f.name == shape.entity)
        centres[shape.entity.partition(".")[2]] = shape.at(pose)[:3, 3]
    assert len(world.robot_shapes) + len(world.fixtures) == len(wanted)
    for link, centre in centres.items():
        assert np.allclose(centre, middles[f"{link}_0"], atol=1e-6), link


def check_verdicts(
    cell: Workcell,
    whole: Whole,
    at_home: dict[tuple[str, str], float],
    state: dict[str, Array],
) -> set[str | None]:
    """Return what each arm meets, None where it is free: exactly where nothing is too close."""
    everyone = replace(cell.start_state(), configurations=state)
    gaps, met = whole.gaps(), set()
    for arm in ARMS:
        nearest = np.inf
        for pair, gap in gaps.items():
            (side, k), (other, m) = map(place_of, pair)
            if arm not in (side, other):
                continue
            if {side, other} == set(ARMS):
                gap -= cell.clearances.robot_robot
            elif abs(k - m) <= 1 or at_home[pair] <= 0.0:
                continue
            nearest = min(nearest, gap)
        if abs(nearest) > NEAR:
            found = SceneChecker(cell, arm, everyone).contact(state[arm])
            assert (found is None) == (nearest > 0.0), (arm, nearest)
            met.add(None if found is None else found.obstacle)
    return met


def test_a_plan_of_both_is_proved_kept_and_audited(tmp_path: Path) -> None:
    file = written_cell(tmp_path)
    scenario = load_scenario(file)
    tpg = plan_scenario(scenario, tmp_path).tpg
    assert verify_plan(tpg).problems == ()
    executed(scenario, tpg, tmp_path / "run", base=tmp_path)
    save_plan(tpg, tmp_path / "plan")
    kept = load_plan(tmp_path / "plan")
    again = kept.cell
    assert cell_differences(again, built_cell(file)) == []
    assert [[f.name for f in r.mounted_on] for r in again.robots] == [
        ["body.pedestal", "body.chest", "body.head"]
    ] * 2
    assert verify_plan(kept).problems == ()


def test_a_plan_through_the_chest_is_refused_by_the_proof(tmp_path: Path) -> None:
    """It was made without the chest; neighbours of it still may touch it."""
    file = written_cell(tmp_path)
    file.write_text(file.read_text().replace("[0.2, 0.5, -0.5]", str(THROUGH), 1))
    cell = built_cell(file)
    contact = SceneChecker(cell, "left", cell.start_state()).contact(np.array(THROUGH))
    assert contact is not None
    assert contact.obstacle == "body.chest"
    without = plan_without_bodies(file)
    tpg = replace(without, cell=cell)
    assert verify_plan(without).problems == ()
    words = [str(problem) for problem in verify_plan(tpg).problems]
    assert words
    assert all("left/arm" in own and "body." in own for own in words), words
    assert any("body.chest" in own for own in words), words


def plan_without_bodies(file: Path) -> Any:
    """Return the plan of a cell without the bodies that its robots share."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "twin.shared_bodies.fixtures.mount_on_shared_bodies",
            lambda robots, *_: (tuple(robots), ()),
        )
        return plan_scenario(load_scenario(file), file.parent).tpg


def test_the_audit_leaves_out_neighbours_and_what_overlaps_at_home(
    tmp_path: Path,
) -> None:
    cell = built_cell(written_cell(tmp_path, torso(shoulder=0.2)))
    world = AuditWorld(cell)
    exempt = overlapping_at_home(world)
    for shape in world.robot_shapes:
        for rest in world.fixtures:
            overlaps = world.distance(shape, rest, 1.0) <= 0.0
            left_out = (shape.number, rest.number) in exempt
            assert left_out == (shape.joint == 0 or overlaps)


@pytest.mark.parametrize("looks", [True, False])
def test_what_is_shared_is_drawn_once(looks: bool, tmp_path: Path) -> None:
    """With the first robot, by its visual shapes, or by what can be touched."""
    cell = built_cell(written_cell(tmp_path, torso(looks=looks)))
    drawn = Counter(
        str(link.get("name"))
        for robot in cell.robots
        for link in painted_description(robot, (255, 0, 0)).getroot().iter("link")
        for _ in link.findall("visual")
    )
    shared = ("pedestal", "chest", "head")
    assert drawn == Counter(
        (*shared, *(f"{arm}{k}" for arm in ARMS for k in (1, 2, 3)))
    )
    assert not list(coloured_fixtures(cell))


def test_a_robot_alone_has_the_other_arm_at_rest(tmp_path: Path) -> None:
    """Named links and given values: as they are in the whole."""
    file = written_cell(tmp_path, left=", joints: {waist: 0.1, right_2: 0.7}")
    lines = [row for row in file.read_text().splitlines() if "right_tool0" not in row]
    file.write_text("\n".join(row for row in lines if "robot: right" not in row))
    cell = built_cell(file)
    whole = whole_of(cell, tmp_path)
    q = np.array([0.3, -0.2, 0.4])
    whole.move(values_of(cell, {"left": q}) | {"right_2": 0.7})
    check_places(cell, whole, AuditWorld(cell), {"left": q})
    still = [p.body.name for p in cell.robots[0].model.parts if p.joint < 0]
    assert len(still) == 6
