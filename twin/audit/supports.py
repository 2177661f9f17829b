"""Robots that hold something for another one are there in time, and stay until it is done."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.grips import finger_travel
from twin.audit.keeping import NodeSpans
from twin.audit.motion.replay import Replay, Stay
from twin.audit.places import taken
from twin.audit.tools import hand_at
from twin.audit.violation import Violation
from twin.audit.wanted import Wanted
from twin.audit.worlds.world import FAR, AuditWorld

SUPPORT = 0.003
"""A tool that holds against objects is no further away from one: studs, 1.7 mm high, are no part
of the boxes [m]."""

_SUPPORTS = ("support-bottom", "support-top")
_PLACES = ("place-down", "place-up")


def support_violations(
    world: AuditWorld,
    tpg: TemporalPlanGraph,
    replay: Replay,
    wanted: Wanted,
    moved: Mapping[str, NodeSpans],
) -> Iterator[Violation]:
    """Yield what was put down without the support that it needs, and handovers to who moves.

    A step needs a support where the scenario says so, or where the plan has a support for it.
    While the node in which the object is put down lasts, one other robot must stand still with
    its tool at an object at rest. At a handover, one of the two must stand still while the node
    of the other lasts.

    Args:
        world: to measure in.
        tpg: says which tasks are supports.
        replay: what was executed.
        wanted: says which places need one.
        moved: when robots moved in their nodes.
    """
    held = _held_objects(tpg, replay, wanted)
    for stay in replay.handed():
        giver = stay.giver
        if giver is None or giver not in replay.robots or giver == stay.holder:
            continue
        span = _node_span(replay, moved, giver, stay.t)
        if stay.holder in replay.robots:
            yield from _handed_over(replay, moved, stay, span)
        elif stay.holder is None and stay.object in held:
            yield from _supported(world, replay, wanted, stay, span)


def _held_objects(tpg: TemporalPlanGraph, replay: Replay, wanted: Wanted) -> set[str]:
    """Return the objects that need a support when they are put down."""
    steps = {task.step for task in tpg.tasks if task.kind in _SUPPORTS}
    planned = (t for t in tpg.tasks if t.kind in _PLACES and t.step in steps)
    out = {task.object for task in planned if task.object is not None}
    filled = taken(replay.cell, replay.at(), wanted.places)
    pairs = zip(wanted.places, filled, strict=True)
    return out | {name for place, name in pairs if place.held and name is not None}


def _node_span(
    replay: Replay, moved: Mapping[str, NodeSpans], robot: str, t: float
) -> tuple[float, float]:
    """Return from when to when a robot moves in the node of a time, which is all that it may do [s]."""
    rows, own = replay.robots[robot], moved.get(robot)
    k = min(int(np.searchsorted(rows.t, t - 1e-9)), len(rows.t) - 1)
    node = int(rows.node[k])
    if own is None or not 0 <= node < len(own.begin) or np.isinf(own.begin[node]):
        return float(rows.t[k]), float(rows.t[k])
    return float(own.begin[node]), float(own.end[node])


def _handed_over(
    replay: Replay,
    moved: Mapping[str, NodeSpans],
    stay: Stay,
    span: tuple[float, float],
) -> Iterator[Violation]:
    giver, taker = str(stay.giver), str(stay.holder)
    other = _node_span(replay, moved, taker, stay.t)
    still = replay.robots[taker].stands(*span)
    if not still and not replay.robots[giver].stands(*other):
        detail = f"{stay.object} changes hands while both move"
        yield Violation(stay.t, stay.t, giver, taker, 0.0, detail, "support")


def _supported(
    world: AuditWorld,
    replay: Replay,
    wanted: Wanted,
    stay: Stay,
    span: tuple[float, float],
) -> Iterator[Violation]:
    tools = {tool.name for tool in wanted.tools}
    there = {k: s for k, s in replay.at(stay.t).items() if k not in tools}
    hand = nearest_hand(world, replay, wanted, span, str(stay.giver), there)
    if hand.is_near:
        return
    detail, gap = "nobody else stands still meanwhile", 0.0
    if hand.gap < FAR:
        gap = hand.gap
        detail = f"of those who stand still meanwhile, {hand.robot} is nearest to an object, "
        detail += f"{gap * 1e3:.2f} mm away"
    detail = f"is put down without its support: {detail}"
    yield Violation(*span, stay.object, hand.robot, gap, detail, "support")


@dataclass(frozen=True)
class NearestHand:
    """Tool that is nearest to some objects, of robots that stand still.

    Attributes:
        robot: whose; ``"nobody"`` where nobody stands still.
        gap: how far it is from the nearest of them; ``FAR`` where there is none [m].
        closing: by how much its fingers close on that [m].
    """

    robot: str = "nobody"
    gap: float = FAR
    closing: float = 0.0

    @property
    def is_near(self) -> bool:
        """Whether it holds the object."""
        return self.gap <= SUPPORT + self.closing


def nearest_hand(
    world: AuditWorld,
    replay: Replay,
    wanted: Wanted,
    span: tuple[float, float],
    besides: str,
    there: Mapping[str, Stay],
) -> NearestHand:
    """Return whose tool is nearest to what rests, of those who stand still for some time.

    Fingers that stand open close on the thinnest edge.

    Args:
        world: to measure in.
        replay: what was executed.
        wanted: how far fingers stand open, and which tools are changed.
        span: from when to when the robot stands still [s].
        besides: a robot that does not count.
        there: where the objects are that count where they are at rest.
    """
    found = NearestHand()
    for k, robot in enumerate(world.cell.robots):
        if robot.name == besides or not replay.robots[robot.name].stands(*span):
            continue
        hand = hand_at(world, replay, wanted, k, span[0])
        opening = hand.opening(wanted.opening_m)
        for shape in world.objects:
            stay = there.get(shape.entity)
            if stay is None or stay.holder is not None:
                continue
            world.place(shape, shape.at(stay.pose))
            gap = min(world.distance(part, shape, FAR) for part in hand.shapes)
            closes = finger_travel(shape, opening)
            if gap - closes < found.gap - found.closing:
                found = NearestHand(robot.name, gap, closes)
    return found
