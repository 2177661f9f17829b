"""Steps of a truss, and where the torch comes to its nodes."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.trusses.bars import CUT, RADIUS, written
from benchmarks.trusses.structures import Structure
from planning.transforms import Array

_STANDOFF = 0.002
"""The tip stays so far away from the seam, along the bar [m]."""

_TORCH = ((0.01, 0.12, 0.007), (0.115, 0.215, 0.022))
"""Rods of the torch: from and to how far behind its tip, and their radius [m]."""

_ROOM = 0.012
"""Away from bars by this, a torch is as good as free [m]."""


def truss_steps(
    structure: Structure, nodes: Array, names: list[str], torches: Sequence[Array]
) -> tuple[list[Any], list[list[Any]], list[Any]]:
    """Return the places, the welds of each bar, and what is joined.

    Args:
        structure: what is built.
        nodes: their places, shape (n, 3) [m].
        names: of the bars.
        torches: where the shoulders of the robots with torches are.
    """
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
                own.append(
                    {
                        "process": "weld",
                        "at": {
                            "pose": _torch_place(structure, nodes, node, k, torches)
                        },
                        "name": step,
                        "after": [names[k], *others],
                    }
                )
            joined += [{"parts": [other, names[k]], **by} for other in others]
            there[node].append(k)
        welds.append(own)
    return list(names), welds, joined


def _torch_place(
    structure: Structure, nodes: Array, node: int, bar: int, torches: Sequence[Array]
) -> dict[str, Any]:
    """Return where the torch comes to the end of a bar at a node.

    From where the bars that are there leave it room, from the side of the nearest robot with a
    torch, from above rather than from below.
    """
    (other,) = set(structure.bars[bar]) - {node}
    new = _unit(nodes[other] - nodes[node])
    bars = np.array([[nodes[a], nodes[b]] for a, b in structure.bars[: bar + 1]])
    nearest = min(torches, key=lambda at: float(np.linalg.norm(at - nodes[node])))
    out = _unit(nearest - nodes[node])
    tried = []
    for lean in np.radians([0, 20, 40, 55, 70, 85]):
        for turn in np.radians(np.arange(0, 360, 20)):
            z = np.array(
                [
                    math.sin(lean) * math.cos(turn),
                    math.sin(lean) * math.sin(turn),
                    math.cos(lean),
                ]
            )
            aside = _unit(z - (z @ new) * new)
            at = nodes[node] + (CUT + _STANDOFF) * new + RADIUS * aside
            room = min(_room(at, z, bars), _ROOM)
            liked = float(z @ out) + 0.5 * float(z[2])
            tried.append((room + 0.004 * liked, tuple(at), tuple(z)))
    _, place, way = max(tried)
    x, y, up = way
    pose = np.eye(4)
    lean, bearing = math.acos(up), math.atan2(y, x)
    pose[:3, :3] = Rotation.from_euler("yz", [lean, bearing]).as_matrix()
    pose[:3, 3] = place
    return written(pose)


def _room(tip: Array, z: Array, bars: Array) -> float:
    """Return how far a torch is away from all bars at least; negative where it is in one [m]."""
    rooms = []
    for begin, end, radius in _TORCH:
        along = tip + np.linspace(begin, end, 12)[:, None] * z
        way = bars[:, 1] - bars[:, 0]
        since = along[:, None] - bars[:, 0]
        share = np.einsum("sbi,bi->sb", since, way) / np.einsum("bi,bi->b", way, way)
        foot = np.clip(share, 0.0, 1.0)[..., None] * way
        gap = np.linalg.norm(since - foot, axis=-1) - radius - RADIUS
        rooms.append(float(gap.min()))
    return min(rooms)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))
