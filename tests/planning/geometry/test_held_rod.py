"""The exact motion check with a long rod in hand, against dense samples of hull distances.

A rod's ends move far while joints turn little, and they are thin: what is easily missed.
"""

from __future__ import annotations

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
from planning.geometry.exact import Solid, distance_at, resting_solid
from planning.geometry.robot_bodies import robot_bodies
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_pose
from planning.robots.registry import robot_model
from planning.transforms import Array, from_rpy, identity, translation

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
        gaps.append(min(distance_at(a, q, b, q) for a, b in pairs))
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
