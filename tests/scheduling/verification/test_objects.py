"""The verification holds objects to where they are, and what is done to what tasks say."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from planning.tasks.task import GONE, AllowedContact
from planning.transforms import Transform, translation
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.verify import verify_plan
from tests.scheduling.verification.test_verification import (
    carrying,
    graph,
    passing_on,
    taking_turns,
)

Change = Callable[[TemporalPlanGraph], TemporalPlanGraph]


def carried() -> TemporalPlanGraph:
    return graph(carrying(right_first=True), (1, 1, 0, 0))


def passed_on() -> TemporalPlanGraph:
    return graph(passing_on(), (1, 0, 0, 1), (0, 2, 1, 1))


def handled(k: int, *, told: bool = True, **fields: object) -> Change:
    """Change one handling of a plan, and also what its task says of it."""

    def change(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
        h = tpg.handlings[k]
        index = int(tpg.chains[h.robot].task[h.node])
        handlings, tasks = list(tpg.handlings), list(tpg.tasks)
        handlings[k] = replace(h, **fields)  # type: ignore[arg-type]
        if told:
            (said,) = tasks[index].handlings
            said = replace(said, **fields)  # type: ignore[arg-type]
            tasks[index] = replace(tasks[index], handlings=(said,))
        return replace(tpg, handlings=tuple(handlings), tasks=tuple(tasks))

    return change


def beside(tpg: TemporalPlanGraph, k: int, way: float = 0.02) -> Transform:
    """Where something comes to by a handling, a little beside."""
    return tpg.handlings[k].pose @ translation(way, 0.0, 0.0)


def found(tpg: TemporalPlanGraph) -> tuple[str, str]:
    """Kind and words of the first problem."""
    first = verify_plan(tpg, limit=1).problems[0]
    return first.kind, first.message


@pytest.mark.parametrize(
    ("make", "k", "words"),
    [
        (carried, 0, "'block' is taken by 'left' 20.00 mm away from where it lies"),
        (carried, 1, "'block' is put down 20.00 mm away from where it is in the hand"),
        (passed_on, 1, "'beam' is given to 'right' 20.00 mm away from where 'left'"),
    ],
)
@pytest.mark.parametrize("told", [True, False])
def test_what_jumps_as_it_changes_hands_is_found(
    make: Callable[[], TemporalPlanGraph], k: int, words: str, told: bool
) -> None:
    tpg = make()
    assert verify_plan(tpg).ok
    changed = handled(k, told=told, pose=beside(tpg, k))(tpg)
    messages = [p.message for p in verify_plan(changed).problems]
    assert any(words in message for message in messages)
    if not told:
        assert "20.00 mm beside where its task says" in messages[0]


def test_what_is_elsewhere_by_a_rounding_is_not_found() -> None:
    tpg = carried()
    for way, fine in ((2e-5, True), (2e-4, False)):
        assert verify_plan(handled(1, pose=beside(tpg, 1, way))(tpg)).ok is fine


def test_what_is_handled_by_who_does_not_have_it_is_found() -> None:
    tpg = carried()
    for holder in ("right", GONE):
        problems = verify_plan(handled(0, holder=holder)(tpg)).problems
        first, *others = (p.message for p in problems if p.kind == "jump")
        assert "changes hands, and 'left' neither has it nor gets it" in first
        assert any("after it has left the cell" in p for p in others) is (
            holder == GONE
        )


def test_what_comes_up_later_cannot_be_taken_before() -> None:
    tpg = carried()
    objects = tuple(replace(item, later=True) for item in tpg.cell.objects)
    kind, message = found(replace(tpg, cell=replace(tpg.cell, objects=objects)))
    assert (kind, message.split(": ")[1]) == (
        "jump",
        "'block' is handled before it has come up",
    )


def of_task(index: int, **fields: object) -> Change:
    def change(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
        tasks = list(tpg.tasks)
        tasks[index] = replace(tasks[index], **fields)  # type: ignore[arg-type]
        return replace(tpg, tasks=tuple(tasks))

    return change


def without_handlings(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    tasks = tuple(replace(task, handlings=()) for task in tpg.tasks)
    return replace(tpg, tasks=tasks, handlings=())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: replace(t, handlings=t.handlings[1:]), "does not, though its task"),
        (of_task(2, handlings=()), "that 'block' goes to left is no part of it"),
        (
            lambda t: of_task(2, kind="pick", object="block")(without_handlings(t)),
            "'block' does not change hands in it",
        ),
        (of_task(2, robot="right"), "is done by 'left', and is a task of 'right'"),
        (of_task(2, kind="pick", path=np.zeros((1, 6))), "its path is up to"),
        (of_task(2, kind="pick", path=np.zeros((2, 6))), "its path has 1 waypoints"),
        (of_task(2, goal=True, path=np.zeros((1, 6))), "beside the goal of its task"),
    ],
)
def test_what_is_not_done_as_its_task_says_is_found(change: Change, words: str) -> None:
    changed = change(carried())
    problems = verify_plan(changed).problems
    assert any(p.kind == "task" and words in p.message for p in problems), problems


def test_a_skill_without_a_node_is_found() -> None:
    tpg = carried()
    missing = replace(tpg.tasks[-1], index=len(tpg.tasks), kind="weld", label="weld it")
    kind, message = found(replace(tpg, tasks=(*tpg.tasks, missing)))
    assert kind == "task"
    assert "(weld it) of 'left' has no node" in message


def test_robots_that_jump_from_home_or_between_nodes_are_found() -> None:
    tpg = graph(taking_turns(), (0, 1, 1, 0))
    chain = tpg.chains[0]
    for changed, words in (
        (replace(chain, start=chain.start + 0.1), "begins 0.1 rad or m away from HOME"),
        (replace(chain, duration=chain.duration * 0.01), "joint 5 jumps by 3.14 rad"),
    ):
        problems = verify_plan(replace(tpg, chains=(changed, tpg.chains[1]))).problems
        assert problems[0].kind == "path"
        assert words in problems[0].message
        assert problems[0].first is not None
        assert problems[0].first.node == 0


def test_what_is_deep_in_the_tool_that_holds_it_is_found() -> None:
    """The block is picked where the lever is 0.7 mm in it, and lies 5 mm higher in another cell."""
    tpg = carried()
    (block,) = tpg.cell.objects
    up = translation(0.0, 0.0, 0.005)
    higher = replace(block, start=up @ block.start)
    tpg = replace(tpg, cell=replace(tpg.cell, objects=(higher,)))
    pick, place = tpg.handlings
    deep = pick.pose @ np.linalg.inv(block.start) @ up @ block.start
    problems = verify_plan(
        handled(1, pose=up @ place.pose)(handled(0, pose=deep)(tpg))
    ).problems
    (grip,) = (p for p in problems if p.kind == "grip")
    assert "'block' is 5.70 mm deep in left/tool while 'left' holds it" in grip.message
    assert "may be 3 mm" in grip.message


def test_only_contacts_that_handling_needs_are_allowed() -> None:
    tpg = graph(taking_turns(), (0, 0, 1, 0))
    before = {(p.first, p.second) for p in verify_plan(tpg).problems}
    everything = frozenset(task.index for task in tpg.tasks)
    pairs = [("arm", "arm"), ("arm", "tool"), ("tool", "arm"), ("tool", "tool")]
    allowed = tuple(
        AllowedContact(f"left/{a}", f"right/{b}", everything) for a, b in pairs
    )
    after = verify_plan(replace(tpg, allowed=allowed)).problems
    assert before
    assert {(p.first, p.second) for p in after} == before
