"""A cell that puts up a structure of round bars: arms, posts, stock and the steps, as a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.trusses.bars import POST, between, deepest, parts
from benchmarks.trusses.sites import SITES, Base
from benchmarks.trusses.structures import STRUCTURES, Structure
from benchmarks.trusses.welds import truss_steps
from planning.transforms import Array

_SHOULDER = 0.163
"""Of an arm above its base [m]."""


def truss_scenario(name: str, *, find: bool = False) -> dict[str, Any]:
    """Return a scenario in which arms put up a structure.

    Every bar is welded where it meets others, at each of its ends; on posts clips hold it.

    Args:
        name: of the structure.
        find: whether the order of the steps is to be found.
    """
    structure, bases = STRUCTURES[name](), SITES[name]
    nodes = structure.nodes + np.array([0.0, 0.0, POST])
    names = [f"bar{k + 1}" for k in range(len(structure.bars))]
    bars = [between(nodes[a], nodes[b]) for a, b in structure.bars]
    torches = [
        np.array(base.xyz) + np.array([0.0, 0.0, _SHOULDER])
        for base in bases
        if base.tool == "torch"
    ]
    places, welds, joined = truss_steps(structure, nodes, names, torches)
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
            "robots": list(map(_robot, bases)),
            "fixtures": list(_fixtures(structure, nodes, bases)),
        },
        "assembly": {
            "kind": "assembly",
            "approach_m": 0.05,
            "leave_m": 0.05,
            "touch_m": 0.006,
            "grips": {"positions": 5, "steepest_deg": 75},
            "parts": list(parts(structure, nodes, names, bars, bases[0].away)),
            "processes": {
                "weld": {
                    "duration": {"kind": "lognormal", "median_s": 4, "p95_s": 5.5},
                    "tool": "torch",
                }
            },
            "order": "find" if find else "listed",
            "steps": steps,
            "joined": joined,
            "joined_overlap_m": deepest(structure, nodes, bars),
        },
        "planning": {"speed_model": "joint"},
        "execution": {
            "skills": {
                "pick": {"kind": "lognormal", "median_s": 1.2, "p95_s": 1.8},
                "place-down": {"kind": "lognormal", "median_s": 1.5, "p95_s": 2.2},
            }
        },
    }


def _fixtures(
    structure: Structure, nodes: Array, bases: tuple[Base, ...]
) -> Iterator[dict[str, Any]]:
    yield {
        "name": "table",
        "size_m": [2.2, 2.2, 0.04],
        "pose": {"xyz_m": [0, -0.1, -0.02]},
    }
    for number, base in enumerate(bases, start=1):
        x, y, z = base.xyz
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


def _robot(base: Base) -> dict[str, Any]:
    return {
        "name": base.name,
        "model": "ur5e",
        "tool": base.tool,
        **({"home_deg": list(base.home)} if base.home else {}),
        "base": {"xyz_m": list(base.xyz), "rpy_deg": [0, 0, base.yaw]},
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
