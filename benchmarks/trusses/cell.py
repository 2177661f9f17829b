"""A cell that puts up a structure of round bars: arms, posts, stock and the steps, as a scenario."""

from __future__ import annotations

import math
from collections import defaultdict
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

_COLOURS = [[120, 81, 45], [88, 118, 152], [201, 162, 75], [86, 140, 96]]


def truss_scenario(
    name: str, structure: Structure, *, arms: int = 3, find: bool = False
) -> dict[str, Any]:
    """Return a scenario in which arms put up a structure.

    Every bar is welded where it meets others, at each of its ends; on posts clips hold it.

    Args:
        name: of the scenario.
        structure: what is built.
        arms: how many robots: one welds, of four two do.
        find: whether the order of the steps is to be found.
    """
    nodes = structure.nodes + np.array([0.0, 0.0, POST])
    names = [f"bar{k + 1}" for k in range(len(structure.bars))]
    poses = [_between(nodes[a], nodes[b]) for a, b in structure.bars]
    places, welds, joined = _steps(structure, nodes, names)
    steps: list[Any] = [*places, *(w for own in welds for w in own)]
    if not find:
        steps = [
            s for place, own in zip(places, welds, strict=True) for s in (place, *own)
        ]
    return {
        "version": 1,
        "name": name,
        "cell": {
            "tools": _tools(),
            "robots": list(_robots(arms)),
            "fixtures": list(_fixtures(structure, nodes, arms)),
        },
        "assembly": {
            "kind": "assembly",
            "approach_m": 0.05,
            "leave_m": 0.05,
            "touch_m": 0.006,
            "grips": {"positions": 5, "steepest_deg": 75},
            "parts": [
                _part(k, names[k], *poses[k], len(names))
                | {"insert": _way_in(k, poses, structure, nodes)}
                for k in range(len(names))
            ],
            "processes": {
                "weld": {
                    "duration": {"kind": "lognormal", "median_s": 4, "p95_s": 5.5},
                    "tool": "torch",
                }
            },
            "order": "find" if find else "listed",
            "steps": steps,
            "joined": joined,
            "joined_overlap_m": _deepest(structure, nodes, poses),
        },
        "planning": {"speed_model": "joint"},
        "execution": {
            "skills": {
                "pick": {"kind": "lognormal", "median_s": 1.2, "p95_s": 1.8},
                "place-down": {"kind": "lognormal", "median_s": 1.5, "p95_s": 2.2},
            }
        },
    }


def _between(first: Array, second: Array) -> tuple[Transform, float]:
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


def _pose(pose: Transform) -> dict[str, Any]:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return {
        "xyz_m": [round(float(v), 5) for v in pose[:3, 3]],
        "quat_wxyz": [round(float(v), 6) for v in (w, x, y, z)],
    }


