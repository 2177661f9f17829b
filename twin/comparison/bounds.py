"""Lower bounds on the makespan: transits as straight joint lines, nobody ever in the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from planning.motion.speed import SpeedModel
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.durations import NANOSECONDS
from twin.run.run_record import ExecutionRecord


def straight_line_s(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    speeds: Mapping[str, SpeedModel],
    *,
    past_home: bool = False,
) -> float:
    """Return the time that the busiest robot needs with straight transits and no waits [s].

    Its skills take as long as they did in the run, its transits are straight joint lines, the
    shortest there are, whatever is in the way.

    Args:
        tpg: what was executed.
        run: how.
        speeds: speed model of each robot.
        past_home: go straight from skill to skill or goal, past the ends of other transits
            such as HOME. Only this bounds a plan with shortcuts.
    """
    goals = [task.index for task in tpg.tasks if task.goal] if past_home else None
    totals = [
        float(_straight(chain, own, speeds[chain.robot], goals)[1].sum())
        for chain, own in zip(tpg.chains, run.duration_ns, strict=True)
    ]
    return max(totals, default=0.0)


def straight_line_ratio(
    tpg: TemporalPlanGraph, run: ExecutionRecord, speeds: Mapping[str, SpeedModel]
) -> float:
    """Return the makespan of a baseline over the one that straight transits would give it.

    Robots wait for each other as before: one task after another in a sequential run, everyone
    for everyone at the end of each slot in a synchronous one. A baseline near 1 is no slow
    one that is easily beaten.

    Args:
        tpg: what was executed; of a synchronous run, with the slots.
        run: how, sequentially or synchronously.
        speeds: speed model of each robot.
    """
    in_slots = run.policy == "synchronous"
    last = max((task.index for task in tpg.tasks), default=0)
    slot_of: Indices = np.arange(last + 1)
    if in_slots:
        slot_of[[task.index for task in tpg.tasks]] = tpg.slots
    longest = np.zeros(int(np.max(slot_of, initial=0)) + 1)
    for chain, own in zip(tpg.chains, run.duration_ns, strict=True):
        tasks, seconds = _straight(chain, own, speeds[chain.robot], None)
        spent = np.bincount(slot_of[tasks], seconds, minlength=len(longest))
        longest = np.maximum(longest, spent)
    straight = float(longest.sum())
    return run.makespan_s / straight if straight > 0 else 1.0


def _straight(
    chain: NodeChain,
    duration_ns: Indices,
    speed: SpeedModel,
    goals: Sequence[int] | None,
) -> tuple[Indices, Array]:
    """Return the stretches of a chain, each by the task it begins with, and their seconds.

    A stretch is a skill node, or the transit nodes of a task. With ``goals`` it is all transit
    nodes up to the next skill, or to the end of one of these tasks.
    """
    if len(chain) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0)
    ends = np.vstack([chain.start, chain.waypoints[chain.first[1:] - 1]])
    begins = chain.skill.copy()
    begins[0] = True
    begins[1:] |= chain.skill[:-1]
    changes = np.diff(chain.task) != 0
    if goals is not None:
        changes &= np.isin(chain.task[:-1], goals)
    begins[1:] |= changes
    cuts = np.append(np.flatnonzero(begins), len(chain))
    seconds = [
        float(duration_ns[a]) / NANOSECONDS
        if chain.skill[a]
        else speed.duration(ends[a], ends[b])
        for a, b in pairwise(cuts.tolist())
    ]
    return chain.task[cuts[:-1]], np.array(seconds)
