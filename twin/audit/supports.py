"""Robots that hold something for another one are there in time, and stay until it is done.

Parts that are kept hold of until they are joined: who placed them stands still until then.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from operator import itemgetter

import numpy as np

from planning.tasks.task import TRANSIT, Task
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.case import AuditCase, Violation
from twin.audit.grips import RIGHT, as_shaped
from twin.audit.motion.executed import Stay
from twin.audit.places import taken
from twin.audit.worlds.world import FAR

SUPPORT = 0.003
"""A tool that holds against objects is no further away from one: studs, 1.7 mm high, are no part
of the boxes [m]."""

_SUPPORTS = ("support-bottom", "support-top")
_PLACES = ("place-down", "place-up")


def support_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield what was put down without the support that it needs, and handovers to who moves.

    A step needs a support where the scenario says so, or where the plan has a support for it.
    While the node in which the object is put down lasts, one other robot must stand still with
    its tool at an object at rest. At a handover, one of the two must stand still while the node
    of the other lasts.
    """
    held = _held_objects(case)
    tools = {tool.name for tool in case.wanted.tools}
    for stay in case.handed():
        giver, taker = stay.giver, stay.holder
        if giver is None or giver not in case.robots or giver == taker:
            continue
        span = _node_span(case, giver, stay.t)
        if taker is not None and taker in case.robots:
            still = case.robots[taker].stands(*span)
            other = _node_span(case, taker, stay.t)
            if not still and not case.robots[giver].stands(*other):
                detail = f"{stay.object} changes hands while both move"
                yield Violation(stay.t, stay.t, giver, taker, 0.0, detail, "support")
        elif taker is None and stay.object in held:
            there = {k: s for k, s in case.at(stay.t).items() if k not in tools}
            hand = nearest_hand(case, span, giver, there)
            if hand.is_near:
                continue
            detail, gap = "nobody else stands still meanwhile", 0.0
            if hand.gap < FAR:
                gap = hand.gap
                detail = (
                    f"of those who stand still meanwhile, {hand.robot} is nearest to"
                )
                detail += f" an object, {gap * 1e3:.2f} mm away"
                detail += f", which {hand.loose}" if hand.loose else ""
            detail = f"is put down without its support: {detail}"
            yield Violation(*span, stay.object, hand.robot, gap, detail, "support")


def _held_objects(case: AuditCase) -> set[str]:
    """Return the objects that need a support when they are put down."""
    tasks, places = case.tpg.tasks, case.wanted.places
    steps = {task.step for task in tasks if task.kind in _SUPPORTS}
    planned = (t for t in tasks if t.kind in _PLACES and t.step in steps)
    out = {task.object for task in planned if task.object is not None}
    pairs = zip(places, taken(case.cell, case.at(), places), strict=True)
    return out | {name for place, name in pairs if place.held and name is not None}


def _node_span(case: AuditCase, robot: str, t: float) -> tuple[float, float]:
    """Return from when to when a robot moves in the node of a time, which is all that it may do [s]."""
    rows, own = case.robots[robot], case.moved.get(robot)
    k = min(int(np.searchsorted(rows.t, t - 1e-9)), len(rows.t) - 1)
    node = int(rows.node[k])
    if own is None or not 0 <= node < len(own.begin) or np.isinf(own.begin[node]):
        return float(rows.t[k]), float(rows.t[k])
    return float(own.begin[node]), float(own.end[node])


@dataclass(frozen=True)
class NearestHand:
    """Tool that is nearest to some objects, of robots that stand still.

    Attributes:
        robot: whose; ``"nobody"`` where nobody stands still.
        gap: how far it is from the nearest of them; ``FAR`` where there is none [m].
        closing: by how much its fingers close on that [m].
        loose: what is wrong with how it holds that; empty where it does, or nothing tells.
    """

    robot: str = "nobody"
    gap: float = FAR
    closing: float = 0.0
    loose: str = ""

    @property
    def before(self) -> tuple[bool, float]:
        """Less for who holds it, then for who is nearer."""
        return not self.is_near, self.gap - self.closing

    @property
    def is_near(self) -> bool:
        """Whether it holds the object."""
        return self.gap <= SUPPORT + self.closing and not self.loose


