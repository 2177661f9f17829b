"""Parts that are kept hold of until they are joined: who placed them stands still until then.

Order of what was executed: nobody moves before what the plan's type-2 edges ask for is over.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

import numpy as np

from planning.errors import OutputError
from planning.tasks.task import Task
from planning.transforms import Array
from scheduling.graph.task_edges import machine_chains
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.motion.executed import RobotRows
from twin.audit.motion.replay import Replay, Stay
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
    replay: Replay,
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
        replay: what was executed, to its end.
        wanted: until when the scenario wants parts to be kept hold of.
        ends: when steps that have names were complete [s].
        spans: when nodes were started and completed, by robot or machine; without those of a
            machine it is not known how long its work had to be waited for.
    """
    asked: dict[str, tuple[float, str]] = {
        part: (ends[step], step) for part, step in wanted.keeps.items() if step in ends
    }
    for part, task, end in _kept_until(tpg, replay, spans):
        asked[part] = max(asked.get(part, (end, task)), (end, task), key=itemgetter(0))
    for part, (end, until) in asked.items():
        for stay in _put_down(replay, part):
            leaves = replay.robots[str(stay.giver)].leaves(stay.t)
            if leaves < end - 1e-6:
                detail = f"is let go of {end - leaves:.3f} s before {until} is complete"
                who = str(stay.giver)
                yield Violation(leaves, end, part, who, 0.0, detail, "support")


def held_in_place(
    tpg: TemporalPlanGraph, replay: Replay, wanted: Wanted
) -> dict[str, tuple[float, float]]:
    """Return from when to when parts that are kept hold of are held where they were put down [s].

    That is as long as who placed them stands still, whatever they are kept hold of for.
    """
    return {
        part: (stay.t, replay.robots[str(stay.giver)].leaves(stay.t))
        for part in {*wanted.keeps, *(part for part, _ in _kept_in_plan(tpg))}
        for stay in _put_down(replay, part)
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
        if any((h.object, h.holder) == (back.object, None) for h in place.handlings):
            yield back.object, first


def _kept_until(
    tpg: TemporalPlanGraph, replay: Replay, spans: Mapping[str, NodeSpans]
) -> Iterator[tuple[str, str, float]]:
    """Yield parts that the plan keeps hold of, the words of the task until which, and its end."""
    for part, first in _kept_in_plan(tpg):
        chain = tpg.chains[tpg.chain_index[tpg.tasks[first].robot]]
        nodes = np.flatnonzero(chain.task == first)
        if chain.robot in replay.robots:
            rows = replay.robots[chain.robot]
            end = float(rows.t[np.isin(rows.node, nodes)].max(initial=-np.inf))
        elif chain.robot in spans:
            end = float(spans[chain.robot].end[nodes].max())
        else:
            continue
        if np.isfinite(end):
            yield part, tpg.tasks[first].label, end


def _put_down(replay: Replay, part: str) -> tuple[Stay, ...]:
    """Return where a part lies since a robot put it down last; nothing if none did."""
    stays = replay.stays.get(part, ())
    return tuple(
        stay for stay in stays if stay.holder is None and stay.giver in replay.robots
    )[-1:]
