"""Allowed contacts and required clearances, as arrays for compiled code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import Clearances
from planning.geometry.exact import TOLERANCE
from planning.geometry.robot_bodies import GROUPS
from planning.kernels import inner_kernel
from planning.packed import packed
from planning.tasks.task import AllowedContact
from planning.transforms import Array, Indices

ALWAYS = -1
"""Placeholder for a task that is part of every allowed contact: the thing is no robot's node."""


class ContactTable(NamedTuple):
    """Allowed contacts and clearances over numbered entities.

    Entities are the arm and the tool of every robot, then the objects.

    Attributes:
        head: first entry for a pair of entities, -1 for none, shape (entities, entities).
        following: next entry for the same pair, -1 for none, shape (entries,).
        first: where an entry's tasks begin, shape (entries + 1,).
        tasks: task indices, rising within an entry.
        clearance: least distance of what moves with two robots, and of anything to an object
            at rest, see ``least_distance``, shape (2,) [m].
        robots: number of entities that belong to robots.
        gap: how far capsules are apart that need no closer look [m].
    """

    head: npt.NDArray[np.int32]
    following: npt.NDArray[np.int32]
    first: Indices
    tasks: Indices
    clearance: Array
    robots: int
    gap: float


def contact_table(
    entities: Mapping[str, int],
    robots: int,
    allowed: Iterable[AllowedContact],
    clearances: Clearances,
) -> ContactTable:
    """Return the table of the contacts between numbered entities.

    Args:
        entities: number of each entity.
        robots: number of robots.
        allowed: the contacts.
        clearances: least distances.
    """
    head = np.full((len(entities), len(entities)), -1, dtype=np.int32)
    following: list[int] = []
    first = [0]
    tasks: list[int] = []
    for contact in allowed:
        if contact.first not in entities or contact.second not in entities:
            continue
        x, y = entities[contact.first], entities[contact.second]
        following.append(int(head[x, y]))
        head[x, y] = head[y, x] = len(following) - 1
        tasks += sorted(contact.tasks)
        first.append(len(tasks))
    table = ContactTable(
        head,
        np.array(following, dtype=np.int32),
        np.array(first, dtype=np.int64),
        np.array(tasks, dtype=np.int64),
        np.array([clearances.robot_robot, clearances.robot_object]),
        len(GROUPS) * robots,
        # Hulls are decided on with a tolerance.
        max(clearances.robot_robot, clearances.robot_object) + TOLERANCE,
    )
    return packed(table)


@inner_kernel
def least_distance(
    table: ContactTable, x: int, x_joint: int, y: int, y_joint: int
) -> float:
    """Return the required clearance of two entities of different occupancies [m].

    What a robot carries moves with a joint, as its own parts do, and keeps the same clearance.

    Args:
        table: the clearances.
        x, y: entities.
        x_joint, y_joint: joints that carry them, negative for a robot's base and at rest.
    """
    if (x < table.robots or x_joint >= 0) and (y < table.robots or y_joint >= 0):
        return float(table.clearance[0])
    return float(table.clearance[1])


@inner_kernel
def _lists(table: ContactTable, entry: int, task: int) -> bool:
    if task == ALWAYS:
        return True
    lo, hi = table.first[entry], table.first[entry + 1]
    while lo < hi:
        middle = (lo + hi) // 2
        if table.tasks[middle] < task:
            lo = middle + 1
        else:
            hi = middle
    return bool(lo < table.first[entry + 1] and table.tasks[lo] == task)


@inner_kernel
def is_contact_allowed(
    table: ContactTable,
    x: int,
    y: int,
    x_task: int,
    x_other_task: int,
    y_task: int,
    y_other_task: int,
) -> bool:
    """Tell whether entities x and y may touch.

    Args:
        table: the table.
        x, y: entities.
        x_task, x_other_task: tasks of the occupancy that x belongs to: a node has one, given
            twice, a hold the ones before and after it; either may allow the contact.
        y_task, y_other_task: likewise for y.
    """
    if x == y:
        return True
    entry = table.head[x, y]
    while entry >= 0:
        if (_lists(table, entry, x_task) or _lists(table, entry, x_other_task)) and (
            _lists(table, entry, y_task) or _lists(table, entry, y_other_task)
        ):
            return True
        entry = table.following[entry]
    return False
