"""Allowed contacts with their penetration depths, contacts of held objects, and self-collisions.

A self-collision is a contact between two parts of a robot, or between an arm and its load.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from planning.cell.workcell import CONTACT_DEPTH
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.bodies import VerifiedRobot
from scheduling.verification.object_places import Carried
from scheduling.verification.problems import Problem, node_problem
from scheduling.witness.measuring import Measuring
from scheduling.witness.own_motions import OwnMotions
from scheduling.witness.parts import TOLERANCE, ConvexPart, measure
from scheduling.witness.robot import WitnessRobot

SLACK = 1e-4
"""Default depth up to which an overlap is ignored: hulls are larger than the bodies in them [m]."""

Depths = Mapping[frozenset[str], list[tuple[frozenset[int], float]]]
"""Allowed contacts of each pair of names: the tasks during which they may touch, and the allowed depth [m]."""


def allowed_depths(tpg: TemporalPlanGraph) -> Depths:
    """Return the penetration depths that a plan allows for pairs of things.

    A contact counts only if handling needs it: of a tool and an object, of two objects, or of an
    object and a fixture. Robots never touch each other, and an arm never touches anything.
    """
    cell = tpg.cell
    objects = {item.name for item in cell.objects}
    fixtures = {item.name for item in cell.fixtures}
    tools = {f"{robot.name}/tool" for robot in cell.robots}
    out: dict[frozenset[str], list[tuple[frozenset[int], float]]] = {}
    for contact in tpg.allowed:
        pair = frozenset((contact.first, contact.second))
        others = pair - objects
        if len(pair) < 2 or len(others) > 1 or not others <= tools | fixtures:
            continue
        depth = cell.clearances.contact_depth
        if contact.grazing:
            depth = cell.clearances.contact_tolerance
        elif not others.isdisjoint(tools):
            depth = CONTACT_DEPTH
        elif contact.depth is not None:
            depth = min(depth, contact.depth)
        out.setdefault(pair, []).append((contact.tasks, depth))
    return out


def too_deep_in_hand(
    tpg: TemporalPlanGraph,
    geometry: Mapping[str, WitnessRobot],
    carried: list[Carried],
    allowed: Depths,
) -> Iterator[Problem]:
    """Yield objects that penetrate the holding hand, or others in that hand, too deep.

    From then on until it is let go of they move as one, so that one look at each hold is enough.

    Args:
        tpg: the plan.
        geometry: of all robots.
        carried: the objects carried by each robot over time.
        allowed: allowed contacts.
    """
    for k, held in enumerate(carried):
        chain = tpg.chains[held.chain]
        robot = geometry[chain.robot]
        load = _load(tpg, robot, held)
        fixed_parts = [part for part in robot.parts if part.joint == robot.dof - 1]
        for other in carried[:k]:
            if other.chain == held.chain and _meet(other, held):
                fixed_parts += _load(tpg, robot, other)
        frames = robot.joint_frames_along(chain.start[None])[0]
        tasks = set(chain.task[held.start[0] : held.end[0] + 1].tolist())
        deepest: dict[str, float] = {}
        for part in load:
            for other_part in fixed_parts:
                at = frames[part.joint + 1], frames[other_part.joint + 1]
                depth = -measure(part, at[0], other_part, at[1])
                entity = other_part.entity
                deepest[entity] = max(deepest.get(entity, 0.0), depth)
        for entity, depth in deepest.items():
            pair = frozenset((held.object, entity))
            entries = allowed.get(pair, ())
            most = max((d for now, d in entries if tasks & now), default=0.0)
            if depth > max(most + TOLERANCE, SLACK):
                where = held.chain, min(held.start[0], len(chain) - 1)
                text = (
                    f"{held.object!r} is {depth * 1e3:.2f} mm deep in {entity} while"
                    f" {chain.robot!r} holds it, and may be {most * 1e3:g} mm"
                )
                yield node_problem(tpg, "grip", where, text)


def _load(
    tpg: TemporalPlanGraph, robot: WitnessRobot, held: Carried
) -> list[ConvexPart]:
    return robot.loads(held.object, tpg.cell.object(held.object).shape, held.pose)


def _meet(one: Carried, other: Carried) -> bool:
    """Tell whether two holds overlap in time."""
    return one.start < other.end and other.start < one.end


def self_contact_problems(
    robot: VerifiedRobot, reference: WitnessRobot
) -> Iterator[Problem]:
    """Yield nodes with self-collision of a robot, or contact with its load.

    Parts of neighbouring joints touch by design, and those that overlap at HOME only do so because
    hulls are larger than what they contain. Pairs of links that the description exempts are left out.
    What is on the last joint moves with the load.

    Args:
        robot: its pieces, parts and loads.
        reference: its geometry.
    """
    knots = robot.pieces.knots
    own = OwnMotions(reference, knots, reference.joint_frames_along(knots))
    parts = [body for body in robot.bodies if not body.load]
    loads = [body for body in robot.bodies if body.load]
    home = reference.joint_frames_along(robot.home[None])[0]
    everything = np.arange(len(robot.pieces))
    numbered = enumerate(body.motions[0].part for body in parts)
    for (i, first), (j, second) in combinations(numbered, 2):
        x, y = sorted((first, second), key=lambda part: part.joint)
        if y.joint - x.joint <= 1 or (i, j) in reference.ignored:
            continue
        if measure(x, home[x.joint + 1], y, home[y.joint + 1]) <= 0.0:
            continue
        yield from _in_pieces(robot, own, (x, y), everything)
    for body in loads:
        for k, motion in enumerate(body.motions):
            held = np.array(body.spans[k], dtype=np.int64)
            for arm in parts:
                x = arm.motions[0].part
                if x.joint < motion.part.joint:
                    yield from _in_pieces(robot, own, (x, motion.part), held)


def _in_pieces(
    robot: VerifiedRobot,
    own: OwnMotions,
    parts: tuple[ConvexPart, ConvexPart],
    pieces: Indices,
) -> Iterator[Problem]:
    """Yield the nodes of some pieces in which two parts touch, the inner part given first."""
    found = own.too_close(Measuring(), parts, pieces, -SLACK, robot.pieces.keys)
    for piece, distance in found:
        first, second = (robot.moment(piece, part.entity) for part in parts)
        text = f"{first} overlaps {second.body} by {-distance * 1e3:.2f} mm"
        yield Problem("itself", text, first, second, distance)
