"""Order of what was executed: nobody moves before what the plan's type-2 edges ask for is over."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from planning.errors import OutputError
from planning.transforms import Array
from scheduling.graph.task_edges import machine_chains
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.motion.executed import RobotRows
from twin.audit.violation import Violation

_TICK = 1e-9
"""Times are whole nanoseconds [s]."""


@dataclass(frozen=True)
class NodeSpans:
    """Executed begin and end of each node of a robot.

    Attributes:
        begin, end: infinite where that never happened, shape (nodes,) [s].
    """

    begin: Array
    end: Array


def edge_violations(
    tpg: TemporalPlanGraph, spans: Mapping[str, NodeSpans], seen_in: str
) -> Iterator[Violation]:
    """Yield the type-2 edges whose later node began before the earlier one was over.

    Args:
        tpg: what was to be executed.
        spans: of the nodes of each robot of the plan; of others nothing is known.
        seen_in: which record says so, for people.
    """
    for a, u, b, v in tpg.edges.tolist():
        first, second = tpg.chains[a].robot, tpg.chains[b].robot
        if first not in spans or second not in spans:
            continue
        over, begins = float(spans[first].end[u]), float(spans[second].begin[v])
        if np.isfinite(begins) and begins < over - _TICK:
            late = "never was" if np.isinf(over) else f"was {over - begins:.6g} s later"
            detail = f"node {v} began before node {u} of {first} was over, which {late}"
            end = begins if np.isinf(over) else over
            yield Violation(
                begins, end, first, second, 0.0, f"{detail} ({seen_in})", "edge-order"
            )


def tasks_at(
    tpg: TemporalPlanGraph, robots: Mapping[str, RobotRows], robot: str, t: float
) -> frozenset[int]:
    """Return the tasks a robot is at at a time [s]: two when one ends, and while it stands."""
    index = tpg.chain_index.get(robot)
    if index is None:
        return frozenset()
    tasks = tpg.chains[index].task
    nodes = np.clip(robots[robot].nodes_at(t), 0, len(tasks) - 1)
    return frozenset(tasks[nodes].tolist())


def moved_spans(
    tpg: TemporalPlanGraph, robots: Mapping[str, RobotRows]
) -> dict[str, NodeSpans]:
    """Return from when to when robots moved in their nodes, from their trajectories.

    A node in which its robot only stands is over when the next one moves; it begins never.
    Machines do not move.
    """
    out = {}
    machines = machine_chains(tpg)
    for k, chain in enumerate(tpg.chains):
        if k in machines:
            continue
        rows = robots[chain.robot]
        begin = np.full(len(chain), np.inf)
        end = np.full(len(chain), np.inf)
        end[: min(int(rows.node.max(initial=-1)) + 1, len(chain))] = 0.0
        way = np.abs(np.diff(rows.q, axis=0)).max(axis=1, initial=0.0)
        steps = np.flatnonzero((way > 0.0) & ~_standing(rows, way))
        nodes = rows.node[steps + 1]
        inside = (nodes >= 0) & (nodes < len(chain))
        steps, nodes = steps[inside], nodes[inside]
        end[nodes] = 0.0
        np.minimum.at(begin, nodes, rows.t[steps])
        np.maximum.at(end, nodes, rows.t[steps + 1])
        out[chain.robot] = NodeSpans(begin, end)
    return out


def _standing(rows: RobotRows, way: Array) -> npt.NDArray[np.bool_]:
    """Tell which steps from row to row are those of a robot that stands and is pushed, shape (k - 1,).

    Such a step leads to a row that comes again at once, as that of the node that then begins.

    Args:
        rows: of the robot.
        way: greatest way of a joint in each step, shape (k - 1,).
    """
    again = (np.diff(rows.t) == 0.0) & (np.diff(rows.node) != 0)
    found = np.append(again[1:], False)[: len(way)]
    return np.asarray(found & (way <= rows.still))


_TOLD = ("started", "completed", "recovered")
"""Kinds of events with which nodes begin or are over."""


def logged_spans(tpg: TemporalPlanGraph, path: Path) -> dict[str, NodeSpans]:
    """Return when nodes were started and completed, from the event log; what has failed is over once it is recovered from.

    Raises:
        OutputError: a line is no event of this plan.
    """
    out = {
        chain.robot: NodeSpans(np.full(len(chain), np.inf), np.full(len(chain), np.inf))
        for chain in tpg.chains
    }
    with path.open(encoding="utf-8") as lines:
        for number, line in enumerate(lines, 1):
            if not any(f'"{kind}"' in line for kind in _TOLD):
                continue
            try:
                event = json.loads(line)
                if event["kind"] in _TOLD and event["robot"]:
                    own = out[event["robot"]]
                    times = own.begin if event["kind"] == "started" else own.end
                    times[int(event["node"])] = float(event["t_s"])
            except (ValueError, KeyError, IndexError, TypeError) as error:
                raise OutputError(
                    f"{path}:{number}: is no event of this plan: {error}"
                ) from error
    return out
