"""Beam search for the order of tasks of different robots, to shorten the makespan.

Every robot keeps its own order of tasks; only their interleaving is searched. A state is the number of tasks
that each robot has completed (task-completion diagram; O'Donnell and Lozano-Perez, 1989). A search step completes
one further task. It is allowed if the task could be executed alone in this state: its predecessors are complete,
and it is free of collisions with robots and objects at rest. A partial order is rated by the completion times of
all robots when all nodes start as early as its temporal plan graph allows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from planning.tasks.task import TimeWindow
from planning.transforms import Array
from scheduling.ordering.relations import TaskRelations

_WAIT_WEIGHT = 0.1
"""Weight of a second of waiting against a second of makespan when orders are compared."""

_LATE_WEIGHT = 1e4
"""Weight of a second by which a step is later than its time window allows: it outweighs any makespan."""

BLOCK_GAP_S = 1e-6
"""Planned time between blocks [s], so that planned starts have the order of the blocks."""


class _DoneUnit(NamedTuple):
    """A completed unit (task with nodes) of a robot, and the unit before it."""

    unit: int
    ends: Array
    before: _DoneUnit | None


def _end_of(done: Sequence[_DoneUnit | None], unit: int) -> float:
    """Return the end time of a completed unit [s]."""
    for item in done:
        while item is not None:
            if item.unit == unit:
                return float(item.ends[-1])
            item = item.before
    return np.inf


@dataclass(frozen=True)
class TaskOrderPath:
    """A partial path through the task-completion grid.

    Attributes:
        counts: how many units each chain has completed.
        done: the last completed unit of each chain.
        clocks: when that unit ends, for each chain [s].
        waited: total wait time of all robots [s].
        late: total time by which steps are later than their time windows allow [s].
        rating: lower bound of the makespan, plus weighted waits and lateness; lower is better.
        move: block of units that was completed last.
        parent: the path before it.
    """

    counts: tuple[int, ...]
    done: tuple[_DoneUnit | None, ...]
    clocks: tuple[float, ...]
    waited: float
    late: float
    rating: float
    move: int
    parent: TaskOrderPath | None

    def order(self) -> list[int]:
        """Return the blocks in the order of the path."""
        blocks = []
        path: TaskOrderPath | None = self
        while path is not None and path.parent is not None:
            blocks.append(path.move)
            path = path.parent
        return blocks[::-1]


class TaskOrderSearch:
    """Searches for a better order of blocks.

    A unit is a task with nodes, see ``TaskRelations``. A block is a unit, or several units of different robots
    that move simultaneously although they conflict, and therefore keep their planned offsets.

    Args:
        relations: of the units.
        blocks: units of each block, in the planned order of the blocks.
        durations: of the nodes of each chain, by default those of the graph [s].
    """

    def __init__(
        self,
        relations: TaskRelations,
        blocks: Sequence[tuple[int, ...]],
        durations: Sequence[Array] | None = None,
    ) -> None:
        self._relations, self._units = relations, relations.units
        self._chains = range(len(relations.of_chain))
        self._blocks = blocks
        self._block_of = {unit: b for b, block in enumerate(blocks) for unit in block}
        nodes = relations.graph.tpg.chains
        lasts = durations or [chain.duration for chain in nodes]
        self._cum = [
            np.concatenate([[0.0], np.cumsum(lasts[u.chain][u.first : u.stop])])
            for u in self._units
        ]
        planned = [nodes[u.chain].planned_start[u.first : u.stop] for u in self._units]
        self._offset = [
            start - min(float(planned[w][0]) for w in blocks[self._block_of[unit]])
            for unit, start in enumerate(planned)
        ]
        self._planned = self._planned_counts()
        self._tail = self._tails()
        number = {unit.task: k for k, unit in enumerate(self._units)}
        self._windows: dict[int, list[tuple[int | None, float]]] = {}
        for window in relations.graph.tpg.windows:
            if window.most is not None:
                due = self._windows.setdefault(number[window.due], [])
                opens = (
                    None if window.done == TimeWindow.EARLIER else number[window.done]
                )
                due.append((opens, window.most - window.ago))

    def best_path(self, width: int) -> TaskOrderPath:
        """Return the best complete path found through the grid.

        Args:
            width: beam width in paths.
        """
        none, zero = tuple(None for _ in self._chains), tuple(0 for _ in self._chains)
        start = TaskOrderPath(
            zero, none, tuple(map(float, zero)), 0.0, 0.0, 0.0, -1, None
        )
        planned, turn = start, 0
        total = len(self._units)
        found: dict[int, list[TaskOrderPath]] = {0: [start]}
        for number in range(total):
            for state in self._best(found.pop(number, []), width):
                for block in self._moves(state):
                    if self._safe(state, block):
                        after = self._extend(state, block)
                        found.setdefault(sum(after.counts), []).append(after)
            if sum(planned.counts) == number:
                # The planned order is safe as it is, and always followed.
                planned = self._extend(planned, turn)
                turn += 1
                found.setdefault(sum(planned.counts), []).append(planned)
        return min(
            found[total], key=lambda path: (path.late, max(path.clocks), path.waited)
        )

    def _best(self, states: list[TaskOrderPath], width: int) -> list[TaskOrderPath]:
        """Return the best partial paths, a bounded number per set of completed units."""
        states.sort(key=lambda state: (state.rating, state.waited))
        kept: list[TaskOrderPath] = []
        seen: dict[tuple[int, ...], list[TaskOrderPath]] = {}
        for state in states:
            same = seen.setdefault(state.counts, [])
            if len(same) >= 4 or any(
                o.late <= state.late
                and all(
                    a <= b + 1e-9 for a, b in zip(o.clocks, state.clocks, strict=True)
                )
                for o in same
            ):
                continue
            same.append(state)
            kept.append(state)
            if len(kept) == width:
                break
        return kept

    def _moves(self, state: TaskOrderPath) -> list[int]:
        """Return the blocks that could come next by the precedence within chains."""
        found = set()
        for own, count in zip(self._relations.of_chain, state.counts, strict=True):
            if count == len(own):
                continue
            block = self._block_of[own[count]]
            firsts: dict[int, int] = {}
            for unit in self._blocks[block]:
                u = self._units[unit]
                firsts[u.chain] = min(firsts.get(u.chain, u.place), u.place)
            if all(state.counts[c] == place for c, place in firsts.items()):
                found.add(block)
        return sorted(found)

    def _extend(self, state: TaskOrderPath, block: int) -> TaskOrderPath:
        counts, done, clocks = list(state.counts), list(state.done), list(state.clocks)
        waited, late = state.waited, state.late
        for unit, ends in self._ends_together(state, self._blocks[block]):
            chain, end = self._units[unit].chain, float(ends[-1])
            counts[chain] += 1
            waited += end - clocks[chain] - float(self._cum[unit][-1])
            done[chain] = _DoneUnit(unit, ends, done[chain])
            clocks[chain] = end
            begin = float(ends[0] - self._cum[unit][1])
            for opens, most in self._windows.get(unit, ()):
                opened = 0.0 if opens is None else _end_of(done, opens)
                late += max(begin - opened - most - BLOCK_GAP_S, 0.0)
        bound = 0.0
        for chain, own in enumerate(self._relations.of_chain):
            rest = self._tail[own[counts[chain]]] if counts[chain] < len(own) else 0.0
            bound = max(bound, clocks[chain] + rest)
        return TaskOrderPath(
            tuple(counts),
            tuple(done),
            tuple(clocks),
            waited,
            late,
            bound + _WAIT_WEIGHT * waited + _LATE_WEIGHT * late,
            block,
            state,
        )

    def _safe(self, state: TaskOrderPath, block: int) -> bool:
        """Tell whether a block can be executed next, one task after another."""
        inside = self._blocks[block]
        busy = {self._units[w].chain for w in inside}
        return all(
            all(
                need in inside or self._is_done(state, need)
                for need in self._relations.before[unit]
            )
            and all(
                self._chain_clear(state, unit, chain)
                for chain in self._chains
                if chain not in busy
            )
            for unit in inside
        )

    def _is_done(self, state: TaskOrderPath, unit: int) -> bool:
        u = self._units[unit]
        return u.place < state.counts[u.chain]

    def _chain_clear(self, state: TaskOrderPath, unit: int, chain: int) -> bool:
        """Tell whether a unit is clear of the reordered units of another robot."""
        relations = self._relations
        count, planned = state.counts[chain], self._planned[unit][chain]
        if count == planned:
            return True
        own = relations.of_chain[chain]
        # Done earlier than planned: objects that they put down may be in the way.
        sooner = [r for w in own[planned:count] for r in relations.left_by[w]]
        later = [r for w in own[count:planned] for r in relations.taken_by[w]]
        return all(
            self._rest_clear(number, state, unit) for number in sooner + later
        ) and relations.stands_clear(chain, count, unit)

    def _rest_clear(self, number: int, state: TaskOrderPath, unit: int) -> bool:
        """Tell whether a unit is clear of a rest of an object, or the object does not rest there in this state."""
        relations = self._relations
        rest = relations.graph.history.rests[number]
        if rest.after is not None:
            left_by = relations.unit_of(rest.after)
            if left_by == unit or not self._is_done(state, left_by):
                return True
        if rest.before is not None:
            taken_by = relations.unit_of(rest.before)
            if taken_by == unit or self._is_done(state, taken_by):
                return True
        return relations.rest_clear(number, unit)

    def _ready(self, state: TaskOrderPath, unit: int) -> list[tuple[int, float]]:
        """Return nodes of a unit, and their earliest start times."""
        chain = self._units[unit].chain
        now = state.clocks[chain]
        found = []
        for other, item in enumerate(state.done):
            while other != chain and item is not None and item.ends[-1] > now:
                if item.unit in self._relations.before[unit]:
                    found.append((0, float(item.ends[-1])))
                stairs = self._relations.stairs(item.unit, unit)
                if stairs is not None:
                    nodes, after = stairs
                    found += zip(nodes.tolist(), item.ends[after].tolist(), strict=True)
                item = item.before
        return found

    def _ends_alone(self, state: TaskOrderPath, unit: int) -> Array:
        """Return the end times of the nodes of a unit that moves as soon as it may [s]."""
        cum = self._cum[unit]
        now = state.clocks[self._units[unit].chain]
        ready = self._ready(state, unit)
        if not ready:
            return np.asarray(now + cum[1:])
        late = np.full(len(cum) - 1, now)
        for node, when in ready:
            late[node] = max(late[node], when - cum[node])
        return np.asarray(np.maximum.accumulate(late) + cum[1:])

    def _ends_together(
        self, state: TaskOrderPath, inside: Sequence[int]
    ) -> list[tuple[int, Array]]:
        """Return the end times of units that move simultaneously, with planned offsets."""
        if len(inside) == 1:
            return [(inside[0], self._ends_alone(state, inside[0]))]
        start = 0.0
        for unit in inside:
            offset = self._offset[unit]
            start = max(start, state.clocks[self._units[unit].chain] - float(offset[0]))
            for node, when in self._ready(state, unit):
                start = max(start, when - float(offset[node]))
        return [
            (unit, start + self._offset[unit] + np.diff(self._cum[unit]))
            for unit in inside
        ]

    def _planned_counts(self) -> dict[int, tuple[int, ...]]:
        """Return how many units of each chain come before each unit in the planned order."""
        counts = [0 for _ in self._chains]
        found: dict[int, tuple[int, ...]] = {}
        for block in self._blocks:
            found |= dict.fromkeys(block, tuple(counts))
            for unit in block:
                counts[self._units[unit].chain] += 1
        return found

    def _tails(self) -> list[float]:
        """Return the longest time from the start of each unit to the end of all, by dependencies [s]."""
        tail = [0.0] * len(self._units)
        after: list[list[int]] = [[] for _ in tail]
        for own in self._relations.of_chain:
            for a, b in pairwise(own):
                after[a].append(b)
        for unit, needs in enumerate(self._relations.before):
            for need in needs:
                after[need].append(unit)
        for block in reversed(self._blocks):
            for unit in reversed(block):
                rest = max((tail[w] for w in after[unit]), default=0.0)
                tail[unit] = rest + float(self._cum[unit][-1])
        return tail
