"""The state of the cell as tasks are done one after another."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from planning.cell.workcell import Attachment, Workcell, WorldState
from planning.tasks.task import GONE, AllowedContact, Handling
from planning.transforms import Array


def apply_handlings(state: WorldState, handlings: Iterable[Handling]) -> WorldState:
    """Return the state after objects have changed hands, the same one if none do."""
    handlings = list(handlings)
    if not handlings:
        return state
    attachments = dict(state.attachments)
    for handling in handlings:
        if handling.holder == GONE:
            attachments.pop(handling.object, None)
            continue
        attachments[handling.object] = Attachment(handling.holder, handling.pose)
    return WorldState(state.configurations, attachments)


def move_robot(state: WorldState, robot: str, q: Array) -> WorldState:
    """Return the state with one robot standing at ``q``, shape (n,)."""
    return WorldState({**state.configurations, robot: q}, state.attachments)


def allowed_pairs(
    cell: Workcell,
    state: WorldState,
    robot: str,
    task: int,
    last_task: Mapping[str, int],
    allowed: Iterable[AllowedContact],
) -> frozenset[frozenset[str]]:
    """Return the allowed contacts while one robot does a task and the others stand.

    Args:
        cell: the cell.
        state: where everything is; an object held by another robot counts as that robot.
        robot: who moves.
        task: index of its task.
        last_task: task that each other robot did last; absent for one that did none yet.
        allowed: the table of allowed contacts.
    """
    tools = {f"{placed.name}/tool": placed.name for placed in cell.robots}

    def owner(name: str) -> str | None:
        """Return the robot that a thing moves with, None for what is at rest."""
        at = state.attachments.get(name)
        return tools.get(name, None if at is None else at.holder)

    pairs = set()
    for contact in allowed:
        if task not in contact.tasks:
            continue
        others = {owner(contact.first), owner(contact.second)} - {None, robot}
        if all(last_task.get(other or "", -1) in contact.tasks for other in others):
            pairs.add(frozenset((contact.first, contact.second)))
    return frozenset(pairs)
