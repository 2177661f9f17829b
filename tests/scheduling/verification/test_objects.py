"""The verification holds objects to where they are, and what is done to what tasks say; touches are told from collisions."""

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from planning.cell.workcell import Attachment, WorldState
from planning.errors import PlanInvariantError
from planning.geometry.scene_checker import SceneChecker
from planning.joint_motion.moving_pairs import MovingPair
from planning.kinematics.kinematics import frame_pose
from planning.tasks.task import AllowedContact, Handling
from planning.transforms import Array, Transform, inverse, translation
from scheduling.build_tpg import build_tpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.verify import verify_plan
from scheduling.witness.parts import ConvexPart, measure
from scheduling.witness.robot import SeenFrom, WitnessRobot
from tests.scheduling.two_arms import Writer, block, two_arms
from tests.scheduling.verification.test_verification import (
    at,
    carrying,
    go,
    graph,
    named,
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
    for holder in ("right", Handling.GONE):
        problems = verify_plan(handled(0, holder=holder)(tpg)).problems
        first, *others = (p.message for p in problems if p.kind == "jump")
        assert "changes hands, and 'left' neither has it nor gets it" in first
        assert any("after it has left the cell" in p for p in others) is (
            holder == Handling.GONE
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


def beside_a_beam(gap: float, *, leaves: bool) -> Writer:
    """Left holds a beam; right comes down on its end, but for a gap, and maybe goes home."""
    at_stock = translation(0.44, -0.2, 0.2375)
    writer = Writer(two_arms((block("beam", (0.34, 0.03, 0.02), at_stock),)))
    left, right = writer.cell.robots
    pick, hold = (at(writer, "left", 0.29, y, 0.25) for y in (-0.2, 0.0))
    local = inverse(frame_pose(left, pick)) @ at_stock
    go(writer, ("left", pick, Handling("beam", -1, "left", local)), ("left", hold))
    goal, height = right.home, 0.30
    for _ in range(4):
        goal = at(writer, "right", 0.59, 0.0, height)
        height += gap - distance(writer, hold, local, goal)
    assert distance(writer, hold, local, goal) == pytest.approx(gap, abs=1e-5)
    go(writer, ("right", goal), *([("right", None)] if leaves else []))
    everything = frozenset(task.index for task in writer.tasks)
    writer.allowed.append(AllowedContact("left/tool", "beam", everything))
    return writer


def distance(writer: Writer, hold: Array, local: Array, goal: Array) -> float:
    """How far the beam is from the right robot."""
    left, right = (WitnessRobot(robot) for robot in writer.cell.robots)
    (beam,) = left.loads("beam", writer.cell.object("beam").shape, local)
    hand = left.joint_frame(hold, beam.joint)
    return min(
        measure(beam, hand, part, right.joint_frame(goal, part.joint))
        for part in right.parts
    )


@pytest.mark.parametrize("gap", [0.0003, 0.0007])
def test_a_robot_too_near_to_a_part_that_another_holds_is_found(gap: float) -> None:
    writer = beside_a_beam(gap, leaves=True)
    report = verify_plan(graph(writer, (0, 1, 1, 0)))
    assert {named(p)[0] for p in report.problems} == {"hold"}
    assert all("beam" in p.message for p in report.problems)
    with pytest.raises(PlanInvariantError, match="stands after node 1 of robot 'left'"):
        build_tpg(writer.plan())


def test_a_robot_that_keeps_the_clearance_from_it_may_pass() -> None:
    writer = beside_a_beam(0.0013, leaves=True)
    tpg = build_tpg(writer.plan())
    assert verify_plan(tpg).ok
    # And without the edges left swings the beam through where right may be already.
    assert "nodes" in {named(p)[0] for p in verify_plan(graph(writer)).problems}


@pytest.mark.parametrize(("gap", "free"), [(0.0007, False), (0.0013, True)])
def test_motions_past_a_part_in_another_hand_keep_it_too(
    gap: float, free: bool
) -> None:
    writer = beside_a_beam(gap, leaves=False)
    held = writer.tasks[0].handlings[0]
    state = WorldState(writer.q, {"beam": Attachment("left", held.pose)})
    grips = frozenset({frozenset(("left/tool", "beam"))})
    for robot in ("left", "right"):
        checker = SceneChecker(writer.cell, robot, state, grips)
        assert checker.configuration_free(writer.q[robot]) is free
    pair = MovingPair(writer.cell, "left", "right", state, grips)
    assert pair.clear(writer.q["left"], writer.q["right"]) is free


def test_a_part_at_rest_is_not_touched_but_may_be_as_near_as_one_likes() -> None:
    writer = beside_a_beam(0.0003, leaves=False)
    left = writer.cell.robot("left")
    held = writer.tasks[0].handlings[0]
    lies = frame_pose(left, writer.q["left"]) @ held.pose
    state = WorldState(
        {"left": left.home, "right": writer.q["right"]},
        {"beam": Attachment(None, lies)},
    )
    checker = SceneChecker(writer.cell, "right", state)
    assert checker.configuration_free(np.array(writer.q["right"]))


def wild_moves(seed: int) -> Writer:
    """Left goes through its joint space, far from everything."""
    writer = Writer(two_arms(gap=20.0))
    rng = np.random.default_rng(seed)
    model = writer.cell.robot("left").model
    for share in rng.uniform(0.02, 0.98, (6, model.dof)):
        goal = model.lower + share * (model.upper - model.lower)
        go(writer, ("left", goal))
    return writer


def least_gap(robot: WitnessRobot, home: Array, q: Array) -> float:
    """Least distance of parts that do not touch by design."""
    frames = [robot.joint_frames_along(at[None])[0] for at in (home, q)]

    def gap(a: ConvexPart, b: ConvexPart, k: int) -> float:
        return measure(a, frames[k][a.joint + 1], b, frames[k][b.joint + 1])

    pairs = [
        (a, b)
        for a, b in combinations(robot.parts, 2)
        if abs(a.joint - b.joint) > 1 and gap(a, b, 0) > 0.0
    ]
    return min(gap(a, b, 1) for a, b in pairs)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_robot_that_touches_itself_is_found(seed: int) -> None:
    writer = wild_moves(seed)
    tpg = graph(writer)
    problems = verify_plan(tpg).problems
    found = {p.first.node for p in problems if p.kind == "itself" and p.first}
    placed = writer.cell.robot("left")
    robot = WitnessRobot(placed)
    before = placed.home
    touching = set()
    for node, goal in enumerate(tpg.chains[0].waypoints):
        least = min(
            least_gap(robot, placed.home, before + share * (goal - before))
            for share in np.linspace(0.0, 1.0, 12)
        )
        if least < -2e-4:
            touching.add(node)
        before = goal
    assert touching
    assert touching <= found
    assert all(p.distance_m < 0.0 for p in problems if p.kind == "itself")


def test_an_arm_that_touches_what_it_carries_is_found() -> None:
    """A pole in the hand reaches up along the forearm, and then into the upper arm."""
    start = translation(0.30, -0.2, 0.3975)
    pole = block("pole", (0.02, 0.02, 0.30), start)
    writer = Writer(two_arms((pole,), gap=20.0))
    left = writer.cell.robot("left")
    pick = at(writer, "left", 0.30, -0.2, 0.25)
    held = inverse(frame_pose(left, pick)) @ start
    folded = pick.copy()
    folded[4] += 0.8
    go(writer, ("left", pick, Handling("pole", -1, "left", held)), ("left", folded))
    kinds = {
        (p.kind, p.second.body if p.second else None)
        for p in verify_plan(graph(writer)).problems
    }
    assert ("itself", "pole") in kinds


def test_what_a_joint_sees_is_what_moves_after_it() -> None:
    placed = two_arms().robots[0]
    robot = WitnessRobot(placed)
    path = placed.home + np.linspace(0.0, 0.5, 4)[:, None]
    frames = robot.joint_frames_along(path)
    for joint in range(-1, robot.dof):
        view = SeenFrom(robot, joint)
        seen = view.joint_frames_along(path)
        assert np.allclose(frames[:, joint + 1, None] @ seen, frames)
        assert np.allclose(seen[:, joint + 1], np.eye(4))
        assert np.allclose(view.joint_frame(path[2], 4), seen[2, 5])
        for part in robot.parts:
            moved = view.seen(part).weight
            assert np.all(moved[: joint + 1] == 0.0)
            assert np.array_equal(moved[joint + 1 :], part.weight[joint + 1 :])
