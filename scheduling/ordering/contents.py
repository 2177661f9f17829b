"""What tasks, stands and objects at rest consist of, and what is known of how they get on.

Whether two of them conflict depends on what they sweep and who may touch whom in both, not on the
graph that they are part of. So what was found for one graph holds in another one of the same cell.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.task_edges import TaskNodes

Stair = tuple[Indices, Indices]
"""Nodes of the later task, counted from its first one, and for each the node of the earlier
task that must be complete before it."""

Pair = tuple[bytes, bytes, frozenset[tuple[str, str]]]
"""What two things consist of, and who may touch whom in both."""

_MOST = 200_000
"""Pairs that are kept."""


@dataclass
class KnownConflicts:
    """Conflicts found for pairs of things, whichever graph they were in.

    Attributes:
        stairs: see ``TaskRelations.stairs``.
        clear: whether the two keep clear of each other.
    """

    stairs: dict[Pair, Stair | None] = field(default_factory=dict)
    clear: dict[Pair, bool] = field(default_factory=dict)

    def make_room(self) -> None:
        """Forget all where it is too much to keep; not while a graph is looked at."""
        if len(self.stairs) + len(self.clear) > _MOST:
            self.stairs.clear()
            self.clear.clear()


class Contents:
    """Digests of the things of a graph, each made when it is first asked for.

    A thing is ("unit", number), ("hold", chain, node behind it), ("idle", robot) or ("rest", number).

    Args:
        graph: the graph.
        units: its tasks with nodes.
    """

    def __init__(self, graph: DerivedTpg, units: Sequence[TaskNodes]) -> None:
        self._graph, self._units = graph, units
        self._digests: dict[tuple[object, ...], bytes] = {}
        self._listed: dict[int, set[int]] | None = None

    def pair(self, thing: tuple[object, ...], unit: int) -> Pair:
        """Return what decides how a thing and a unit get on."""
        both = self._contacts(thing)
        own = self._contacts(("unit", unit)) or set()
        allowed = self._graph.tpg.allowed
        entries = own if both is None else both & own
        names = frozenset((allowed[k].first, allowed[k].second) for k in entries)
        return self._digest(thing), self._digest(("unit", unit)), names

    def _contacts(self, thing: tuple[object, ...]) -> set[int] | None:
        """Return the allowed contacts of the tasks of a thing, None for all of them."""
        if thing[0] in ("idle", "rest"):
            return None
        if self._listed is None:
            self._listed = defaultdict(set)
            for k, contact in enumerate(self._graph.tpg.allowed):
                for task in contact.tasks:
                    self._listed[task].add(k)
        if thing[0] == "unit":
            return self._listed[self._units[_number(thing[1])].task]
        chain, hold = _number(thing[1]), _number(thing[2])
        tasks = self._graph.tpg.chains[chain].task
        last = len(tasks) - 1
        before, after = tasks[max(hold - 1, 0)], tasks[min(hold, last)]
        return self._listed[int(before)] | self._listed[int(after)]

    def _digest(self, thing: tuple[object, ...]) -> bytes:
        if thing not in self._digests:
            digest = hashlib.blake2b(repr(thing[0]).encode(), digest_size=16)
            for part in self._parts(thing):
                digest.update(part)
            self._digests[thing] = digest.digest()
        return self._digests[thing]

    def _parts(self, thing: tuple[object, ...]) -> list[bytes]:
        graph = self._graph
        if thing[0] == "idle":
            return [str(thing[1]).encode()]
        if thing[0] == "rest":
            rest = graph.history.rests[_number(thing[1])]
            return [rest.object.encode(), rest.pose.tobytes()]
        if thing[0] == "hold":
            index, hold = _number(thing[1]), _number(thing[2])
            chain = graph.tpg.chains[index]
            at = int(chain.first[hold]) - 1
            q = chain.start if at < 0 else chain.waypoints[at]
            held = [
                part
                for span in graph.spans[index]
                if span.carried and span.start[0] < hold <= span.end[0]
                for part in (span.object.encode(), span.pose.tobytes())
            ]
            return [chain.robot.encode(), q.tobytes(), *held]
        unit = self._units[_number(thing[1])]
        nodes = graph.tpg.chains[unit.chain].cut(unit.first, unit.stop)
        parts = [
            nodes.robot.encode(),
            nodes.start.tobytes(),
            nodes.waypoints.tobytes(),
            nodes.first.tobytes(),
        ]
        for span in graph.spans[unit.chain]:
            if span.start[0] < unit.stop and span.end >= (unit.first, 0):
                first = max(span.start, (unit.first, 0))
                last = min(span.end, (unit.stop, 0))
                when = (first[0] - unit.first, first[1], last[0] - unit.first, last[1])
                parts += [repr((span.object, when, span.carried)).encode()]
                parts += [span.pose.tobytes()]
        return parts


def _number(value: object) -> int:
    assert isinstance(value, int)
    return value
