"""Parts that are kept hold of until they are joined: who placed them stands still until then.

Order of what was executed: nobody moves before what the plan's type-2 edges ask for is over.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter
from pathlib import Path

import numpy as np

from planning.errors import OutputError
from planning.tasks.task import Task
from planning.transforms import Array
from scheduling.graph.task_edges import machine_chains
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.motion.executed import Recording, RobotRows
from twin.audit.supports import STANDING
from twin.audit.violation import Violation
from twin.audit.wanted import Wanted

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
        steps = np.flatnonzero(np.any(np.diff(rows.q, axis=0) != 0.0, axis=1))
        nodes = rows.node[steps + 1]
        inside = (nodes >= 0) & (nodes < len(chain))
        steps, nodes = steps[inside], nodes[inside]
        end[nodes] = 0.0
        np.minimum.at(begin, nodes, rows.t[steps])
        np.maximum.at(end, nodes, rows.t[steps + 1])
        out[chain.robot] = NodeSpans(begin, end)
    return out


def logged_spans(tpg: TemporalPlanGraph, path: Path) -> dict[str, NodeSpans]:
    """Return when nodes were started and completed, from the event log.

    Raises:
        OutputError: a line is no event of this plan.
    """
    out = {
        chain.robot: NodeSpans(np.full(len(chain), np.inf), np.full(len(chain), np.inf))
        for chain in tpg.chains
    }
    with path.open(encoding="utf-8") as lines:
        for number, line in enumerate(lines, 1):
            if '"started"' not in line and '"completed"' not in line:
                continue
            try:
                event = json.loads(line)
                if event["kind"] in ("started", "completed") and event["robot"]:
                    own = out[event["robot"]]
                    times = own.begin if event["kind"] == "started" else own.end
                    times[int(event["node"])] = float(event["t_s"])
            except (ValueError, KeyError, IndexError, TypeError) as error:
                raise OutputError(
                    f"{path}:{number}: is no event of this plan: {error}"
                ) from error
    return out


def keeping_violations(
    tpg: TemporalPlanGraph,
    recording: Recording,
    wanted: Wanted,
    ends: Mapping[str, float],
    spans: Mapping[str, NodeSpans],
) -> Iterator[Violation]:
    """Yield parts that were let go of before what they are to be held for was complete.

    A part is to be kept hold of where the scenario says until when, or where the plan has its
    robot let go of it after another task. While it was carried its robot's tool was at it, which
    the grips say, and it does not move any more: so the tool stays at it as long as that robot
    stands.

    Args:
        tpg: says what else is kept hold of, and until when.
        recording: what was executed, to its end.
        wanted: until when the scenario wants parts to be kept hold of.
        ends: when steps that have names were complete [s].
        spans: when nodes were started and completed, by robot or machine; without those of a
            machine it is not known how long its work had to be waited for.
    """
    asked: dict[str, tuple[float, str]] = {
        part: (ends[step], step) for part, step in wanted.keeps.items() if step in ends
    }
    for part, task, end in _kept_until(tpg, recording, spans):
        asked[part] = max(asked.get(part, (end, task)), (end, task), key=itemgetter(0))
    for part, (end, until) in asked.items():
        placed = _placed(recording, part)
        if placed is None:
            continue
        robot, begin = placed
        leaves = _leaves(recording.robots[robot], begin)
        if leaves < end - 1e-6:
            detail = f"is let go of {end - leaves:.3f} s before {until} is complete"
            yield Violation(leaves, end, part, robot, 0.0, detail, "support")


def held_in_place(
    tpg: TemporalPlanGraph, recording: Recording, wanted: Wanted
) -> dict[str, tuple[float, float]]:
    """Return from when to when parts that are kept hold of are held where they were put down [s].

    That is as long as who placed them stands still, whatever they are kept hold of for.
    """
    parts = {*wanted.keeps, *(part for part, _ in _kept_in_plan(tpg))}
    placed = {part: _placed(recording, part) for part in parts}
    return {
        part: (at[1], _leaves(recording.robots[at[0]], at[1]))
        for part, at in placed.items()
        if at is not None
    }


def _kept_in_plan(tpg: TemporalPlanGraph) -> Iterator[tuple[str, int]]:
    """Yield parts that the plan has let go of after a task of another robot, and that task.

    The way back of who keeps hold is a task of its own, about the part, in which nothing changes
    hands; of all others it belongs to the skill that places.
    """
    before: dict[int, Task] = {}
    latest: dict[str, Task] = {}
    for task in tpg.tasks:
        if task.robot in latest:
            before[task.index] = latest[task.robot]
        latest[task.robot] = task
    for first, second in tpg.dependencies.tolist():
        back, place = tpg.tasks[second], before.get(second)
        if place is None or back.handlings or back.object is None:
            continue
        if not any(
            (h.object, h.holder) == (back.object, None) for h in place.handlings
        ):
            continue
        yield back.object, first


def _kept_until(
    tpg: TemporalPlanGraph, recording: Recording, spans: Mapping[str, NodeSpans]
) -> Iterator[tuple[str, str, float]]:
    """Yield parts that the plan keeps hold of, the words of the task until which, and its end."""
    for part, first in _kept_in_plan(tpg):
        chain = tpg.chains[tpg.chain_index[tpg.tasks[first].robot]]
        nodes = np.flatnonzero(chain.task == first)
        if chain.robot in recording.robots:
            rows = recording.robots[chain.robot]
            end = float(rows.t[np.isin(rows.node, nodes)].max(initial=-np.inf))
        elif chain.robot in spans:
            end = float(spans[chain.robot].end[nodes].max())
        else:
            continue
        if np.isfinite(end):
            yield part, tpg.tasks[first].label, end


def _placed(recording: Recording, part: str) -> tuple[str, float] | None:
    """Return who put a part down last, and when [s]; None if nobody did."""
    rows = [row for row in recording.objects if row.object == part]
    for before, row in reversed(list(pairwise(rows))):
        if row.holder is None and before.holder in recording.robots:
            assert before.holder is not None
            return before.holder, row.t
    return None


def _leaves(rows: RobotRows, begin: float) -> float:
    """Return when a robot that stands at a time begins to move [s]; never is infinity."""
    here = rows.at(np.array([begin]))[0]
    after = np.flatnonzero(rows.t > begin)
    moved = np.any(np.abs(rows.q[after] - here) > STANDING, axis=1)
    if not moved.any():
        return float("inf")
    first = int(after[int(np.argmax(moved))])
    return float(max(rows.t[first - 1], begin))
