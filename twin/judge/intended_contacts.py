"""Intended contacts of an open plan (the JSON plan format of ``twin judge``).

- A tool touches the object that it holds, from the task of grasping to the task of release.
- A picked or placed object touches its neighbours during that task.
- A tool may touch the objects and fixtures that are listed under the key ``touches`` of a motion.
- A tool may touch bricks at rest slightly during skills.

Limits of the penetration depth are in ``twin.audits.contacts``.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import product

import numpy as np

from planning.tasks.task import AllowedContact, Handling
from planning.transforms import Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audits.expectations import TOUCH, Expectations
from twin.audits.worlds.world import AuditWorld, WatchedShape, shapes_by_entity
from twin.judge.open_plan import OpenMotion, OpenPlan
from twin.judge.open_plan_execution import OpenPlanExecution, Transfer

_TICK = 1e-9
"""Times that differ by less are the same [s]."""


def intended_contacts(
    plan: OpenPlan,
    graph: TemporalPlanGraph,
    world: AuditWorld,
    planned: OpenPlanExecution,
    wanted: Expectations,
) -> tuple[AllowedContact, ...]:
    """Return the allowed contacts, with their tasks.

    Args:
        plan: the plan, whose motions name what tools touch.
        graph: its graph, with its tasks.
        world: measures distances of neighbours.
        planned: execution at the planned times.
        wanted: expectations of the audit: how objects at rest are held.
    """
    times = _TaskTimes(plan, graph)
    tasks: dict[frozenset[str], set[int]] = defaultdict(set)
    hands = {
        robot.name: [f"{robot.name}/tool", *(t.name for t in robot.tools)]
        for robot in graph.cell.robots
    }
    _add_held_contacts(tasks, times, planned.changes, hands)
    _add_neighbour_contacts(tasks, times, planned, world, max(TOUCH, wanted.touch_m))
    busy: dict[str, set[int]] = defaultdict(set)
    for name, some in plan.motions.items():
        for k, motion in enumerate(some):
            if name not in hands:
                continue
            own = {times.task_of(name, k)}
            if motion.touches or motion.events or motion.skill:
                busy[name] |= own
            meanwhile = own | times.of_others(name, motion.t_s[0], motion.t_s[-1])
            for thing, hand in product(motion.touches, hands[name]):
                tasks[frozenset((hand, thing))] |= meanwhile
    found = [
        AllowedContact(min(pair), max(pair), frozenset(some))
        for pair, some in tasks.items()
        if len(pair) == 2
    ]
    if wanted.hold == "studs":
        names = [item.name for item in graph.cell.objects]
        found += [
            AllowedContact(f"{robot}/tool", name, frozenset(some), grazing=True)
            for robot, some in busy.items()
            for name in names
        ]
    return tuple(found)


class _TaskTimes:
    """Tasks in progress at the times of the plan."""

    def __init__(self, plan: OpenPlan, graph: TemporalPlanGraph) -> None:
        self._plan = plan
        self._task = {chain.robot: chain.task for chain in graph.chains}
        self._number = {
            motion.id: (name, k)
            for name, some in plan.motions.items()
            for k, motion in enumerate(some)
        }
        self._begins, self._ends = (
            {
                name: np.array([motion.t_s[side] for motion in some])
                for name, some in plan.motions.items()
            }
            for side in (0, -1)
        )

    def task_of(self, name: str, k: int) -> int:
        """Return the task of a motion."""
        return int(self._task[name][k])

    def around(self, name: str, motion: OpenMotion, t: float) -> set[int]:
        """Return the tasks of a robot at a time; where one ends and the next begins, both."""
        _, k = self._number[motion.id]
        near = {k}
        if t <= motion.t_s[0] + _TICK and k > 0:
            near.add(k - 1)
        if t >= motion.t_s[-1] - _TICK and k + 1 < len(self._plan.motions[name]):
            near.add(k + 1)
        return {self.task_of(name, n) for n in near}

    def during(self, name: str, begin: float, end: float) -> set[int]:
        """Return the tasks of a robot in an interval; while it stands, the ones before and after count."""
        if name not in self._begins:
            return set()
        low = max(int(np.searchsorted(self._ends[name], begin + _TICK)) - 1, 0)
        high = int(np.searchsorted(self._begins[name], end - _TICK))
        return set(self._task[name][low : high + 1].tolist())

    def of_others(self, name: str, begin: float, end: float) -> set[int]:
        """Return the tasks of all other robots in an interval."""
        others = (other for other in self._begins if other != name)
        return {task for other in others for task in self.during(other, begin, end)}


def _add_held_contacts(
    tasks: dict[frozenset[str], set[int]],
    times: _TaskTimes,
    changes: Sequence[Transfer],
    hands: dict[str, list[str]],
) -> None:
    """Add the contacts of hands with held objects."""
    taken: dict[str, float] = {}

    def add(robot: str, thing: str, some: Iterable[int]) -> None:
        for hand in hands.get(robot, ()):
            tasks[frozenset((hand, thing))] |= set(some)

    for change in changes:
        thing, motion = change.event.object, change.motion
        own = times.around(change.owner, motion, change.event.t_s)
        span = motion.t_s[0], motion.t_s[-1]
        if change.before is not None:
            since = taken.pop(thing, 0.0)
            add(change.before, thing, times.during(change.before, since, change.t))
            add(change.before, thing, own)
        if change.now not in (None, Handling.GONE):
            taken[thing] = change.t
            add(str(change.now), thing, own)
        if change.before is not None and change.now not in (None, Handling.GONE):
            both = times.of_others("", *span)
            add(change.before, thing, both)
            add(str(change.now), thing, both)
    for thing, since in taken.items():
        holder = next(c.now for c in reversed(changes) if c.event.object == thing)
        add(str(holder), thing, times.during(str(holder), since, np.inf))


def _add_neighbour_contacts(
    tasks: dict[frozenset[str], set[int]],
    times: _TaskTimes,
    planned: OpenPlanExecution,
    world: AuditWorld,
    touch: float,
) -> None:
    """Add the contacts of picked or placed objects with their neighbours."""
    neighbours = _Neighbours(world, touch)
    for item in world.cell.objects:
        if not item.later:
            neighbours.rest(item.name, item.start)
    for row in planned.recording.objects:
        if row.t <= 0.0 and row.holder is not None:
            neighbours.leave(row.object)
    for change in planned.changes:
        thing = change.event.object
        own = times.around(change.owner, change.motion, change.event.t_s)
        if change.before is None and change.event.verb != "appear":
            touched = set(neighbours.of(thing, change.pose))
        elif change.rests is not None:
            touched = set(neighbours.of(thing, change.rests))
        else:
            touched = set()
        for other in touched:
            tasks[frozenset((thing, other))] |= own
        neighbours.leave(thing)
        if change.rests is not None:
            neighbours.rest(thing, change.rests)


class _Neighbours:
    """Objects at rest, with a search for neighbours."""

    def __init__(self, world: AuditWorld, touch: float) -> None:
        self._world, self._touch = world, touch
        self._shapes = shapes_by_entity((*world.fixtures, *world.objects))
        self._poses = {item.name: item.pose for item in world.cell.fixtures}

    def rest(self, name: str, pose: Transform) -> None:
        """Add an object at rest."""
        self._poses[name] = pose

    def leave(self, name: str) -> None:
        """Remove an object."""
        self._poses.pop(name, None)

    def of(self, name: str, pose: Transform) -> Iterator[str]:
        """Yield the neighbours of an object at a pose."""
        own = self._boxes(name, pose)
        for other, at in self._poses.items():
            if other == name:
                continue
            near = self._boxes(other, at)
            pairs = (
                (a, b)
                for a, b in product(own, near)
                if np.all(np.abs(a[1] - b[1]) <= a[2] + b[2] + self._touch)
            )
            if any(self._gap(a[0], pose, b[0], at) <= self._touch for a, b in pairs):
                yield other

    def _boxes(
        self, name: str, pose: Transform
    ) -> list[tuple[WatchedShape, Transform, Transform]]:
        """Return the shapes of an entity, each with centre and half edges of its axis-aligned bounding box."""
        out = []
        for shape in self._shapes[name]:
            at = shape.at(pose)
            half = np.abs(at[:3, :3] @ shape.turn) @ shape.half
            out.append((shape, at[:3, 3] + at[:3, :3] @ shape.centre, half))
        return out

    def _gap(
        self, a: WatchedShape, pose: Transform, b: WatchedShape, at: Transform
    ) -> float:
        self._world.place(a, a.at(pose))
        self._world.place(b, b.at(at))
        return self._world.distance(a, b, 2.0 * self._touch)
