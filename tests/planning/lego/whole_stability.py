"""Stability by one linear program of the whole structure: what quick judgements must agree with."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linprog

from planning.lego.bricks.assembly import PlacedBrick
from planning.lego.stability.contacts import (
    JointStrength,
    ToolHold,
    brick_centre,
    bricks_by_name,
    filled_places,
    find_joints,
    joint_contacts,
    load_in_studs,
    side_contacts,
    tool_push,
)
from planning.statics.equilibrium import (
    STANDARD_GRAVITY,
    ContactForce,
    Load,
    StabilityReport,
    Vector,
)
from planning.transforms import Array


def stability(
    structure: Iterable[PlacedBrick],
    *,
    loads: Sequence[Load] = (),
    holds: Sequence[ToolHold] = (),
    loose: frozenset[str] = frozenset(),
    strength: JointStrength = JointStrength(),  # noqa: B008 - frozen
) -> StabilityReport:
    """Return whether a structure on a plate stands, and how much friction it needs.

    Args:
        structure: its bricks; those of layer 1 stand on the plate, which does not move.
        loads: forces besides gravity.
        holds: tools that stand still against bricks.
        loose: bricks that are just being pressed into place; their joints push but do not
            pull yet.
        strength: what joints bear.
    """
    bricks = bricks_by_name(structure)
    filled = filled_places(bricks)
    if not bricks:
        return StabilityReport(0.0, None)
    contacts = [tool_push(hold) for hold in holds]
    for joint in find_joints(bricks, filled):
        for contact in joint_contacts(joint, bricks[joint.upper], strength):
            free = joint.upper in loose or joint.lower in loose
            contacts.append(replace(contact, pull=0.0) if free else contact)
    contacts += side_contacts(bricks, filled)
    return _least_pull(bricks, contacts, [load_in_studs(load) for load in loads])


def _least_pull(
    bricks: Mapping[str, PlacedBrick],
    contacts: Sequence[ContactForce],
    loads: Sequence[Load],
) -> StabilityReport:
    """Solve the plain program by scipy: the score, and the brick that it depends on most."""
    number = {name: k for k, name in enumerate(bricks)}
    centres = np.array([brick_centre(item) for item in bricks.values()])
    shares = [(load, point) for load in loads for point in load.points]
    matrix = np.zeros((6 * len(bricks) + len(loads), len(contacts) + len(shares) + 1))

    def push(name: str | None, column: int, point: Vector, force: Array) -> None:
        if name is not None:
            k = number[name]
            # By hand: numpy's cross product takes a hundred times as long for one vector.
            (x, y, z), (a, b, c) = point - centres[k], force
            turn = y * c - z * b, z * a - x * c, x * b - y * a
            matrix[6 * k : 6 * k + 6, column] += [*force, *turn]

    for k, c in enumerate(contacts):
        push(c.first, k, c.point, -np.array(c.direction))
        push(c.second, k, c.point, np.array(c.direction))
    for k, (load, point) in enumerate(shares, start=len(contacts)):
        push(load.body, k, point, np.array(load.force))
        matrix[6 * len(bricks) + loads.index(load), k] = 1.0
    pulls = np.array([c.pull for c in contacts])
    matrix[:, -1] = -(matrix[:, : len(contacts)] @ pulls)
    target = np.zeros(len(matrix))
    target[2 : 6 * len(bricks) : 6] = [
        item.brick.mass * STANDARD_GRAVITY for item in bricks.values()
    ]
    target[6 * len(bricks) :] = 1.0
    bounds = [
        (0, None) if c.within is None else (-c.within, c.within) for c in contacts
    ]
    bounds += [(0, None)] * (len(shares) + 1)
    cost = np.zeros(matrix.shape[1])
    cost[-1] = 1.0
    found = linprog(cost, A_eq=matrix, b_eq=target, bounds=bounds)
    if found.status == 4:  # presolving leaves some in doubt
        found = linprog(
            cost, A_eq=matrix, b_eq=target, bounds=bounds, options={"presolve": False}
        )
    assert found.status in (0, 2), found.message
    if found.status == 2:
        return StabilityReport(math.inf, None)
    price = dict.fromkeys(bricks, 0.0)
    for c, marginal in zip(contacts, found.lower.marginals, strict=False):
        price[c.second or c.first or ""] += c.pull * marginal
    worst = max(price, key=lambda name: price[name] > 0.999999 * max(price.values()))
    assert found.fun is not None
    score = 0.0 if found.fun < 1e-9 else float(found.fun)
    return StabilityReport(score, worst if score else None)
