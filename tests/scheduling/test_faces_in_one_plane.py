"""Distances of hulls with faces in one plane, at which coal fails in one order of the two."""

from collections.abc import Iterable

import numpy as np
import pytest

from planning.cell.body import ConvexBody
from planning.cell.cover import capsule_cover
from planning.geometry.exact import hull_distance, hull_shape, resting_solid
from planning.transforms import translation
from scheduling.witness.parts import coal_pose, shape_distance

HIGH = 0.00600000005215406
CORNERS = {
    "a": (0.01686247624456882, 0.01558469794690609),
    "b": (0.04500000178813934, 0.02800000086426735),
    "c": (0.04500000178813934, -0.02800000086426735),
    "d": (0.01803012005984783, -0.01834767311811447),
    "e": (0.01560570113360882, 0.01501074805855751),
    "f": (0.01756582409143448, -0.0196489542722702),
}
# Of pieces of plates with holes, corners of the upper side with capital letters.
PLATE, WEDGE = "abcdeAEDCB", "CFfcDd"
ABOVE = np.array(
    [
        [1.0, 2.1186078733180848e-16, -9.5832158804051528e-13, -4.0417495739131226e-12],
        [
            -7.9147011280561209e-17,
            1.0000000000000002,
            1.1735450537943630e-16,
            1.1463398814176048e-16,
        ],
        [9.5835595416799595e-13, -1.1735606897120214e-16, 1.0, 5.0000000001223177e-02],
        [0.0, 0.0, 0.0, 1.0],
    ]
)


def piece(letters: Iterable[str]) -> ConvexBody:
    points = [
        (*CORNERS[letter.lower()], HIGH if letter.isupper() else -HIGH)
        for letter in letters
    ]
    corners = np.array(points)
    return ConvexBody("own", corners, capsule_cover(corners))


@pytest.mark.parametrize("seed", range(12))
def test_hulls_that_rest_on_each_other_touch(seed: int) -> None:
    """Whether coal fails depends on the order of the corners: it does so for about half of them."""
    order = np.random.default_rng(seed).permutation
    placed = [
        (piece(order([*PLATE])), ABOVE),
        (piece(order([*WEDGE])), translation(0.0, 0.0, 0.038)),
    ]
    (one, at), (other, there) = placed
    poses = coal_pose(at), coal_pose(there)
    shapes = hull_shape(one), hull_shape(other)
    found = shape_distance(shapes[0], poses[0], shapes[1], poses[1])
    assert abs(found) < 1e-9
    solids = [resting_solid("own", body, pose) for body, pose in placed]
    assert abs(hull_distance(solids[0], poses[0], solids[1], poses[1])) < 1e-9
