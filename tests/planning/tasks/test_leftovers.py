"""What is left of a step in the middle of which a world is."""

from __future__ import annotations

import numpy as np
import pytest

from planning.cell.workcell import WorldState
from planning.tasks.task import AllowedContact, StepTasks, Task, TaskKind
from planning.worlds.world import World, unfinished_steps

WAYS = {
    TaskKind.TRANSIT: [[1.0, 0.0]],
    "in": [[1.1, 0.1], [1.2, 0.2], [1.3, 0.3]],
    "screw": [[1.3, 0.4]],
    "out": [[1.2, 0.3], [1.0, 0.0]],
    "HOME": [[0.0, 0.0]],
}
KINDS = (
    TaskKind.TRANSIT,
    TaskKind.STRAIGHT,
    "screw",
    TaskKind.STRAIGHT,
    TaskKind.TRANSIT,
)
STEP = StepTasks(
    1,
    tuple(
        Task(k, "arm", kind, 1, words, np.array(path))
        for k, (kind, (words, path)) in enumerate(zip(KINDS, WAYS.items(), strict=True))
    ),
    (),
    (AllowedContact("arm/tool", "screw", frozenset({1, 2, 3})),),
)


@pytest.mark.parametrize(
    ("complete", "way", "touches"),
    [
        (2, [[1.2, 0.2], [1.1, 0.1], [1.0, 0.0]], {9}),  # back along the way in
        (3, WAYS["out"], {1, 2, 9}),  # as it would have gone
        (4, None, None),  # it is out already
    ],
)
def test_a_robot_leaves_a_straight_way_along_it(
    complete: int, way: list[list[float]] | None, touches: set[int] | None
) -> None:
    """Where its step is begun anew; what touches on it does so there, and in nothing that is not done."""
    state = WorldState({"arm": STEP.tasks[complete - 1].path[-1]}, {})
    world = World(state, (STEP,), complete=frozenset(range(complete)), tasks=9)
    found = unfinished_steps(world, {1: frozenset({"arm"})})
    if way is None:
        assert not found
        return
    (left,) = found
    assert left.ends
    numbered = left.numbered(9)
    (task,), (contact,) = numbered.tasks, numbered.allowed
    assert (task.index, task.kind) == (9, TaskKind.STRAIGHT)
    assert task.path.tolist() == way
    assert set(contact.tasks) == touches
