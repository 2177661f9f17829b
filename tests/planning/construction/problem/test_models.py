"""The models: as many parts as the paper's, sizes and masses that exist, a supply that fits."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import permutations

import numpy as np
import pytest

from planning.construction.problem.models import ModelPart, pavilion, tower, wall, well
from planning.construction.problem.problem import face_grips
from planning.construction.problem.supply_layout import (
    Rows,
    Spiral,
    pose_on_ground,
    supply_poses,
)
from planning.transforms import Array, identity, read_only_copy

MODELS: dict[str, Callable[[], tuple[ModelPart, ...]]] = {
    "tower": tower,
    "wall": wall,
    "well": well,
    "pavilion": pavilion,
}
COUNTS = {"tower": 15, "wall": 36, "well": 52, "pavilion": 113}


@pytest.mark.parametrize("name", MODELS)
def test_models_have_the_numbers_of_the_paper(name: str) -> None:
    parts = MODELS[name]()
    assert len(parts) == COUNTS[name]
    assert len({part.name for part in parts}) == len(parts)
    for part in parts:
        assert 1.0 < part.mass < 14.0  # the iiwa 14 carries 14 kg
        density = part.mass / float(np.prod(part.size))
        assert 100.0 < density < 800.0
        turn = part.goal[:3, :3]
        assert np.allclose(turn @ turn.T, np.eye(3))
        assert np.linalg.det(turn) == pytest.approx(1.0)


def test_no_two_cassettes_are_alike() -> None:
    sizes = [tuple(np.round(part.size, 5)) for part in pavilion()]
    assert len(set(sizes)) == len(sizes)


def test_inner_faces_of_an_arch_touch_its_circle() -> None:
    for part in pavilion((17,)):
        inner = part.goal @ np.array((0.0, 0.0, -0.5 * part.size[2], 1.0))
        radius = 0.4 / (2.0 * math.tan(math.pi / 34.0))
        assert np.hypot(inner[0], inner[2]) == pytest.approx(radius)


def test_cassettes_are_held_from_the_side_that_is_free() -> None:
    for part in pavilion():
        face = part.faces[0]
        inside = face == "-z"
        assert inside == (np.degrees(math.asin(part.goal[2, 2])) > 50.0)


@pytest.mark.parametrize("faces", [("+x",), ("-x",), ("-y", "+z"), ("+z",), ("-z",)])
def test_parts_lie_on_the_ground_with_their_first_face_up(
    faces: tuple[str, ...],
) -> None:
    part = ModelPart("p", read_only_copy((0.3, 0.2, 0.1)), 1.0, identity(), faces)
    pose = pose_on_ground(part)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    axis, sign = "xyz".index(faces[0][1]), 1.0 if faces[0][0] == "+" else -1.0
    assert np.allclose(pose[:3, axis], (0.0, 0.0, sign))
    assert pose[2, 3] == pytest.approx(part.size[axis] / 2.0)
    # The longest edge of that face points along x: away from the middle of the site.
    longest = max((k for k in range(3) if k != axis), key=lambda k: part.size[k])
    assert np.allclose(np.abs(pose[:3, longest]), (1.0, 0.0, 0.0))
    # A pad on that face points straight down.
    touch = face_grips(part.size, faces)[0].touch
    assert np.allclose((pose @ touch)[:3, 2], (0.0, 0.0, -1.0))
    assert (pose @ touch)[2, 3] == pytest.approx(part.size[axis])


def test_the_spiral_is_that_of_the_paper() -> None:
    poses = supply_poses(wall(), Spiral())
    for k, part in enumerate(wall()):
        at = poses[part.name][:3, 3]
        assert np.hypot(at[0], at[1]) == pytest.approx(3.0 + 0.05 * k)
        turn = math.remainder(math.atan2(at[1], at[0]) - 0.5 * k, 2.0 * math.pi)
        assert turn == pytest.approx(0.0, abs=1e-9)


def test_parts_across_the_radius() -> None:
    along = supply_poses(wall(), Spiral())
    across = supply_poses(wall(), Spiral(across=True))
    for name, pose in across.items():
        assert np.allclose(pose[:3, 3], along[name][:3, 3])
        outwards = pose[:2, 3] / np.linalg.norm(pose[:2, 3])
        # The blocks' long edge is x.
        assert pose[:2, 0] @ outwards == pytest.approx(0.0, abs=1e-9)
        assert along[name][:2, 0] @ outwards == pytest.approx(1.0)


def test_parts_lie_near_where_they_belong() -> None:
    few = well(5, 1)
    for layout in (Spiral(), Rows((2.0, 0.0), 3, (0.7, 0.4))):
        spots = [spot[:2, 3] for spot in layout.spots(len(few))]

        def cost(order: tuple[int, ...], spots: list[Array] = spots) -> float:
            pairs = zip(few, order, strict=True)
            return sum(float(np.sum((spots[k] - p.goal[:2, 3]) ** 2)) for p, k in pairs)

        poses = supply_poses(few, layout, near=True)
        chosen = tuple(
            next(k for k, s in enumerate(spots) if np.allclose(s, poses[p.name][:2, 3]))
            for p in few
        )
        assert sorted(chosen) == list(range(5))
        best = min(cost(order) for order in permutations(range(5)))
        assert cost(chosen) == pytest.approx(best)
        assert cost(chosen) < cost(tuple(range(5)))


def test_rows_fill_one_after_another() -> None:
    layout = Rows((2.0, 0.0), 3, (0.7, 0.4), yaw=math.pi / 2)
    at = np.array([spot[:2, 3] for spot in layout.spots(5)])
    expected = [(2.7, 0.0), (2.0, 0.0), (1.3, 0.0), (2.7, 0.4), (2.0, 0.4)]
    assert np.allclose(at, expected)


def test_grips_off_a_face_are_left_out() -> None:
    size = read_only_copy((0.6, 0.2, 0.1))
    grips = face_grips(size, ("+z", "+y"), (0.0, 0.25, -0.25, 0.4))
    assert [grip.touch[:3, 3].tolist() for grip in grips] == [
        [x, y, z] for x in (0.0, 0.25, -0.25) for y, z in ((0.0, 0.05), (0.1, 0.0))
    ]
    for grip in grips:
        held = grip.held(0.7)
        # The part lies in front of the pad, its touched face on the pad's plane.
        corners = np.array(
            [(x, y, z, 2.0) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
        ) * [*size, 1.0]
        heights = (held @ (corners / 2.0).T)[2]
        assert heights.min() == pytest.approx(0.0, abs=1e-12)
