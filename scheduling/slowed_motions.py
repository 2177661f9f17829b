"""Statistics of slowed motions: how many motions of each robot are slowed down, and by which limits.

The limits are those of tool speed and joint effort.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import (
    BY_EFFORT,
    BY_JOINTS,
    BY_TOOL_SPEED,
    Drive,
    NodeChain,
    TemporalPlanGraph,
)


def slowed_motions(tpg: TemporalPlanGraph) -> dict[str, dict[str, Any]]:
    """Return by robot the number of its slowed stretches and skills, with the causes.

    Robots of which nothing is slowed are left out.
    """
    found = {}
    for chain in tpg.chains:
        if chain.drive is None or not np.any(chain.drive.slowed_by > BY_JOINTS):
            continue
        moves = _first_nodes_of_motions(chain)
        names = tpg.cell.robot(chain.robot).model.joint_names
        causes = {"tool speed": BY_TOOL_SPEED}
        causes |= {f"effort of {name}": BY_EFFORT + j for j, name in enumerate(names)}
        found[chain.robot] = _counts(chain, moves) | {
            "by": {
                cause: _slowed_by(tpg, chain, chain.drive, moves, number)
                for cause, number in causes.items()
                if np.any(chain.drive.slowed_by == number)
            }
        }
    return found


def _first_nodes_of_motions(chain: NodeChain) -> Indices:
    """Return the first node of each stretch and of each moving skill; none without limits."""
    drive = chain.drive
    if drive is None:
        return np.empty(0, dtype=np.int64)
    first = np.append(True, drive.rests[:-1])[: len(chain)]
    return np.flatnonzero(first & (drive.cruise > 0.0))


def _counts(chain: NodeChain, nodes: Indices) -> dict[str, int]:
    skills = int(np.count_nonzero(chain.skill[nodes]))
    return {"stretches": len(nodes) - skills, "skills": skills}


def _slowed_by(
    tpg: TemporalPlanGraph, chain: NodeChain, drive: Drive, moves: Indices, cause: int
) -> dict[str, Any]:
    own = moves[drive.slowed_by[moves] == cause]
    worst = own[int(np.argmax(drive.slowed[own]))]
    task = tpg.tasks[int(chain.task[worst])]
    return _counts(chain, own) | {
        "longest": float(drive.slowed[worst]),
        "task": task.index,
        "label": task.label,
    }


def describe_overloaded_joints(tpg: TemporalPlanGraph) -> tuple[str, ...]:
    """Return in words the joints that cannot hold their load at any speed."""
    found = []
    for chain in tpg.chains:
        drive, drives = chain.drive, tpg.cell.robot(chain.robot).model.drives
        if drive is None or drives is None:
            continue
        names = tpg.cell.robot(chain.robot).model.joint_names
        for cause in np.unique(drive.slowed_by[drive.slowed_by < BY_JOINTS]).tolist():
            node, joint = int(np.argmax(drive.slowed_by == cause)), -1 - cause
            task = tpg.tasks[int(chain.task[node])]
            found.append(
                f"{chain.robot}: gravity alone takes the effort of {names[joint]}"
                f" ({drives.effort[joint]:g} N m or N), first in task {task.index} ({task.label}):"
                " no motion is slow enough for that; give a lighter part, another robot, or limits.effort"
            )
    return tuple(found)