def nearest_hand(
    case: AuditCase,
    span: tuple[float, float],
    besides: str,
    there: Mapping[str, Stay],
) -> NearestHand:
    """Return whose tool is nearest to what rests, of those who stand still for some time.

    Fingers that stand open close on the thinnest edge. Pads and cups must hold an object as they do
    one that they carry: who does comes before who is nearer.

    Args:
        case: what was executed.
        span: from when to when the robot stands still [s].
        besides: a robot that does not count.
        there: where the objects are that count where they are at rest.
    """
    found = NearestHand()
    resting = {name: stay.pose for name, stay in there.items() if stay.holder is None}
    for robot, rows in case.robots.items():
        if robot == besides or not rows.stands(*span):
            continue
        hand = case.hand(robot, span[0])
        flange, loose = case.flange(robot, span[0]), dict[str, str]()
        for shape in case.world.objects:
            pose = resting.get(shape.entity)
            if pose is None:
                continue
            case.world.place(shape, shape.at(pose))
            gap = min(case.world.distance(part, shape, FAR) for part in hand.shapes)
            closes = hand.closes_by(shape)
            if gap <= SUPPORT + closes and shape.entity not in loose:
                about = hand, robot, flange, shape.entity, pose
                _, loose[shape.entity] = as_shaped(case, *about) or RIGHT
            other = NearestHand(robot, gap, closes, loose.get(shape.entity, ""))
            if other.before < found.before:
                found = other
    return found


def keeping_violations(
    case: AuditCase, ends: Mapping[str, float]
) -> Iterator[Violation]:
    """Yield parts that were let go of before what they are to be held for was complete.

    A part is to be kept hold of where the scenario says until when, or where the plan has its
    robot let go of it after another task. While it was carried its robot's tool was at it, which
    the grips say, and it does not move any more: so the tool stays at it as long as that robot
    stands.

    Args:
        case: what was executed, to its end. Without a log it is not known how long the work of
            machines had to be waited for.
        ends: when steps that have names were complete [s].
    """
    asked: dict[str, tuple[float, str]] = {
        part: (ends[step], step)
        for part, step in case.wanted.keeps.items()
        if step in ends
    }
    for part, task, end in _kept_until(case):
        asked[part] = max(asked.get(part, (end, task)), (end, task), key=itemgetter(0))
    for part, (end, until) in asked.items():
        for stay in _put_down(case, part):
            leaves = case.robots[str(stay.giver)].leaves(stay.t)
            if leaves < end - 1e-6:
                detail = f"is let go of {end - leaves:.3f} s before {until} is complete"
                who = str(stay.giver)
                yield Violation(leaves, end, part, who, 0.0, detail, "support")


def states_and_kept(
    case: AuditCase,
) -> Iterator[tuple[float, Mapping[str, Stay], set[str]]]:
    """Yield when something changes, where everything is then, and which parts are kept hold of in their places."""
    held = _held_in_place(case)
    ends = [until for _, until in held.values() if 0.0 < until <= case.end]
    for t, there in case.states(*ends):
        yield t, there, {k for k, (begin, end) in held.items() if begin <= t < end}


def _held_in_place(case: AuditCase) -> dict[str, tuple[float, float]]:
    """Return from when to when parts that are kept hold of are held where they were put down [s].

    That is as long as who placed them stands still, whatever they are kept hold of for; where balance is looked
    at, and the rest of a plan was not executed, that may be any part.
    """
    wanted, begins = case.wanted, dict[str, Task]()
    parts = {*wanted.keeps, *(part for part, _ in _kept_in_plan(case.tpg))}
    if wanted.statics is not None:
        parts |= {place.object for place in wanted.places if place.object is not None}
        begins = {task.robot: task for task in reversed(case.tpg.tasks)}
    found = {
        part: (stay.t, case.robots[str(stay.giver)].leaves(stay.t))
        for part in parts
        for stay in _put_down(case, part)
    }
    for robot, task in begins.items():
        if task.kind == TRANSIT and task.object and not task.handlings:
            # The plan begins while it keeps hold of it.
            found.setdefault(task.object, (0.0, case.robots[robot].leaves(0.0)))
    return found


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


def _kept_until(case: AuditCase) -> Iterator[tuple[str, str, float]]:
    """Yield parts that the plan keeps hold of, the words of the task until which, and its end."""
    tpg, spans = case.tpg, case.logged
    for part, first in _kept_in_plan(tpg):
        chain = tpg.chains[tpg.chain_index[tpg.tasks[first].robot]]
        nodes = np.flatnonzero(chain.task == first)
        if chain.robot in case.robots:
            rows = case.robots[chain.robot]
            end = float(rows.t[np.isin(rows.node, nodes)].max(initial=-np.inf))
        elif chain.robot in spans:
            end = float(spans[chain.robot].end[nodes].max())
        else:
            continue
        if np.isfinite(end):
            yield part, tpg.tasks[first].label, end


def _put_down(case: AuditCase, part: str) -> tuple[Stay, ...]:
    """Return where a part lies since a robot put it down last; nothing if none did."""
    stays = case.stays.get(part, ())
    return tuple(
        stay for stay in stays if stay.holder is None and stay.giver in case.robots
    )[-1:]
