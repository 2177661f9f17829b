"""A skill tried in a scene that is cleared as it goes, against one built anew every time."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.shape import box_shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    Clearances,
    PlacedRobot,
    Workcell,
)
from planning.geometry.exact import resting_solid
from planning.geometry.robot_bodies import robot_bodies
from planning.geometry.scene_checker import BodyPair
from planning.geometry.standing import StandingBoxes
from planning.handling.skill_contacts import SkillContacts, ToolContact
from planning.handling.skill_scene import SkillScene
from planning.handling.skill_targets import SkillTargets, Subgoal, skill_postures
from planning.handling.skill_trial import (
    PathObstacle,
    ResolvedSkill,
    SkillTrial,
    find_obstruction,
    resolve_skill,
)
from planning.kinematics.kinematics import frame_pose, joint_poses_of
from planning.robots.registry import robot_model
from planning.steps.skill import Obstruction, SkillPath, contacts_with
from planning.transforms import Transform, read_only_copy, translation

MODEL = robot_model("gp4")
ROBOT = PlacedRobot("arm", MODEL, read_only_copy(np.eye(4)), MODEL.home)
OTHER = PlacedRobot("other", MODEL, read_only_copy(translation(0.9, 0, 0)), MODEL.home)
CELL = Workcell((ROBOT, OTHER), (), (), Clearances(0.001, 0.0))
NONE: frozenset[frozenset[str]] = frozenset()
GRIP = frozenset({frozenset({"arm/tool", "part"})})
WAY = MODEL.home + np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.2, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ]
)


def item(name: str, pose: Transform) -> tuple[CellObject, Attachment]:
    size = read_only_copy([0.016, 0.032, 0.0096])
    return (
        CellObject(name, "2x4", box_shape(name, size), read_only_copy(pose)),
        Attachment(None, read_only_copy(pose)),
    )


def scene_on_the_way(
    where: Sequence[tuple[float, float, float, float]], *, change: bool
) -> tuple[SkillScene, SkillPath]:
    """Bricks around the tool on its way, and a part that is gripped half-way through."""
    objects = {}
    for k, (share, x, y, z) in enumerate(where):
        leg = min(int(share), 2)
        q = WAY[leg] + (share - leg) * (WAY[leg + 1] - WAY[leg])
        pose = frame_pose(ROBOT, q, "tool") @ translation(x, y, z)
        objects[f"b{k}"] = item(f"b{k}", pose)
    handed = None
    if change:
        objects["part"] = item("part", frame_pose(ROBOT, WAY[2], "tool"))
        handed = (
            "part",
            Attachment("arm", read_only_copy(translation(0.0, 0.0, 0.12))),
        )
    contacts = SkillContacts(NONE, GRIP, GRIP)
    home = {"arm": MODEL.home, "other": MODEL.home}
    path = SkillPath("pick", "arm", WAY[:1], WAY[1:], 2 if change else None)
    return SkillScene(CELL, objects, home, contacts, handed), path


def clear_by_hand(
    path: SkillPath, scene: SkillScene, loose: Collection[str]
) -> tuple[Obstruction | None, list[str]]:
    """Take away one obstacle after another, and start all over again each time."""
    gone: list[str] = []
    while True:
        found = find_obstruction(path, scene)
        if found is None or found.by is None or found.by not in loose:
            return found, gone
        gone.append(found.by)
        kept = {k: v for k, v in scene.objects.items() if k != found.by}
        scene = replace(scene, objects=kept)


bricks = st.lists(
    st.tuples(
        st.floats(0.0, 3.0),
        st.floats(-0.06, 0.06),
        st.floats(-0.06, 0.06),
        st.floats(-0.04, 0.04),
    ),
    min_size=1,
    max_size=8,
)


@settings(max_examples=40, deadline=None)
@given(bricks, st.booleans(), st.sets(st.integers(0, 7)))
def test_going_on_is_starting_all_over_again(
    where: Sequence[tuple[float, float, float, float]], change: bool, fast: set[int]
) -> None:
    scene, path = scene_on_the_way(where, change=change)
    loose = {f"b{k}" for k in range(8) if k not in fast}
    trial = SkillTrial(path, scene)
    assert trial.found == find_obstruction(path, scene)
    expected, gone = clear_by_hand(path, scene, loose)
    assert trial.remove_obstacles(loose) == expected
    assert trial.gone == gone


@settings(max_examples=15, deadline=None)
@given(
    bricks,
    st.booleans(),
    st.lists(st.floats(-0.05, 0.05), min_size=2, max_size=3),
)
def test_paths_that_share_checkers_are_checked_as_if_alone(
    where: Sequence[tuple[float, float, float, float]],
    change: bool,
    shifts: Sequence[float],
) -> None:
    """What earlier paths of a scene came near to does not change what blocks a later one."""
    scene, path = scene_on_the_way(where, change=change)
    for shift in shifts:
        other = replace(path, path=path.path + shift)
        alone = find_obstruction(other, replace(scene))
        assert find_obstruction(other, scene) == alone


@pytest.mark.parametrize("change", [False, True])
def test_what_is_in_the_way_is_found_and_taken_away(change: bool) -> None:
    scene, path = scene_on_the_way([(0.5, 0, 0, 0), (2.5, 0, 0, 0)], change=change)
    trial = SkillTrial(path, scene)
    assert isinstance(trial.found, Obstruction)
    assert trial.found.by == "b0"
    assert trial.remove_obstacles({"b0"}) is not None
    assert trial.remove_obstacles({"b0", "b1"}) is None
    assert trial.gone == ["b0", "b1"]


def resolve_by_trials(
    ways: Iterable[SkillTargets], scene: SkillScene, loose: Collection[str]
) -> ResolvedSkill | Obstruction:
    """Try every way in every posture; the reason is the most telling one of the first way."""
    reason: Obstruction | None = None
    for targets in ways:
        paths = list(skill_postures(ROBOT, targets))
        for taken in ((), loose):
            left = []
            for path in paths:
                if isinstance(path, Obstruction):
                    left.append(path)
                    continue
                trial = SkillTrial(path, scene)
                found = trial.remove_obstacles(taken)
                if found is None:
                    return trial.resolved()
                left.append(found)
            most = next((found for found in left if found.by is not None), left[0])
            if most.by not in loose:
                break
        reason = reason or most
    assert reason is not None
    return reason


def ways_along(shifts: Sequence[tuple[float, float]]) -> Iterator[SkillTargets]:
    """The skill of scene_on_the_way as poses of the tool, shifted a little."""
    for x, y in shifts:
        poses = [frame_pose(ROBOT, q, "tool") @ translation(x, y, 0.0) for q in WAY]
        yield SkillTargets("pick", tuple(Subgoal("to", "tool", p) for p in poses), 2)


at_waypoints = st.tuples(
    st.one_of(st.integers(0, 3), st.floats(0.0, 3.0)),
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    # Some beside the tool, some beside what carries it.
    st.one_of(st.floats(-0.03, 0.03), st.floats(-0.5, -0.1)),
)
little = st.sampled_from([0.0, 0.005, -0.005, 0.02, -0.02, 0.05])


@settings(max_examples=40, deadline=None)
@given(
    st.lists(at_waypoints, min_size=1, max_size=3),
    st.lists(st.tuples(little, little), min_size=2, max_size=4),
    *[st.sets(st.integers(0, 2))] * 3,
)
def test_what_refused_one_path_refuses_no_path_that_is_free(
    where: Sequence[tuple[float, float, float, float]],
    shifts: Sequence[tuple[float, float]],
    fast: set[int],
    meant: set[int],
    leaning: set[int],
) -> None:
    scene, _ = scene_on_the_way(where, change=True)
    during = GRIP | contacts_with("arm/tool", [f"b{k}" for k in meant])
    tool = ToolContact(0.001, 0.003, frozenset(f"b{k}" for k in leaning))
    scene = replace(scene, contacts=SkillContacts(NONE, during, GRIP), tool=tool)
    loose = {f"b{k}" for k in range(6) if k not in fast}
    ways = list(ways_along(shifts))
    found = resolve_skill(ROBOT, ways, scene, loose)
    expected = resolve_by_trials(ways, scene, loose)
    if isinstance(expected, Obstruction):
        assert found == expected
    else:
        assert isinstance(found, ResolvedSkill)
        assert (found.gone, found.touched) == (expected.gone, expected.touched)
        assert np.array_equal(found.path.waypoints, expected.path.waypoints)


@pytest.mark.parametrize("at", [0, 1])
@pytest.mark.parametrize("fast", [set(), {0}, {1}, {0, 1}])
def test_a_way_beside_what_refused_the_first_one_is_found(
    at: int, fast: set[int]
) -> None:
    where = [(at, 0, 0, 0), (3, 0, 0, 0)]
    scene = replace(
        scene_on_the_way(where, change=False)[0],
        contacts=SkillContacts(NONE, NONE, NONE),
        tool=ToolContact(0.001, 0.003),
    )
    loose = {f"b{k}" for k in range(2) if k not in fast}
    free = 0
    for aside in (0.02, 0.04, 0.06, 0.08, 0.1):
        ways = list(ways_along([(0, 0), (0, aside)]))
        ways = [replace(targets, change_at=None) for targets in ways]
        found = resolve_skill(ROBOT, ways, scene, loose)
        expected = resolve_by_trials(ways, scene, loose)
        assert isinstance(found, Obstruction) == isinstance(expected, Obstruction)
        free += not isinstance(found, Obstruction)
    assert free


@pytest.mark.parametrize("at", [0, 1])
def test_what_may_be_gone_refuses_no_other_path(at: int) -> None:
    where = [(at, 0, 0, 0), (3, 0, 0, 0)]
    scene, _ = scene_on_the_way(where, change=False)
    scene = replace(scene, contacts=SkillContacts(NONE, NONE, NONE))
    one, aside = (
        replace(targets, change_at=None) for targets in ways_along([(0, 0), (0.06, 0)])
    )
    other = replace(one, subgoals=(*one.subgoals[:-1], aside.subgoals[-1]))
    refused = resolve_skill(ROBOT, [one], scene, {"b0"})
    assert isinstance(refused, Obstruction)
    assert refused.by == "b1"
    found = resolve_skill(ROBOT, [one, other], scene, {"b0"})
    assert isinstance(found, ResolvedSkill)
    assert found.gone == {"b0"}


def test_what_refuses_poses_refuses_every_posture_through_them() -> None:
    targets = next(ways_along([(0, 0)]))
    targets = replace(targets, subgoals=targets.subgoals[:2], change_at=None)
    paths = [p for p in skill_postures(ROBOT, targets) if isinstance(p, SkillPath)]
    bodies, refused = robot_bodies(ROBOT).solids, set()
    # A brick where each body is at some of the poses, and each body against it.
    for body, before in product(bodies, (True, False)):
        pose = joint_poses_of(ROBOT, WAY[0 if before else 1])[body.joint + 1]
        brick = item("brick", pose @ translation(*body.vertices.mean(axis=0)))
        at_rest = resting_solid("brick", brick[0].shape.pieces[0], brick[1].pose)
        for other in bodies:
            pair = BodyPair(other, at_rest, 0.001, together=False)
            hindrance = PathObstacle(before, 0 if before else -1, pair)
            if hindrance.refuses_all(ROBOT, targets):
                refused.add(other.joint)
                assert all(hindrance.refuses(path) for path in paths)
    assert refused == {MODEL.dof - 1}


def test_a_brick_in_the_way_of_all_paths_is_looked_at_as_a_whole_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, _ = scene_on_the_way([(0, 0, 0, 0)], change=True)
    near, tried = SkillScene.near, []

    def counted(scene: SkillScene, path: SkillPath) -> StandingBoxes:
        tried.append(path)
        return near(scene, path)

    monkeypatch.setattr(SkillScene, "near", counted)
    found = resolve_skill(ROBOT, ways_along([(0, 0), (0.001, 0), (0, 0.001)]), scene)
    assert isinstance(found, Obstruction)
    assert found.by == "b0"
    assert len(tried) == 1
