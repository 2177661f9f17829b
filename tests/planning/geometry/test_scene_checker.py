"""Scene checks against every pair of hulls measured at dense samples.

The exact motion check with a long rod in hand, against dense samples of hull distances.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from planning.cell.shape import box_shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    Clearances,
    Fixture,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.exact import Solid, hull_distance_at, resting_solid
from planning.geometry.robot_bodies import robot_bodies
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_pose
from planning.motion.speed import L1Speed
from planning.motion.transit import RrtConnect
from planning.robots.registry import robot_model
from planning.transforms import Array, from_rpy, identity, translation


def _cell(make_arm: Callable[..., PlacedRobot], seed: int) -> Workcell:
    rng = np.random.default_rng(seed)
    one = make_arm("one")
    two = make_arm("two", from_rpy((0.9, 0.1, 0.0), (0.0, 0.0, 3.0)))
    size = np.array([0.06, 0.12, 0.04])
    brick = box_shape("brick", size)
    objects = tuple(
        CellObject(
            f"brick{k}",
            "brick",
            brick,
            from_rpy(rng.uniform(-0.6, 0.6, 3), rng.uniform(-3, 3, 3)),
        )
        for k in range(6)
    )
    table_size = np.array([2.0, 2.0, 0.02])
    table = Fixture("table", box_shape("table", table_size), translation(0, 0, -0.2))
    return Workcell((one, two), (table,), objects)


def _state(cell: Workcell, held: str | None) -> WorldState:
    attachments = {o.name: Attachment(None, o.start) for o in cell.objects}
    if held is not None:
        attachments["brick0"] = Attachment(held, translation(0.05, 0.0, 0.0))
    configurations = {
        "one": np.zeros(4),
        "two": np.array([0.1, 0.3, -0.2, 0.0]),
    }
    return WorldState(configurations, attachments)


def _least_gap(cell: Workcell, state: WorldState, q: np.ndarray) -> float:
    """Return the least distance over every pair that counts, less its clearance."""
    one, two = cell.robots
    mine = robot_bodies(one).solids
    other = robot_bodies(two).solids
    q_two = state.configurations["two"]
    gaps = []
    for a in mine:
        for b in other:
            gaps.append(hull_distance_at(a, q, b, q_two) - cell.clearances.robot_robot)
    for i in range(len(mine)):
        for j in range(i + 1, len(mine)):
            if (i, j) not in one.model.never_collide:
                gaps.append(hull_distance_at(mine[i], q, mine[j], q))
    boxes = [(f.shape.pieces[0], f.pose, 0.0) for f in cell.fixtures]
    hand = None
    between = cell.clearances.robot_robot
    for item in cell.objects:
        at = state.attachments[item.name]
        if at.holder == "one":
            hand = resting_solid(
                item.name, item.shape.pieces[0], frame_pose(one, q) @ at.pose
            )
        elif at.holder == "two":
            boxes.append(
                (item.shape.pieces[0], frame_pose(two, q_two) @ at.pose, between)
            )
        else:
            boxes.append((item.shape.pieces[0], at.pose, 0.0))
    solids = [(resting_solid("box", body, pose), least) for body, pose, least in boxes]
    for solid, least in solids:
        gaps.extend(hull_distance_at(a, q, solid, q) - least for a in mine)
    if hand is not None:
        gaps.extend(hull_distance_at(hand, q, b, q_two) - between for b in other)
        gaps.extend(
            hull_distance_at(hand, q, solid, q) - least for solid, least in solids
        )
        gaps.extend(hull_distance_at(a, q, hand, q) for a in mine[:3])
    return min(gaps)


@pytest.mark.parametrize("held", [None, "one", "two"])
@pytest.mark.parametrize("seed", range(4))
def test_configurations_agree_with_all_pairs(
    make_arm: Callable[..., PlacedRobot], held: str | None, seed: int
) -> None:
    cell = _cell(make_arm, seed)
    state = _state(cell, held)
    allowed = frozenset({frozenset(("one/tool", "brick0"))} if held == "one" else ())
    checker = SceneChecker(cell, "one", state, allowed)
    rng = np.random.default_rng(seed + 100)
    answers = set()
    for _ in range(60):
        q = rng.uniform(cell.robots[0].model.lower, cell.robots[0].model.upper)
        gap = _least_gap(cell, state, q)
        if abs(gap) < 3e-4:
            continue
        assert checker.configuration_free(q) is (gap > 0)
        contact = checker.contact(q)
        assert (contact is None) is (gap > 0)
        if contact is not None:
            assert contact.distance - contact.limit == pytest.approx(gap, abs=1e-6)
        pairs = checker.pairs_in_contact(q)
        assert (not pairs) is (gap > 0)
        assert contact is None or {contact.moving, contact.obstacle} in pairs
        answers.add(gap > 0)
    assert answers == {True, False} or held == "one"


@pytest.mark.parametrize("seed", range(6))
def test_a_free_motion_is_free_at_every_sample(
    make_arm: Callable[..., PlacedRobot], seed: int
) -> None:
    cell = _cell(make_arm, seed)
    state = _state(cell, None)
    checker = SceneChecker(cell, "one", state)
    rng = np.random.default_rng(seed)
    model = cell.robots[0].model
    for _ in range(12):
        q_a, q_b = rng.uniform(model.lower, model.upper, (2, 4))
        gaps = [
            _least_gap(cell, state, q_a + t * (q_b - q_a))
            for t in np.linspace(0, 1, 60)
        ]
        free = checker.motion_free(q_a, q_b)
        seems = checker.seems_free(q_a, q_b)
        assert seems or not free
        assert checker.configuration_free(q_b) or not seems
        if min(gaps) < 0:
            assert not free
        if min(gaps) > 0.03:
            assert free


@pytest.mark.parametrize("seed", range(4))
def test_a_planned_way_is_free_at_every_sample(
    make_arm: Callable[..., PlacedRobot], seed: int
) -> None:
    cell = _cell(make_arm, seed)
    state = _state(cell, None)
    checker = SceneChecker(cell, "one", state)
    model = cell.robots[0].model
    planner = RrtConnect(model.lower, model.upper, L1Speed())
    rng = np.random.default_rng(seed)
    planned = 0
    for query in range(20):
        start, goal = rng.uniform(model.lower, model.upper, (2, 4))
        if not (checker.configuration_free(start) and checker.configuration_free(goal)):
            continue
        path = planner.plan(checker, start, goal, query)
        if path is None or len(path) == 2:
            continue
        planned += 1
        for a, b in pairwise(path):
            steps = int(np.max(np.abs(b - a)) / 0.01) + 2
            for t in np.linspace(0.0, 1.0, steps):
                assert _least_gap(cell, state, a + t * (b - a)) >= 0.0
        if planned == 3:
            break
    assert planned > 0


def test_an_allowed_pair_is_not_checked(make_arm: Callable[..., PlacedRobot]) -> None:
    arm = make_arm("one")
    size = np.array([0.05, 0.05, 0.05])
    at_tip = frame_pose(arm, np.zeros(4)) @ translation(0.0, 0.0, 0.0)
    brick = CellObject("brick0", "brick", box_shape("brick", size), at_tip)
    cell = Workcell((arm,), (), (brick,))
    state = WorldState({"one": np.zeros(4)}, {"brick0": Attachment(None, at_tip)})
    assert not SceneChecker(cell, "one", state).configuration_free(np.zeros(4))
    pair = frozenset({frozenset(("one/tool", "brick0"))})
    assert SceneChecker(cell, "one", state, pair).configuration_free(np.zeros(4))


LENGTH = 0.5
SAMPLES = 240
GRIP = from_rpy((0.0, 0.0, 0.12), (0.0, 0.0, np.pi / 4))
"""The rod across the fingers, in the flange frame."""

MODEL = robot_model("panda")
PANDA = PlacedRobot("panda", MODEL, identity(), MODEL.home)
HANDED = frozenset({frozenset(("panda/tool", "rod"))})


def box(name: str, size: tuple[float, float, float], at: Array) -> Fixture:
    edges = np.array(size)
    return Fixture(name, box_shape(name, edges), at)


def checker(*fixtures: Fixture) -> tuple[SceneChecker, CellObject]:
    size = np.array([0.02, LENGTH, 0.02])
    rod = CellObject("rod", "rod", box_shape("rod", size), identity())
    cell = Workcell((PANDA,), fixtures, (rod,), Clearances(0.001, 0.0))
    state = WorldState({"panda": PANDA.home}, {"rod": Attachment("panda", GRIP)})
    return SceneChecker(cell, "panda", state, HANDED), rod


def rod_end(q: Array, side: int) -> Array:
    """Return where an end of the rod is, shape (3,)."""
    pose = frame_pose(PANDA, q) @ GRIP
    return np.asarray((pose @ translation(0, side * LENGTH / 2, 0))[:3, 3])


def least_gap(
    rod: CellObject, fixtures: tuple[Fixture, ...], q_a: Array, q_b: Array
) -> tuple[float, float]:
    """Return the least distance at dense samples, and how far anything moves between two.

    Links of the arm that may come near each other without the rod are left out: the rod against
    everything, the arm against the fixtures. The base stands on what it stands on.
    """
    arm = robot_bodies(PANDA).solids
    boxes = [resting_solid(f.name, f.shape.pieces[0], f.pose) for f in fixtures]
    gaps, ends = [], []
    for t in np.linspace(0.0, 1.0, SAMPLES + 1):
        q = q_a + t * (q_b - q_a)
        pose = frame_pose(PANDA, q) @ GRIP
        held: Solid = resting_solid("rod", rod.shape.pieces[0], pose)
        pairs = [(held, other) for other in boxes]
        for part, solid in zip(MODEL.parts, arm, strict=True):
            if part.group != "tool":
                pairs.append((solid, held))
            if part.joint >= 0:
                pairs += [(solid, other) for other in boxes]
        gaps.append(min(hull_distance_at(a, q, b, q) for a, b in pairs))
        ends.append([rod_end(q, side) for side in (-1, 1)])
    steps = np.linalg.norm(np.diff(np.array(ends), axis=0), axis=2)
    return min(gaps), float(steps.max())


TURN_LEFT, TURN_RIGHT = PANDA.home.copy(), PANDA.home.copy()
TURN_LEFT[6] -= 1.2
TURN_RIGHT[6] += 1.2


@pytest.mark.parametrize("at", [0.13, 0.5, 0.77])
@pytest.mark.parametrize("beyond", [-0.006, 0.004])
def test_a_thin_post_at_the_tip_of_a_turning_rod(at: float, beyond: float) -> None:
    """The tip passes the post for a few milliradians only, between any coarse samples."""
    q = TURN_LEFT + at * (TURN_RIGHT - TURN_LEFT)
    pose = frame_pose(PANDA, q) @ GRIP
    # The corners of the rod's end describe a circle; stand the post beyond it.
    radius = np.hypot(LENGTH / 2, 0.01)
    post = box(
        "post", (0.004, 0.004, 0.004), pose @ translation(0, radius + 0.002 + beyond, 0)
    )
    scene, rod = checker(post)
    gap, moved = least_gap(rod, (post,), TURN_LEFT, TURN_RIGHT)
    assert moved < 0.003
    assert (gap < 0) is (beyond < 0)
    assert scene.motion_free(TURN_LEFT, TURN_RIGHT) is (beyond > 0)
    assert scene.motion_free(TURN_RIGHT, TURN_LEFT) is (beyond > 0)
    assert scene.configuration_free(TURN_LEFT)
    assert scene.contact(TURN_LEFT) is None
    if beyond < 0:
        found = scene.contact(q)
        assert found is not None
        assert {found.first, found.second} == {"rod", "post"}


def test_motions_with_a_rod_agree_with_dense_samples() -> None:
    """Random motions of all joints, with a small block near where an end of the rod passes."""
    rng = np.random.default_rng(4)
    free = hit = 0
    for _ in range(16):
        turn = rng.uniform(-1, 1, 7) * np.array([0.5, 0.3, 0.3, 0.4, 0.5, 0.4, 1.2])
        q_a, q_b = PANDA.home - turn, PANDA.home + turn
        middle = q_a + rng.uniform(0.2, 0.8) * (q_b - q_a)
        ends = [rod_end(middle, side) for side in (-1, 1)]
        near, far = sorted(ends, key=lambda end: float(np.linalg.norm(end[:2])))
        outward = (far - near) / LENGTH
        at = far + rng.uniform(-0.01, 0.1) * outward + rng.normal(0.0, 0.005, 3)
        block = box("block", (0.02, 0.02, 0.02), translation(*at))
        scene, rod = checker(block)
        gap, moved = least_gap(rod, (block,), q_a, q_b)
        found = scene.motion_free(q_a, q_b)
        if gap < 0:
            assert not found
            hit += 1
        elif gap > moved:  # nothing can come in between two samples
            assert found
            free += 1
    assert free >= 4
    assert hit >= 4
