"""Which tasks of a sequential plan get into each other's way, by what their nodes occupy."""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict

import numpy as np

from planning.motion.motion_plan import MotionPlan
from scheduling.build_tpg import build_nodes, occupancies_of
from scheduling.conflicts.allowed_contacts import contact_table
from scheduling.conflicts.conflict_search import HullChecker, search_conflicts
from scheduling.conflicts.object_spans import Rest, trace_objects
from scheduling.conflicts.occupancy import (
    Occupancy,
    hold_occupancy,
    rest_occupancy,
    standing_occupancy,
)
from scheduling.graph.total_order import planned_ranks

_Nodes = tuple[int, int, int]
"""A chain and its nodes ``range(first, stop)``."""


class SweptTaskConflicts:
    """Conflicts of tasks, decided as those of nodes are; implements TaskConflicts.

    Args:
        plan: the sequential plan.
    """

    def __init__(self, plan: MotionPlan) -> None:
        self._tpg = build_nodes(plan)
        chains = self._tpg.chains
        ranks = planned_ranks(chains)
        self._entities, self._occupancies = occupancies_of(self._tpg, ranks)
        self._table = contact_table(self._entities, plan.allowed, plan.cell.clearances)
        self._checker = HullChecker(self._table)
        history = trace_objects(self._tpg, ranks)
        self._spans = history.spans
        self._chain = {chain.robot: i for i, chain in enumerate(chains)}
        self._nodes: dict[int, _Nodes] = {}
        for i, chain in enumerate(chains):
            tasks, first = np.unique(chain.task, return_index=True)
            stops = [*first[1:].tolist(), len(chain)]
            for task, a, b in zip(tasks.tolist(), first.tolist(), stops, strict=True):
                self._nodes[task] = (i, a, b)
        self._robot_tasks: dict[str, list[int]] = defaultdict(list)
        for task in plan.tasks:
            self._robot_tasks[task.robot].append(task.index)
        self._after: dict[int, list[Rest]] = defaultdict(list)
        self._before: dict[int, list[Rest]] = defaultdict(list)
        for rest in history.rests:
            if rest.after is not None:
                k, node = rest.after
                self._after[int(chains[k].task[node])].append(rest)
            if rest.before is not None:
                k, node = rest.before
                self._before[int(chains[k].task[node])].append(rest)
        self._holds: dict[str, tuple[Occupancy, dict[int, int]]] = {}
        self._rests: dict[int, Occupancy] = {}
        self._known: dict[tuple[object, ...], bool] = {}

    def sweeps(self, first: int, second: int) -> bool:
        """Tell whether two tasks of different robots conflict if done at any times."""
        a, b = sorted((first, second))
        if a not in self._nodes or b not in self._nodes:
            return False
        key = ("sweeps", a, b)
        if key not in self._known:
            chain, start, stop = self._nodes[a]
            occupancy = self._occupancies[chain]
            self._known[key] = self._meets(occupancy, start, stop, b)
        return self._known[key]

    def hold(self, robot: str, after: int | None, task: int) -> bool:
        """Tell whether a task runs into a robot that stands where one of its tasks ended."""
        if task not in self._nodes or after == self._last_before(robot, task):
            # The sequential plan has it stand there during the task.
            return False
        occupancy, row = self._standing(robot)
        at = row[-1 if after is None else after]
        key = ("hold", robot, at, task)
        if key not in self._known:
            self._known[key] = self._meets(occupancy, at, at + 1, task)
        return self._known[key]

    def left_behind(self, first: int, task: int) -> bool:
        """Tell whether a task runs into an object where the task ``first`` leaves it."""
        return any(self._rest(rest, task) for rest in self._after[first])

    def not_yet_taken(self, task: int, later: int) -> bool:
        """Tell whether a task runs into an object that the task ``later`` picks up."""
        return any(self._rest(rest, task) for rest in self._before[later])

    def _last_before(self, robot: str, task: int) -> int | None:
        own = self._robot_tasks[robot]
        count = bisect_left(own, task)
        return own[count - 1] if count else None

    def _rest(self, rest: Rest, task: int) -> bool:
        if task not in self._nodes:
            return False
        key = ("rest", id(rest), task)
        if key not in self._known:
            if id(rest) not in self._rests:
                self._rests[id(rest)] = rest_occupancy(self._tpg, rest, self._entities)
            self._known[key] = self._meets(self._rests[id(rest)], 0, 1, task)
        return self._known[key]

    def _standing(self, robot: str) -> tuple[Occupancy, dict[int, int]]:
        """Return a robot's holds at the ends of its tasks, and their rows; -1 is the start."""
        if robot not in self._holds:
            if robot not in self._chain:
                alone = self._tpg.cell.robot(robot)
                still = standing_occupancy(self._tpg, alone, self._entities)
                rows = dict.fromkeys([-1, *self._robot_tasks[robot]], 0)
                self._holds[robot] = (still, rows)
                return self._holds[robot]
            chain = self._chain[robot]
            hold, at = 0, {-1: 0}
            for task in self._robot_tasks[robot]:
                if task in self._nodes:
                    hold = self._nodes[task][2]
                at[task] = hold
            holds = np.unique(np.array(list(at.values()), dtype=np.int64))
            occupancy = hold_occupancy(
                self._tpg, chain, holds, self._spans, self._entities
            )
            rows = {
                task: int(np.searchsorted(holds, where)) for task, where in at.items()
            }
            self._holds[robot] = (occupancy, rows)
        return self._holds[robot]

    def _meets(self, occupancy: Occupancy, first: int, stop: int, task: int) -> bool:
        """Tell whether nodes ``range(first, stop)`` of an occupancy conflict with a task."""
        chain, start, end = self._nodes[task]
        count = int(occupancy.sequence.node[-1]) + 1
        floor = np.full(count, start - 1, dtype=np.int64)
        floor[stop:] = end
        limit = np.full(count, end, dtype=np.int64)
        limit[:first] = 0
        found = search_conflicts(
            occupancy,
            self._occupancies[chain],
            floor,
            limit,
            self._table,
            self._checker,
        )
        return next(found, None) is not None
