"""Objects that nobody holds must rest on something that does not fall.

Parts lie where the scenario says on their way, and for as long as machines work at them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise, product

import numpy as np

from planning.tasks.task import GONE, Task
from planning.transforms import Array, Transform, translation
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.keeping import NodeSpans
from twin.audit.motion.executed import ObjectRow, Recording
from twin.audit.motion.sampling import RunStretch
from twin.audit.places import PLACED, distance_of
from twin.audit.violation import Violation
from twin.audit.wanted import TOUCH, Wanted, WantedRest
from twin.audit.worlds.world import FAR, AuditWorld, WatchedShape, shapes_by_entity

_SINKS = 0.3
"""What comes nearer by this share of the way that an object sinks carries it."""


class RestWatch:
    """Looks at every state of what is at rest, and notes who hangs in the air.

    Fixtures stand, and so do tools that are changed, which racks hold, and parts that their robot
    keeps hold of. What rests on something that stands, stands too; see ``Hold`` for what counts as
    resting.

    Args:
        world: to measure in.
        wanted: what keeps objects at rest, and how near is touching.
        held: from when to when parts are held where they were put down: they stand meanwhile [s].
    """

    def __init__(
        self,
        world: AuditWorld,
        wanted: Wanted,
        held: Mapping[str, tuple[float, float]],
    ) -> None:
        self._world, self._wanted = world, wanted
        self._held_from_to, self._propped = held, frozenset[str]()
        cell = world.cell
        self._shapes = shapes_by_entity((*world.fixtures, *world.objects))
        self._poses: dict[str, Transform] = {f.name: f.pose for f in cell.fixtures}
        # The upright box around each thing; nowhere, where it is not at rest.
        self._names = tuple(self._shapes)
        self._number = {name: k for k, name in enumerate(self._names)}
        self._bounds = np.full((len(self._names), 2, 3), np.nan)
        for name in self._poses:
            self._bounds[self._number[name]] = self._box_of(name)
        self._fixtures = tuple(self._poses)
        self._rows: dict[str, ObjectRow] = {}
        self._carriers: dict[str, set[str]] = {}
        self._carried: dict[str, set[str]] = {name: set() for name in self._names}
        self._ground = {*self._fixtures, *(tool.name for tool in wanted.tools)}
        self._stands = set(self._ground)
        self._goals = {p.object: p.pose for p in wanted.places if p.object}
        self._hanging: dict[str, tuple[float, float, str]] = {}
        self._found: list[Violation] = []

    def look(self, stretch: RunStretch) -> None:
        """Check the state of a stretch, where it is another than before."""
        self._last = float(stretch.t[-1])
        begin = float(stretch.t[0])
        ends = {end for _, end in self._held_from_to.values()}
        for t in (begin, *sorted(end for end in ends if begin < end <= self._last)):
            self._look_at(stretch.placements, t)

    def _look_at(self, placements: Mapping[str, ObjectRow], t: float) -> None:
        """Check the state at a time [s]."""
        if self._update(placements, t):
            hanging = self._floating()
            for name in [name for name in self._hanging if name not in hanging]:
                self._close(name, t)
            for name in hanging:
                if name not in self._hanging:
                    self._hanging[name] = (t, *self._nearest(name, hanging))

    def violations(self) -> list[Violation]:
        """Return what hung in the air, from when to when."""
        for name in list(self._hanging):
            self._close(name, self._last)
        return self._found

    def _close(self, name: str, until: float) -> None:
        since, gap, nearest = self._hanging.pop(name)
        detail = f"rests on nothing: {gap * 1e3:.2f} mm away from {nearest}, the nearest that stands"
        self._found.append(
            Violation(since, until, name, nearest, gap, detail, "hanging")
        )

    def _update(self, placements: Mapping[str, ObjectRow], t: float) -> bool:
        """Take over what has changed by a time [s]; tell whether anything has."""
        resting = {k: row for k, row in placements.items() if row.holder is None}
        gone = [k for k, row in self._rows.items() if resting.get(k) is not row]
        come = [k for k, row in resting.items() if self._rows.get(k) is not row]
        spans = self._held_from_to.items()
        held = {name for name, (begin, end) in spans if begin <= t < end}
        propped = frozenset(self._wanted.doors | held)
        fallen = changed = propped != self._propped
        self._propped = propped
        for name in gone:
            del self._rows[name], self._poses[name]
            self._bounds[self._number[name]] = np.nan
            for carrier in self._carriers.pop(name):
                self._carried[carrier].discard(name)
            for other in self._carried[name]:
                self._carriers[other].discard(name)
                fallen = True
            self._carried[name].clear()
            self._stands -= {name} - self._ground
        if fallen:
            self._stands = {*self._ground, *(propped & self._rows.keys())}
            self._stand_on(self._stands)
        for name in come:
            self._rows[name] = resting[name]
            self._poses[name] = resting[name].pose
            self._bounds[self._number[name]] = self._box_of(name)
            self._carriers[name] = set()
            for other in self._near(name):
                self._join(name, other)
            if name in propped or not self._carriers[name].isdisjoint(self._stands):
                self._stands.add(name)
                self._stand_on([name])
        return bool(gone or come or changed)

    def _stand_on(self, names: Iterable[str]) -> None:
        """Note that what is carried by things that stand, stands too."""
        front = list(names)
        while front:
            new = self._carried[front.pop()] - self._stands
            self._stands |= new
            front += new

    def _box_of(self, name: str) -> Array:
        """Return the corners of the upright box around an object, shape (2, 3)."""
        places = [(shape.at(self._poses[name]), shape) for shape in self._shapes[name]]
        middle = np.array([pose[:3, 3] for pose, _ in places])
        reach = np.array([np.abs(pose[:3, :3]) @ shape.half for pose, shape in places])
        return np.array([(middle - reach).min(axis=0), (middle + reach).max(axis=0)])

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
        """Note who of two carries whom, if they touch."""
        joined = self._are_joined(first, second)
        if not joined and self._gap(first, second) > self._touch(first, second):
            return
        hold = "joints" if joined else self._wanted.hold
        carries = [
            hold == "joints" or self._sinks_into(a, b)
            for a, b in ((first, second), (second, first))
        ]
        if hold == "studs":
            carries = [any(carries)] * 2
        if carries[0]:
            self._carriers[first].add(second)
            self._carried[second].add(first)
        if carries[1] and second in self._carriers:
            self._carriers[second].add(first)
            self._carried[first].add(second)

    def _touch(self, first: str, second: str) -> float:
        """Return how near is touching: joints may have room where the scenario puts them [m]."""
        if not (self._in_place(first) and self._in_place(second)):
            return TOUCH
        return max(TOUCH, self._wanted.touch_m)

    def _are_joined(self, first: str, second: str) -> bool:
        """Tell whether two things are joined, which they are in their places, as near as they may be."""
        room = self._wanted.joined.get(frozenset({first, second}))
        if room is None or not (self._in_place(first) and self._in_place(second)):
            return False
        return self._gap(first, second) <= self._touch(first, second) + room

    def _in_place(self, name: str) -> bool:
        """Tell whether something is a fixture, or where the scenario puts it."""
        if name in self._fixtures:
            return True
        goal = self._goals.get(name)
        return goal is not None and np.abs(goal - self._poses[name]).max() <= 1e-3

    def _sinks_into(self, upper: str, lower: str) -> bool:
        """Tell whether one object comes nearer to another if it sinks."""
        way = self._touch(upper, lower)
        nearer = self._gap(upper, lower) - self._gap(upper, lower, sunk=way)
        return nearer >= _SINKS * way

    def _gap(self, first: str, second: str, *, sunk: float = 0.0) -> float:
        pairs = product(self._placed(first, sunk), self._placed(second, 0.0))
        return min(self._world.distance(a, b, FAR) for a, b in pairs)

    def _placed(self, name: str, sunk: float) -> list[WatchedShape]:
        pose = translation(0.0, 0.0, -sunk) @ self._poses[name]
        shapes = self._shapes[name]
        for shape in shapes:
            self._world.place(shape, shape.at(pose))
        return shapes

    def _floating(self) -> list[str]:
        return [name for name in self._rows if name not in self._stands]

    def _nearest(self, name: str, hanging: list[str]) -> tuple[float, str]:
        gaps = {o: self._gap(name, o) for o in self._poses if o not in hanging}
        nearest = min(gaps, key=gaps.__getitem__, default="anything")
        return gaps.get(nearest, FAR), nearest


_TICK = 1e-6
"""Times of tables may differ by their rounding [s]."""


def rest_violations(
    tpg: TemporalPlanGraph,
    recording: Recording,
    wanted: Wanted,
    spans: Mapping[str, NodeSpans],
) -> Iterator[Violation]:
    """Yield parts that were not put down on their way, or did not lie there while machines worked.

    Each part comes to rest at its stops in their order. Each process that no robot does is one task
    of its name at its part; from its begin to its end the part lies where the scenario has it by
    then, its door is shut when it ends, and what it comes after is complete.

    Args:
        tpg: says which tasks are processes, and of which machines.
        recording: what was executed, to its end.
        wanted: where the scenario wants what, in which order.
        spans: when nodes were started and completed, by robot or machine.
    """
    rows: dict[str, list[ObjectRow]] = {item.name: [] for item in tpg.cell.objects}
    for row in recording.objects:
        rows[row.object].append(row)
    looked: dict[str, int] = {}
    times: dict[str, tuple[float, float]] = {}
    work = machine_work(tpg, wanted, spans)
    for k, rest in enumerate(wanted.rests):
        own = rows[rest.part]
        # To be put down somewhere it comes to rest anew.
        first = looked.get(rest.part, 0) + (rest.process is None)
        at = next((n for n in range(first, len(own)) if _lies(tpg, own[n], rest)), None)
        if at is None:
            yield _violation(recording.end, rest, "it never lies where it should")
            continue
        looked[rest.part] = at
        if rest.process is None:
            continue
        if k not in work:
            yield _violation(recording.end, rest, "was not done")
            continue
        task, begin, end = work[k]
        since = own[at].t
        until = own[at + 1].t if at + 1 < len(own) else np.inf
        if not since - _TICK <= begin <= end <= until + _TICK:
            words = (
                f"was done from {begin:.3f} s to {end:.3f} s, and {rest.part} lies there from"
                f" {since:.3f} s to {until:.3f} s"
            )
            yield _violation(begin, rest, words)
        door = next((h.object for h in task.handlings), None)
        if door in wanted.doors and not _shut(rows[str(door)], begin, end):
            yield _violation(begin, rest, f"{door} was not shut until its end")
        if rest.name is not None:
            times[rest.name] = begin, end
    for rest in wanted.rests:
        for after in rest.after:
            begin, _ = times.get(rest.name or "", (np.inf, np.inf))
            _, end = times.get(after, (-np.inf, -np.inf))
            if begin < end - _TICK:
                yield _violation(begin, rest, f"begins before {after} is complete")


def machine_work(
    tpg: TemporalPlanGraph, wanted: Wanted, spans: Mapping[str, NodeSpans]
) -> dict[int, tuple[Task, float, float]]:
    """Return who works at parts without a robot, by number of the wanted rest: task, begin, end [s].

    Tasks that are alike are taken in the plan's order. What is not in the plan is left out.
    """
    left = {task.index: task for task in tpg.tasks if tpg.cell.is_machine(task.robot)}
    work = {}
    for k, rest in enumerate(wanted.rests):
        index = next((n for n, task in left.items() if _is(rest, task)), None)
        if rest.process is not None and index is not None:
            task = left.pop(index)
            work[k] = task, *_span(tpg, spans, task.robot, index)
    return work


def _is(rest: WantedRest, task: Task) -> bool:
    """Tell whether a task of a machine is one that is wanted."""
    return (
        task.kind == rest.process
        and task.object == rest.part
        and rest.machine in (None, task.robot)
    )


def _lies(tpg: TemporalPlanGraph, row: ObjectRow, rest: WantedRest) -> bool:
    item = tpg.cell.object(rest.part)
    return row.holder is None and distance_of(item, row.pose, rest.pose) <= PLACED


def _span(
    tpg: TemporalPlanGraph, spans: Mapping[str, NodeSpans], machine: str, index: int
) -> tuple[float, float]:
    """Return from when to when a machine was at a task [s]."""
    nodes = np.flatnonzero(tpg.chains[tpg.chain_index[machine]].task == index)
    own = spans[machine]
    return float(own.begin[nodes].min()), float(own.end[nodes].max())


def _shut(rows: Sequence[ObjectRow], begin: float, end: float) -> bool:
    """Tell whether a door was shut within some time, and until the end of it [s]."""
    return any(
        shut.holder is None
        and opened.holder == GONE
        and begin - _TICK <= shut.t <= end
        and opened.t >= end - _TICK
        for shut, opened in pairwise(rows)
    )


def _violation(t: float, rest: WantedRest, words: str) -> Violation:
    by = rest.machine or "world"
    return Violation(t, t, rest.words, by, 0.0, words, "process")
