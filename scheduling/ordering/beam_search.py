"""In which order tasks of different robots come: a beam search over task completions.

Every robot keeps its own order of tasks. What is left to choose is how the robots' tasks follow
each other: a way through the grid of how many tasks each robot has completed, the task-completion
diagram of O'Donnell and Lozano-Perez (1989). A step of the way is allowed where the plan stays
safe one task after another: what the task depends on is done, and it keeps clear of robots that
stand and objects that lie there now. It is rated by when everyone would be ready if all moved as
early as the temporal plan graph of this order lets them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import NodeChain
from scheduling.ordering.relations import TaskRelations

_WAITING = 0.1
"""Weight of a second of waiting against a second of makespan when orders are compared."""


class _Done(NamedTuple):
    """A completed unit of a robot, and the one before it."""

    unit: int
    ends: Array
    before: _Done | None


@dataclass(frozen=True)
class Way:
    """A way through the grid, as far as it goes.

    Attributes:
        counts: how many units each chain has completed.
        done: the last completed unit of each chain.
        clocks: when that ends [s].
        waited: of all robots together [s].
        rating: what is compared.
        move: block of units that was completed last.
        parent: the way before it.
    """

    counts: tuple[int, ...]
    done: tuple[_Done | None, ...]
    clocks: tuple[float, ...]
    waited: float
    rating: float
    move: int
    parent: Way | None

    def order(self) -> list[int]:
        """Return the blocks, one after another."""
        blocks = []
        way: Way | None = self
        while way is not None and way.parent is not None:
            blocks.append(way.move)
            way = way.parent
        return blocks[::-1]


class TaskOrderSearch:
    """Searches for a better order of blocks.

    A block is a unit, or units of several robots that move in each other's way at once and so
    stay as they are.

    Args:
        chains: the nodes.
        relations: of the units.
        blocks: units of each block, in the planned order of the blocks.
        duration: of every node, one array a chain [s].
    """

    def __init__(
        self,
        chains: Sequence[NodeChain],
        relations: TaskRelations,
        blocks: Sequence[tuple[int, ...]],
        duration: Sequence[Array],
    ) -> None:
        self._relations = relations
        self._blocks = blocks
        units = relations.units
        self._block_of = {unit: b for b, block in enumerate(blocks) for unit in block}
        self._cum = [
            np.concatenate([[0.0], np.cumsum(duration[u.chain][u.first : u.stop])])
            for u in units
        ]
        self._offset = [
            chains[u.chain].planned_start[u.first : u.stop]
            - min(
                float(chains[units[w].chain].planned_start[units[w].first])
                for w in blocks[self._block_of[k]]
            )
            for k, u in enumerate(units)
        ]
        self._planned = self._planned_counts()
        self._tail = self._tails()

    def search(self, width: int) -> list[int]:
        """Return the order of the blocks, see ``best_way``."""
        return self.best_way(width).order()

    def best_way(self, width: int) -> Way:
        """Return the best way to the end that is found.

        Args:
            width: ways that are followed at once.
        """
        chains = range(len(self._relations.of_chain))
        start = Way(
            tuple(0 for _ in chains),
            tuple(None for _ in chains),
            tuple(0.0 for _ in chains),
            0.0,
            0.0,
            -1,
            None,
        )
        planned, turn = start, 0
        total = len(self._relations.units)
        found: dict[int, list[Way]] = {0: [start]}
        for number in range(total):
            for state in self._best(found.pop(number, []), width):
                for block in self._moves(state):
                    after = self._advance(state, block)
                    if after is not None:
                        found.setdefault(sum(after.counts), []).append(after)
            if sum(planned.counts) == number:
                # The planned order is safe as it is, and always followed.
                planned = self._extend(planned, self._blocks[turn], turn)
                turn += 1
                found.setdefault(sum(planned.counts), []).append(planned)
        return min(found[total], key=lambda way: (max(way.clocks), way.waited))

    def _best(self, states: list[Way], width: int) -> list[Way]:
        """Return the best ways, not too many that have done the same."""
        states.sort(key=lambda state: (state.rating, state.waited))
        kept: list[Way] = []
        seen: dict[tuple[int, ...], list[Way]] = {}
        for state in states:
            same = seen.setdefault(state.counts, [])
            if len(same) >= 4 or any(
                all(a <= b + 1e-9 for a, b in zip(o.clocks, state.clocks, strict=True))
                for o in same
            ):
                continue
            same.append(state)
            kept.append(state)
            if len(kept) == width:
                break
        return kept

    def _moves(self, state: Way) -> list[int]:
        """Return the blocks that could come next by their robots' own orders."""
        relations = self._relations
        found = set()
        for chain, count in enumerate(state.counts):
            own = relations.of_chain[chain]
            if count == len(own):
                continue
            block = self._block_of[own[count]]
            firsts: dict[int, int] = {}
            for unit in self._blocks[block]:
                u = relations.units[unit]
                firsts[u.chain] = min(firsts.get(u.chain, u.place), u.place)
            if all(state.counts[c] == place for c, place in firsts.items()):
                found.add(block)
        return sorted(found)

    def _advance(self, state: Way, block: int) -> Way | None:
        """Return the way that goes on with a block, None where that is not safe."""
        inside = self._blocks[block]
        if all(self._allowed(state, unit, inside) for unit in inside):
            return self._extend(state, inside, block)
        return None

    def _extend(self, state: Way, inside: Sequence[int], block: int) -> Way:
        relations = self._relations
        ends = (
            [(inside[0], self._ends_alone(state, inside[0]))]
            if len(inside) == 1
            else self._ends_together(state, inside)
        )
        counts, done, clocks = list(state.counts), list(state.done), list(state.clocks)
        waited = state.waited
        for unit, when in ends:
            chain = relations.units[unit].chain
            counts[chain] += 1
            waited += float(when[-1]) - clocks[chain] - float(self._cum[unit][-1])
            done[chain] = _Done(unit, when, done[chain])
            clocks[chain] = float(when[-1])
        bound = 0.0
        for chain, own in enumerate(relations.of_chain):
            rest = self._tail[own[counts[chain]]] if counts[chain] < len(own) else 0.0
            bound = max(bound, clocks[chain] + rest)
        return Way(
            tuple(counts),
            tuple(done),
            tuple(clocks),
            waited,
            bound + _WAITING * waited,
            block,
            state,
        )

    def _allowed(self, state: Way, unit: int, inside: Sequence[int]) -> bool:
        relations, units = self._relations, self._relations.units
        with_it = {units[w].chain for w in inside}
        for need in relations.before[unit]:
            if (
                need not in inside
                and units[need].place >= state.counts[units[need].chain]
            ):
                return False
        planned = self._planned[unit]
        for chain, count in enumerate(state.counts):
            if chain in with_it or count == planned[chain]:
                continue
            own = relations.of_chain[chain]
            # Done now, but planned for later: what they leave behind may be in the way.
            for w in own[planned[chain] : count]:
                if not all(
                    self._rest_clear(r, state, unit) for r in relations.left_by[w]
                ):
                    return False
            for w in own[count : planned[chain]]:
                if not all(
                    self._rest_clear(r, state, unit) for r in relations.taken_by[w]
                ):
                    return False
            if not relations.stands_clear(chain, count, unit):
                return False
        return True

    def _rest_clear(self, number: int, state: Way, unit: int) -> bool:
        """Tell whether an object is not at rest there now, or not in a unit's way."""
        relations = self._relations
        rest = relations.rest(number)
        if rest.after is not None:
            u = relations.unit_of(rest.after)
            if (
                u == unit
                or relations.units[u].place >= state.counts[relations.units[u].chain]
            ):
                return True
        if rest.before is not None:
            u = relations.unit_of(rest.before)
            if (
                u == unit
                or relations.units[u].place < state.counts[relations.units[u].chain]
            ):
                return True
        return relations.rest_clear(number, unit)

    def _ready(self, state: Way, unit: int) -> list[tuple[int, float]]:
        """Return nodes of a unit, and times before which they cannot start."""
        relations, units = self._relations, self._relations.units
        chain = units[unit].chain
        now = state.clocks[chain]
        found = []
        for other, last in enumerate(state.done):
            if other == chain:
                continue
            item = last
            while item is not None and item.ends[-1] > now:
                if item.unit in relations.before[unit]:
                    found.append((0, float(item.ends[-1])))
                stairs = relations.stairs(item.unit, unit)
                if stairs is not None:
                    found += zip(
                        stairs[0].tolist(), item.ends[stairs[1]].tolist(), strict=True
                    )
                item = item.before
        return found

    def _ends_alone(self, state: Way, unit: int) -> Array:
        """Return when the nodes of a unit end."""
        cum = self._cum[unit]
        now = state.clocks[self._relations.units[unit].chain]
        ready = self._ready(state, unit)
        if not ready:
            return np.asarray(now + cum[1:])
        late = np.full(len(cum) - 1, now)
        for node, when in ready:
            late[node] = max(late[node], when - cum[node])
        return np.asarray(np.maximum.accumulate(late) + cum[1:])

    def _ends_together(
        self, state: Way, inside: Sequence[int]
    ) -> list[tuple[int, Array]]:
        """Return when the nodes of units that move at once end, as far apart as planned."""
        start = 0.0
        for unit in inside:
            chain = self._relations.units[unit].chain
            offset = self._offset[unit]
            start = max(start, state.clocks[chain] - float(offset[0]))
            for node, when in self._ready(state, unit):
                start = max(start, when - float(offset[node]))
        return [
            (unit, start + self._offset[unit] + np.diff(self._cum[unit]))
            for unit in inside
        ]

    def _planned_counts(self) -> list[tuple[int, ...]]:
        """Return how many units of each chain come before each unit in the planned order."""
        counts = [0] * len(self._relations.of_chain)
        found: dict[int, tuple[int, ...]] = {}
        for block in self._blocks:
            before = tuple(counts)
            for unit in block:
                found[unit] = before
                counts[self._relations.units[unit].chain] += 1
        return [found[unit] for unit in range(len(found))]

    def _tails(self) -> list[float]:
        """Return the longest way from the start of each unit to the end, by dependencies."""
        relations = self._relations
        tail = [0.0] * len(relations.units)
        after: list[list[int]] = [[] for _ in tail]
        for own in relations.of_chain:
            for a, b in zip(own, own[1:], strict=False):
                after[a].append(b)
        for unit, needs in enumerate(relations.before):
            for need in needs:
                after[need].append(unit)
        for block in reversed(self._blocks):
            for unit in reversed(block):
                rest = max((tail[w] for w in after[unit]), default=0.0)
                tail[unit] = rest + float(self._cum[unit][-1])
        return tail
