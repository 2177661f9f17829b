"""Audit rule: each object that no robot holds must rest on a support."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product

import networkx as nx
import numpy as np

from planning.transforms import Transform, translation
from twin.audits.case import AuditCase, Violation
from twin.audits.expectations import TOUCH
from twin.audits.motion.executed import Stay
from twin.audits.part_holding import states_and_holds
from twin.audits.worlds.world import FAR

_SINKS = 0.3
"""Share of an object's sinking by which a support must come nearer."""


def hanging_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield unsupported objects, with the time intervals in which they are unsupported.

    Fixtures stand, and so do tools that are changed, which racks hold, and parts that their robot
    keeps hold of. What rests on something that stands, stands too; see ``Hold`` for what counts as
    resting.
    """
    pile = _Pile(case)
    hanging: dict[str, tuple[float, float, str]] = {}
    for t, there, kept in states_and_holds(case):
        if not pile.update(there, frozenset(case.wanted.doors | kept)):
            continue
        now = pile.floating()
        for name in [name for name in hanging if name not in now]:
            yield _hung(name, hanging.pop(name), t)
        for name in now:
            if name not in hanging:
                hanging[name] = (t, *pile.nearest(name, now))
    for name, since in hanging.items():
        yield _hung(name, since, case.end)


def _hung(name: str, since: tuple[float, float, str], until: float) -> Violation:
    begin, gap, nearest = since
    detail = f"rests on nothing: {gap * 1e3:.2f} mm away from {nearest}, the nearest that stands"
    return Violation(begin, until, name, nearest, gap, detail, "hanging")


class _Pile:
    """Fixtures and objects at rest, with support relations.

    Args:
        case: says what keeps objects at rest, and how near is touching.
    """

    def __init__(self, case: AuditCase) -> None:
        self._case, self._wanted = case, case.wanted
        self._propped = frozenset[str]()
        self._fixtures = frozenset(item.name for item in case.cell.fixtures)
        # The upright box around each thing; nowhere, where it is not at rest.
        self._names = tuple(case.shapes)
        self._number = {name: k for k, name in enumerate(self._names)}
        self._bounds = np.full((len(self._names), 2, 3), np.nan)
        self._poses: dict[str, Transform] = {}
        self._rests: dict[str, Stay] = {}
        self._ground = {*self._fixtures, *(tool.name for tool in case.wanted.tools)}
        self._stands = set(self._ground)
        self._carries: nx.DiGraph[str] = nx.DiGraph()
        self._carries.add_nodes_from(self._names)
        self._goals = {p.object: p.pose for p in case.wanted.places if p.object}
        for item in case.cell.fixtures:
            self._put(item.name, item.pose)

    def update(self, there: Mapping[str, Stay], propped: frozenset[str]) -> bool:
        """Apply changes; return whether there were any.

        Args:
            there: where everything is that is there.
            propped: objects that stand without a support.
        """
        resting = {name: stay for name, stay in there.items() if stay.holder is None}
        gone = [k for k, stay in self._rests.items() if resting.get(k) is not stay]
        come = [k for k, stay in resting.items() if self._rests.get(k) is not stay]
        fallen = changed = propped != self._propped
        self._propped = propped
        for name in gone:
            del self._rests[name], self._poses[name]
            self._bounds[self._number[name]] = np.nan
            carried = list(self._carries.out_edges(name))
            fallen |= bool(carried)
            self._carries.remove_edges_from([*self._carries.in_edges(name), *carried])
            self._stands -= {name} - self._ground
        if fallen:
            self._stands = {*self._ground, *(propped & self._rests.keys())}
            self._stand_on(self._stands)
        for name in come:
            self._rests[name] = resting[name]
            self._put(name, resting[name].pose)
            for other in self._near(name):
                self._join(name, other)
            carriers = self._carries.predecessors(name)
            if name in propped or not self._stands.isdisjoint(carriers):
                self._stands.add(name)
                self._stand_on([name])
        return bool(gone or come or changed)

    def floating(self) -> list[str]:
        """Return the unsupported objects."""
        return [name for name in self._rests if name not in self._stands]

    def nearest(self, name: str, hanging: Sequence[str]) -> tuple[float, str]:
        """Return the nearest supported object and its distance [m]."""
        gaps = {o: self._gap(name, o) for o in self._poses if o not in hanging}
        nearest = min(gaps, key=gaps.__getitem__, default="anything")
        return gaps.get(nearest, FAR), nearest

    def _stand_on(self, names: Iterable[str]) -> None:
        """Mark objects on supported ones as supported."""
        front = list(names)
        while front:
            new = set(self._carries.successors(front.pop())) - self._stands
            self._stands |= new
            front += new

    def _put(self, name: str, pose: Transform) -> None:
        """Record a pose, and the corners of the axis-aligned box around the object."""
        self._poses[name] = pose
        places = [(shape.at(pose), shape) for shape in self._case.shapes[name]]
        middle = np.array([at[:3, 3] for at, _ in places])
        reach = np.array([np.abs(at[:3, :3]) @ shape.half for at, shape in places])
        low, high = (middle - reach).min(axis=0), (middle + reach).max(axis=0)
        self._bounds[self._number[name]] = low, high

    def _near(self, name: str) -> list[str]:
        low, high = self._bounds[self._number[name]]
        touch = self._wanted.touch_m
        near = np.all(
            (self._bounds[:, 0] <= high + touch) & (low <= self._bounds[:, 1] + touch),
            axis=1,
        )
        found = {self._names[k] for k in np.flatnonzero(near).tolist()}
        found |= {k for pair in self._wanted.joined if name in pair for k in pair}
        return sorted((found & self._poses.keys()) - {name})

    def _join(self, first: str, second: str) -> None:
        """Record the support relation of two touching objects.

        Joints may have room where the scenario puts them.
        """
        gap, touch, room = self._gap(first, second), TOUCH, None
        if self._in_place(first) and self._in_place(second):
            touch = max(TOUCH, self._wanted.touch_m)
            room = self._wanted.joined.get(frozenset({first, second}))
        joined = room is not None and gap <= touch + room
        if gap > touch and not joined:
            return
        hold = "joints" if joined else self._wanted.hold
        pairs = (first, second), (second, first)
        # What comes nearer if it sinks is carried.
        carried = [
            hold == "joints" or gap - self._gap(*pair, sunk=touch) >= _SINKS * touch
            for pair in pairs
        ]
        if hold == "studs":
            carried = [any(carried)] * 2
        for (upper, lower), does in zip(pairs, carried, strict=True):
            if does and upper not in self._fixtures:
                self._carries.add_edge(lower, upper)

    def _in_place(self, name: str) -> bool:
        """Return whether an object is a fixture, or at its goal."""
        if name in self._fixtures:
            return True
        goal = self._goals.get(name)
        return goal is not None and np.abs(goal - self._poses[name]).max() <= 1e-3

    def _gap(self, first: str, second: str, *, sunk: float = 0.0) -> float:
        down = translation(0.0, 0.0, -sunk)
        one = self._case.put(first, down @ self._poses[first])
        other = self._case.put(second, self._poses[second])
        return min(self._case.world.distance(a, b, FAR) for a, b in product(one, other))
