"""Bars of a truss: their places, where they lie before, and how they come in."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.trusses.structures import Structure
from planning.cell.forms import Cylinder
from planning.cell.shape import Element, shape_of
from planning.cell.workcell import CellObject
from planning.contacts.contact_graph import near_to
from planning.transforms import Array, Transform, identity, readonly

RADIUS = 0.008
"""Of the bars [m]."""

CUT = 0.011
"""Bars end so far before their nodes [m]."""

POST = 0.12
"""Height of the posts [m]."""

_WALL = 0.0015
"""Of the bars, which are tubes of steel [m]."""

_COLOURS = [[120, 81, 45], [88, 118, 152], [201, 162, 75], [86, 140, 96]]

Bar = tuple[Transform, float]
"""Pose of a bar, its axis along z, and its length [m]."""


def between(first: Array, second: Array) -> Bar:
    """Return the pose of a bar between two nodes, and its length."""
    way = second - first
    long = float(np.linalg.norm(way))
    z = way / long
    lean = math.degrees(math.acos(float(np.clip(z[2], -1.0, 1.0))))
    bearing = math.degrees(math.atan2(z[1], z[0]))
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("yz", [lean, bearing], degrees=True).as_matrix()
    pose[:3, 3] = 0.5 * (first + second)
    return readonly(pose), long - 2.0 * CUT


def written(pose: Transform) -> dict[str, Any]:
    """Return a pose as scenarios say it."""
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return {
        "xyz_m": [round(float(v), 5) for v in pose[:3, 3]],
        "quat_wxyz": [round(float(v), 6) for v in (w, x, y, z)],
    }


def parts(
    structure: Structure, nodes: Array, names: list[str], bars: list[Bar], away: float
) -> Iterator[dict[str, Any]]:
    """Yield the bars; each lies beside the arm that is nearer to its place, the first ones nearest.

    Args:
        structure: what is built.
        nodes: their places, shape (n, 3) [m].
        names: of the bars.
        bars: in their places.
        away: how far from the middle the arms stand [m].
    """
    lying = {-1.0: 0, 1.0: 0}
    for k, (pose, length) in enumerate(bars):
        x = float(pose[0, 3])
        near = math.copysign(1.0, x) if abs(x) > 0.03 else 0.0
        # In the middle the arm is taken that has had fewer.
        side = near or min(lying, key=lambda s: (lying[s], -s))
        start = _rack(side, lying[side], away, crowded=len(bars) >= 30)
        lying[side] += 1
        upright = abs(pose[2, 2]) > 0.9
        # What stands upright is gripped from the side of the arm, where it lies from above.
        if upright:
            pose = _facing(pose, np.array([-side, 0.0, 0.0]))
        aside = {"directions": [[0, 0, -1], [-side, 0, 0]], "steepest_deg": 45}
        weight = 7800 * math.pi * (RADIUS**2 - (RADIUS - _WALL) ** 2) * length
        yield {
            "name": names[k],
            **({"grips": aside} if upright else {}),
            "shape": {"cylinder": {"radius_m": RADIUS, "length_m": round(length, 5)}},
            "start": {"xyz_m": [*start, RADIUS], "rpy_deg": [0, 90, 0]},
            "goal": written(pose),
            "mass_kg": round(weight, 3),
            "colour": _COLOURS[k // 6 % len(_COLOURS)],
            "insert": _way_in(k, bars, structure, nodes),
        }


def deepest(structure: Structure, nodes: Array, poses: list[Bar]) -> float:
    """Return how deep bars, and bars and posts, are in each other at most, rounded up [m]."""
    bars = [_solid(Cylinder(RADIUS, length), pose) for pose, length in poses]
    pairs = [
        (bars[i], bars[j])
        for (i, one), (j, two) in combinations(enumerate(structure.bars), 2)
        if set(one) & set(two)
    ]
    for k, ends in enumerate(structure.bars):
        pairs += [(bars[k], _post(nodes, n)) for n in ends if n in structure.ground]
    gaps = [near_to(one, {"": other}, 0.0).get("", 0.0) for one, other in pairs]
    return (math.ceil(-min(gaps) * 1e3) + 1) / 1e3


def _facing(pose: Transform, way: Array) -> Transform:
    """Return the pose of a bar, turned about its axis so that x of its frame points along a way."""
    turned = pose.copy()
    angle = math.atan2(float(pose[:3, 1] @ way), float(pose[:3, 0] @ way))
    turned[:3, :3] = pose[:3, :3] @ Rotation.from_euler("z", angle).as_matrix()
    return readonly(turned)


def _rack(
    side: float, place: int, away: float, *, crowded: bool
) -> tuple[float, float]:
    """Return where a bar lies, along x: before and behind an arm in turn, in one column or two."""
    column, place = (place % 2, place // 2) if crowded else (0, place)
    row, front = place // 2, (-1.0 if place % 2 else 1.0)
    x = side * (away - 0.18 + 0.36 * column)
    return round(x, 4), round(-front * (0.26 + 0.06 * row), 4)


def _solid(form: Cylinder, pose: Transform) -> tuple[CellObject, Transform]:
    shape = shape_of("bar", [Element(form, readonly(identity()))])
    return CellObject("bar", "bar", shape, pose), pose


def _post(nodes: Array, node: int) -> tuple[CellObject, Transform]:
    pose = identity()
    pose[:3, 3] = nodes[node]
    pose[2, 3] = 0.5 * POST
    return _solid(Cylinder(0.026, POST), readonly(pose))


def _way_in(k: int, bars: list[Bar], structure: Structure, nodes: Array) -> list[float]:
    """Return the direction in which a bar comes to its place: down where nothing is in the way.

    Else level, across itself; on the way in it is clear of what is there until the last.
    """
    pose, length = bars[k]
    there = [_solid(Cylinder(RADIUS, long), at) for at, long in bars[:k]]
    there += [_post(nodes, n) for n in structure.ground]
    across = np.cross(pose[:3, 2], [0.0, 0.0, 1.0])
    across /= max(float(np.linalg.norm(across)), 1e-9)
    if pose[:3, 3] @ across > 0.0:
        across = -across
    down = np.array([0.0, 0.0, -1.0])
    for way in (down, across + down, across, -across + down, -across):
        way = way / np.linalg.norm(way)
        before = pose.copy()
        before[:3, 3] -= 0.05 * way
        bar = _solid(Cylinder(RADIUS, length), readonly(before))
        if not any(near_to(bar, {"": other}, 0.005) for other in there):
            return [round(float(v), 5) for v in way]
    return down.tolist()