def _part(
    k: int, name: str, pose: Transform, length: float, count: int
) -> dict[str, Any]:
    """Return a bar; it lies beside one of two arms, before or behind it, nearest ones first."""
    side, place = (-1.0 if k % 2 else 1.0), k // 2
    column, place = (0, place) if count < 30 else (place % 2, place // 2)
    row, front = place // 2, (-1.0 if place % 2 else 1.0)
    xy = side * (0.42 + 0.36 * column), -front * (0.26 + 0.06 * row)
    start = {"xyz_m": [*(round(v, 4) for v in xy), RADIUS], "rpy_deg": [0, 90, 0]}
    upright = abs(pose[2, 2]) > 0.9
    # What stands upright is gripped from the side.
    aside = {"grips": {"directions": [[0, 0, -1], [-side, 0, 0]], "steepest_deg": 45}}
    return {
        "name": name,
        **(aside if upright else {}),
        "shape": {"cylinder": {"radius_m": RADIUS, "length_m": round(length, 5)}},
        "start": start,
        "goal": _pose(pose),
        "mass_kg": round(7800 * math.pi * (RADIUS**2 - 0.0065**2) * length, 3),
        "colour": _COLOURS[k // 6 % len(_COLOURS)],
    }


def _steps(
    structure: Structure, nodes: Array, names: list[str]
) -> tuple[list[Any], list[list[Any]], list[Any]]:
    """Return the places, the welds of each bar, and what is joined."""
    there: dict[int, list[int]] = defaultdict(list)
    welds: list[list[Any]] = []
    joined: list[Any] = []
    for k, ends in enumerate(structure.bars):
        own = []
        # The end is welded first that is away from the arm in whose rack the bar lies.
        side = -1.0 if k % 2 else 1.0
        for node in sorted(ends, key=lambda n: side * nodes[n][0]):
            others = [names[other] for other in there[node]]
            by: dict[str, Any] = {}
            if node in structure.ground:
                joined.append([f"post{node + 1}", names[k]])
            elif others:
                step = f"weld_{names[k]}_{node + 1}"
                by = {"by": step}
                at = {"pose": _torch_place(structure, nodes, node, k)}
                own.append(
                    {
                        "process": "weld",
                        "at": at,
                        "name": step,
                        "after": [names[k], *others],
                    }
                )
            joined += [{"parts": [other, names[k]], **by} for other in others]
            there[node].append(k)
        welds.append(own)
    return list(names), welds, joined


def _torch_place(
    structure: Structure, nodes: Array, node: int, bar: int
) -> dict[str, Any]:
    """Return where the torch comes to a node: from where bars leave it most room, never from below."""
    ways = []
    for k, ends in enumerate(structure.bars):
        if node in ends and k <= bar:
            (other,) = set(ends) - {node}
            way = nodes[other] - nodes[node]
            ways.append(way / np.linalg.norm(way))
    # Towards the welder, from above.
    out = np.array([0.0, 0.5, 0.6]) - nodes[node]
    out[2] = max(out[2], 0.0) + 0.3
    out /= np.linalg.norm(out)
    tried = []
    for lean in np.radians([0, 25, 50, 70]):
        for turn in np.radians(np.arange(0, 360, 30)):
            z = np.array(
                [
                    math.sin(lean) * math.cos(turn),
                    math.sin(lean) * math.sin(turn),
                    math.cos(lean),
                ]
            )
            room = -max(float(z @ way) for way in ways)
            tried.append((min(room, -0.3) + 0.6 * float(z @ out), tuple(z)))
    z = np.array(max(tried)[1])
    new = ways[-1]
    # On the surface of the new bar, where it comes nearest to the node.
    aside = z - (z @ new) * new
    at = nodes[node] + (CUT + 0.002) * new + RADIUS * aside / np.linalg.norm(aside)
    lean, bearing = math.acos(float(z[2])), math.atan2(z[1], z[0])
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("yz", [lean, bearing]).as_matrix()
    pose[:3, 3] = at
    return _pose(pose)


def _solid(form: Cylinder, pose: Transform) -> tuple[CellObject, Transform]:
    shape = shape_of("bar", [Element(form, readonly(identity()))])
    return CellObject("bar", "bar", shape, pose), pose


def _post(nodes: Array, node: int) -> tuple[CellObject, Transform]:
    pose = identity()
    pose[:3, 3] = nodes[node]
    pose[2, 3] = 0.5 * POST
    return _solid(Cylinder(0.026, POST), readonly(pose))


def _way_in(
    k: int, poses: list[tuple[Transform, float]], structure: Structure, nodes: Array
) -> list[float]:
    """Return the direction in which a bar comes to its place: down where nothing is in the way.

    Else level, across itself; on the way in it is clear of what is there until the last.
    """
    pose, length = poses[k]
    there = [_solid(Cylinder(RADIUS, long), at) for at, long in poses[:k]]
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


def _deepest(
    structure: Structure, nodes: Array, poses: list[tuple[Transform, float]]
) -> float:
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


def _fixtures(
    structure: Structure, nodes: Array, arms: int
) -> Iterator[dict[str, Any]]:
    yield {
        "name": "table",
        "size_m": [2.2, 2.2, 0.04],
        "pose": {"xyz_m": [0, -0.1, -0.02]},
    }
    for number, robot in enumerate(_robots(arms), start=1):
        x, y, z = robot["base"]["xyz_m"]
        if z:
            yield {
                "name": f"pedestal{number}",
                "size_m": [0.18, 0.18, z],
                "pose": {"xyz_m": [x, y, z / 2]},
            }
    for node in sorted(structure.ground):
        x, y, _ = (round(float(v), 5) for v in nodes[node])
        yield {
            "name": f"post{node + 1}",
            "shape": {"cylinder": {"radius_m": 0.026, "length_m": POST}},
            "pose": {"xyz_m": [x, y, POST / 2]},
        }


def _robots(arms: int) -> Iterator[dict[str, Any]]:
    places = [
        ("left", "gripper", (-0.6, 0.0, 0.15), 0),
        ("welder", "torch", (0.0, 0.55, 0.3), -90),
        ("right", "gripper", (0.6, 0.0, 0.15), 180),
        ("welder2", "torch", (0.0, -0.75, 0.3), 90),
    ]
    for name, tool, (x, y, z), yaw in places[:arms]:
        # Torches wait where they are in nobody's way.
        away = {"home_deg": [0, -150, 140, -80, -90, 0]} if tool == "torch" else {}
        yield {
            "name": name,
            "model": "ur5e",
            "tool": tool,
            **away,
            "base": {"xyz_m": [x, y, z], "rpy_deg": [0, 0, yaw]},
        }


def _tools() -> dict[str, Any]:
    def box(size: list[float], at: list[float]) -> dict[str, Any]:
        return {"box": size, "pose": {"xyz_m": at}}

    def rod(radius: float, length: float, z: float) -> dict[str, Any]:
        return {
            "cylinder": {"radius_m": radius, "length_m": length},
            "pose": {"xyz_m": [0, 0, z]},
        }

    return {
        "gripper": {
            "shapes": [
                box([0.07, 0.09, 0.09], [0, 0, 0.045]),
                box([0.016, 0.01, 0.06], [0, 0.025, 0.12]),
                box([0.016, 0.01, 0.06], [0, -0.025, 0.12]),
            ],
            "tcp": {"xyz_m": [0, 0, 0.145]},
            "opening_m": 0.04,
        },
        "torch": {
            "shapes": [rod(0.022, 0.1, 0.05), rod(0.007, 0.11, 0.155)],
            "tcp": {"xyz_m": [0, 0, 0.215]},
            "opening_m": 0,
        },
    }
