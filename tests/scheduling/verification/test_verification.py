"""The verification passes plans that keep their guarantee and names what breaks it."""

from dataclasses import replace
from typing import Any

import networkx as nx
import numpy as np
import pytest

from planning.kinematics.kinematics import frame_pose, inverse_kinematics
from planning.tasks.task import AllowedContact, Handling
from planning.transforms import Array, inverse, rotation, translation
from scheduling.build_nodes import build_nodes
from scheduling.build_tpg import build_tpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.graph_structure import find_precedence
from scheduling.verification.problems import Problem
from scheduling.verification.verify import verify_plan
from scheduling.witness.parts import measure
from scheduling.witness.robot import WitnessRobot
from tests.scheduling.two_arms import Writer, block, random_turns, two_arms
from twin.audits.audit import Auditor
from twin.verification.standing_states import (
    audit_standing_states,
    run_until_still,
    standing_recording,
    standing_states,
)

MIDDLE = (0.44, 0.0, 0.32)
ONE_NODE = 100.0


def at(writer: Writer, robot: str, x: float, y: float, z: float) -> Array:
    """A configuration with the tool pointing down at a point of the world."""
    placed = writer.cell.robot(robot)
    target = translation(x, y, z) @ rotation("y", np.pi)
    return inverse_kinematics(placed, "tool", target, placed.home)[0]


def go(writer: Writer, *moves: tuple[Any, ...]) -> Writer:
    """Append moves of one node each: robot, where to (None is HOME), and what changes hands."""
    for robot, place, *handlings in moves:
        goal = place
        if place is None:
            goal = writer.cell.robot(robot).home
        elif isinstance(place, tuple):
            goal = at(writer, robot, *place)
        writer.move(robot, goal, *handlings, step=ONE_NODE)
    return writer


def graph(writer: Writer, *edges: tuple[int, int, int, int]) -> TemporalPlanGraph:
    """The plan as a graph with exactly these type-2 edges."""
    return replace(
        build_nodes(writer.plan()),
        edges=np.array(sorted(edges), dtype=np.int64).reshape(-1, 4),
        cause=np.zeros(len(edges), dtype=np.uint8),
    )


def named(problem: Problem) -> tuple[str, set[tuple[str | None, int]], set[bool]]:
    assert problem.first is not None
    assert problem.second is not None
    sides = problem.first, problem.second
    return (
        problem.kind,
        {(s.robot, s.node) for s in sides},
        {s.standing for s in sides},
    )


def taking_turns() -> Writer:
    """Left goes to the middle and home, one node each; then right does."""
    there_and_back = [(r, to) for r in ("left", "right") for to in (MIDDLE, None)]
    return go(Writer(two_arms()), *there_and_back)


@pytest.mark.parametrize("seed", range(3))
def test_built_graphs_pass_and_their_standing_states_are_clean(seed: int) -> None:
    tpg = build_tpg(random_turns(seed, 4, gap=0.62))
    assert len(tpg.edges) > 3
    report = verify_plan(tpg)
    assert report.problems == ()
    assert report.ok
    assert report.pairs_checked > 1000
    assert 0.001 <= report.min_distance_robots_m < 0.05
    adversary = audit_standing_states(tpg)
    assert adversary.states == 2 * len({(a, u) for a, u, _, _ in tpg.edges.tolist()})
    assert adversary.violations == ()
    assert adversary.min_distance_m > 0.0


def test_an_edge_one_node_too_early_is_found() -> None:
    """The edge of the point model: right may start while left is still on its way out."""
    writer = taking_turns()
    assert verify_plan(graph(writer, (0, 1, 1, 0))).ok
    report = verify_plan(graph(writer, (0, 0, 1, 0)))
    pairs = {frozenset(named(p)[1]) for p in report.problems}
    assert pairs == {
        frozenset({("left", 1), ("right", 0)}),
        frozenset({("left", 1), ("right", 1)}),
    }
    worst = report.problems[0]
    assert worst.kind == "nodes"
    assert worst.first is not None
    assert worst.second is not None
    assert (worst.first.task, worst.second.task) == (1, 2)
    assert worst.distance_m < 0.001
    assert "node 1 (task 1)" in worst.message
    assert "node 0 (task 2)" in worst.message


def test_every_edge_of_a_reduced_graph_is_needed() -> None:
    """One edge less is a problem of nodes next to the edge's own."""
    tpg = build_tpg(random_turns(1, 4, gap=0.6))
    assert len(tpg.edges) >= 2
    for e in (0, len(tpg.edges) // 2):
        less = replace(tpg, edges=np.delete(tpg.edges, e, axis=0))
        a, u, b, v = tpg.edges[e].tolist()
        sides = {tpg.chains[a].robot: u, tpg.chains[b].robot: v}
        report = verify_plan(less, limit=2000)
        assert 0 < len(report.problems) < 2000
        assert any(
            all(
                abs(side.node - sides[str(side.robot)]) <= 1
                for side in (p.first, p.second)
                if side
            )
            for p in report.problems
        )


def test_a_robot_that_stands_in_the_way_between_two_ordered_nodes_is_found() -> None:
    """Left goes to the middle, right comes, left goes home: each pair of nodes is ordered."""
    moves = ("left", MIDDLE), ("right", MIDDLE), ("left", None)
    tpg = graph(go(Writer(two_arms()), *moves), (0, 0, 1, 0), (1, 0, 0, 1))
    report = verify_plan(tpg)
    found = [named(p) for p in report.problems]
    # Right moves while left stands before its node 1; and left leaves while right stands.
    assert ("hold", {("left", 1), ("right", 0)}, {True, False}) in found
    assert all(kind == "hold" for kind, _, _ in found)
    # The adversary meets the same: right stops at the end of its node.
    adversary = audit_standing_states(tpg)
    assert {(s.robot, s.node, s.at_end) for s, _ in adversary.violations} == {
        ("right", 0, True)
    }


@pytest.mark.parametrize(
    ("right_first", "edges", "stopped"),
    [
        (True, [(1, 0, 0, 0), (0, 1, 1, 1)], ("left", 1, True)),
        (False, [(0, 2, 1, 0), (1, 0, 0, 3)], ("right", 0, True)),
    ],
)
def test_standing_states_are_audited_as_each_alone(
    right_first: bool, edges: list[tuple[int, int, int, int]], stopped: object
) -> None:
    """Left puts a block where right stands, or right comes to where it lies and stops."""
    writer = carrying(right_first=right_first)
    tpg = graph(go(writer, ("left", writer.cell.robot("left").home + 0.1)), *edges)
    expected, least = [], []
    for state in standing_states(tpg):
        counts = list(state.completed)
        counts[tpg.chain_index[state.robot]] += state.at_end
        with Auditor(tpg) as auditor:
            alone = standing_recording(tpg, tuple(counts))
            report = auditor.audit(alone, ordered=False)
        expected += [(state, violation) for violation in report.violations]
        least.append(report.min_distance_m)
    found = audit_standing_states(tpg)
    assert found.violations == tuple(expected)
    assert {(s.robot, s.node, s.at_end) for s, _ in expected} == {stopped}
    assert found.min_distance_m == pytest.approx(min(least), abs=5e-5)


def test_a_robot_without_nodes_stands_in_the_way() -> None:
    cell = two_arms(gap=0.60)
    right = cell.robot("right")
    tool = tuple(frame_pose(right, right.home, "tool")[:3, 3])
    report = verify_plan(graph(go(Writer(cell), ("left", tool))))
    (found,) = (named(p) for p in report.problems)
    assert found == ("hold", {("left", 0), ("right", 0)}, {True, False})


def carrying(*, right_first: bool) -> Writer:
    """Left carries a block aside and leaves; right passes where it is put, before or after."""
    x, y, z = 0.40, 0.10, 0.25
    # The grip plane of the tool is 2.5 mm above the block's top face, the lever 0.7 mm in it.
    stock = block("block", (0.05, 0.05, 0.04), translation(x, y - 0.2, z - 0.0225))
    writer = Writer(two_arms((stock,)))
    left = writer.cell.robot("left")
    pick, place = at(writer, "left", x, y - 0.2, z), at(writer, "left", x, y, z)
    local = inverse(frame_pose(left, pick)) @ stock.start
    placed = frame_pose(left, place) @ local
    # The tool 30 mm above the table's side of the block: only the block is in the way.
    passing = ("right", (x, y, z - 0.02)), ("right", None)
    work = (
        ("left", pick, Handling("block", -1, "left", local)),
        ("left", place, Handling("block", -1, None, placed)),
        ("left", None),
    )
    go(writer, *((*passing, *work) if right_first else (*work, *passing)))
    for task in writer.tasks:
        tool = AllowedContact("left/tool", "block", frozenset([task.index]))
        if task.robot == "left":
            writer.allowed.append(tool)
    return writer


def test_an_object_at_rest_is_in_the_way_after_its_place() -> None:
    before = carrying(right_first=True)
    assert verify_plan(graph(before, (1, 1, 0, 0))).ok
    after = carrying(right_first=False)
    tpg = graph(after, (0, 2, 1, 0))
    report = verify_plan(tpg)
    assert {named(p)[0] for p in report.problems} == {"rest"}
    assert {p.first.node for p in report.problems if p.first} == {0, 1}
    assert {p.second.body for p in report.problems if p.second} == {"block"}
    assert {p.first.robot for p in report.problems if p.first} == {"right"}
    # It would be 20 mm deep in the block, whatever the plan says of contacts.
    tasks = frozenset(t.index for t in tpg.tasks if t.robot == "right")
    for part in ("tool", "arm"):
        allowed = AllowedContact(f"right/{part}", "block", tasks)
        tpg = replace(tpg, allowed=(*tpg.allowed, allowed))
    assert {named(p)[0] for p in verify_plan(tpg).problems} == {"rest"}


@pytest.mark.parametrize(
    ("depth", "grazing", "fine"),
    [
        (0.00015, True, True),
        (0.0006, True, False),
        (0.0006, False, True),
        (0.0025, False, True),
        (0.0035, False, False),
        (0.00015, None, False),
    ],
)
def test_a_tool_is_held_to_the_depth_to_which_it_may_touch(
    depth: float, grazing: bool | None, fine: bool
) -> None:
    """The lever, 3.2 mm beyond the grip plane, goes a little into the top of a block."""
    x, y, z = 0.40, 0.0, 0.25
    writer = Writer(two_arms((block("block", (0.1, 0.1, 0.04), translation(x, y, z)),)))
    touching = z + 0.02 + 0.0032
    above, down = (x, y, touching + 0.01), (x, y, touching - depth)
    go(writer, *(("left", to) for to in (above, down, above, None)))
    tasks = frozenset(task.index for task in writer.tasks)
    if grazing is not None:
        contact = AllowedContact("left/tool", "block", tasks, grazing)
        writer.allowed.append(contact)
    report = verify_plan(graph(writer))
    assert report.ok == fine, report.problems


def test_an_object_that_comes_up_later_is_in_the_way_from_then_on() -> None:
    """Right passes the place of a station; left lets the next block come up there."""
    pose = translation(0.40, 0.10, 0.23)
    later = replace(block("block", (0.05, 0.05, 0.04), pose), later=True)

    def writer(*, right_first: bool) -> Writer:
        out = Writer(two_arms((later,)))
        passing = ("right", (0.40, 0.10, 0.23)), ("right", None)
        aside = out.cell.robot("left").home + 0.2
        comes = ("left", aside, Handling("block", -1, None, pose))
        return go(out, *((*passing, comes) if right_first else (comes, *passing)))

    assert verify_plan(graph(writer(right_first=True), (1, 1, 0, 0))).ok
    for tpg in (
        graph(writer(right_first=True)),
        graph(writer(right_first=False), (0, 0, 1, 0)),
    ):
        report = verify_plan(tpg)
        assert {named(p)[0] for p in report.problems} == {"rest"}
        assert {p.first.robot for p in report.problems if p.first} == {"right"}


def test_nodes_must_be_ordered_with_place_and_pick_of_what_rests_there() -> None:
    unordered = verify_plan(graph(carrying(right_first=True), (1, 1, 0, 1)))
    assert unordered.ok  # left may already pick while right passes by: far enough apart
    # Right may be late: the block may lie there already, and left may be there with it.
    unordered = verify_plan(graph(carrying(right_first=True)))
    kinds = {named(p)[0] for p in unordered.problems}
    assert kinds == {"nodes", "rest"}
    rests = [p for p in unordered.problems if p.kind == "rest"]
    assert {p.first.robot for p in rests if p.first} == {"right"}
    assert all("block at rest" in p.message for p in rests)


@pytest.mark.parametrize(
    ("edges", "needs", "kinds"),
    [
        ([(0, 1, 1, 0), (1, 1, 0, 0)], [], {"cycle"}),
        ([(1, 1, 0, 0)], [], {"order"}),  # against the planned order
        ([(0, 1, 1, 0)], [[1, 2]], set()),
        ([(0, 1, 1, 1)], [[1, 2]], {"dependency", "nodes"}),
    ],
)
def test_edges_that_are_no_order_or_not_what_tasks_ask_for_are_found(
    edges: list[tuple[int, int, int, int]], needs: list[list[int]], kinds: set[str]
) -> None:
    tpg = graph(taking_turns(), *edges)
    needed = np.array(needs, dtype=np.int64).reshape(-1, 2)
    problems = verify_plan(replace(tpg, dependencies=needed)).problems
    assert {p.kind for p in problems} == kinds
    for p in problems:
        if p.kind == "order":
            assert named(p)[1] == {("right", 1), ("left", 0)}


def test_an_object_passed_on_without_an_edge_is_found() -> None:
    writer = carrying(right_first=False)
    right = writer.cell.robot("right")
    grip = at(writer, "right", 0.40, 0.10, 0.25)
    rest = writer.tasks[1].handlings[0].pose
    local = inverse(frame_pose(right, grip)) @ rest
    go(writer, ("right", grip, Handling("block", -1, "right", local)))
    for edges, found in (((), True), (((0, 2, 1, 0),), False)):
        problems = verify_plan(graph(writer, *edges), limit=3).problems
        assert ("handling" in {p.kind for p in problems}) is found


def passing_on() -> Writer:
    """Left brings a beam to right, which stands ready, and goes; then right goes with it."""
    at_stock = translation(0.44, -0.2, 0.2375)
    beam = block("beam", (0.34, 0.03, 0.02), at_stock)
    writer = Writer(two_arms((beam,)))
    left, right = writer.cell.robots
    ready = at(writer, "right", 0.59, 0.0, 0.25)
    pick, give = (at(writer, "left", 0.29, y, 0.25) for y in (-0.2, 0.0))
    held = inverse(frame_pose(left, pick)) @ at_stock
    received = inverse(frame_pose(right, ready)) @ frame_pose(left, give) @ held
    go(
        writer,
        ("right", ready),
        ("left", pick, Handling("beam", -1, "left", held)),
        ("left", give, Handling("beam", -1, "right", received)),
        ("left", None),
        ("right", None),
    )
    everything = frozenset(task.index for task in writer.tasks)
    for robot in ("left", "right"):
        writer.allowed.append(AllowedContact(f"{robot}/tool", "beam", everything))
    return writer


def test_an_object_is_passed_from_hand_to_hand() -> None:
    ready, gone = (1, 0, 0, 1), (0, 2, 1, 1)
    assert verify_plan(graph(passing_on(), ready, gone)).ok
    for edge, sides in (
        (gone, {("right", 0), ("left", 1)}),
        (ready, {("left", 1), ("right", 1)}),
    ):
        first = verify_plan(graph(passing_on(), edge), limit=2).problems[0]
        assert named(first)[:2] == ("handling", sides)
        assert "need not stand" in first.message


def test_what_a_standing_robot_was_handed_is_in_the_way() -> None:
    """The giver may touch the beam with its tool only until it has let go."""
    writer = passing_on()
    writer.allowed[0] = AllowedContact("left/tool", "beam", frozenset([0, 1, 2, 4]))
    report = verify_plan(graph(writer, (1, 0, 0, 1), (0, 2, 1, 1)))
    (problem,) = report.problems
    assert problem.kind == "rest"
    assert problem.first is not None
    assert (problem.first.robot, problem.first.node) == ("left", 2)


@pytest.mark.parametrize("seed", range(5))
def test_precedence_is_that_of_networkx(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lengths = rng.integers(3, 30, 3)
    writer = taking_turns()
    template = graph(writer).chains[0]
    chains = tuple(replace(template, task=np.zeros(n, dtype=int)) for n in lengths)
    rank = [np.sort(rng.random(n)) for n in lengths]
    edges = []
    for _ in range(25):
        a, b = rng.choice(3, 2, replace=False)
        u, v = int(rng.integers(lengths[a])), int(rng.integers(lengths[b]))
        if rank[a][u] < rank[b][v]:
            edges.append((int(a), u, int(b), v))
    tpg = replace(graph(writer), chains=chains, edges=np.array(edges).reshape(-1, 4))
    precedence = find_precedence(tpg)
    assert precedence is not None
    reference: nx.DiGraph[tuple[int, int]] = nx.DiGraph()
    for a, n in enumerate(lengths):
        reference.add_nodes_from((a, k) for k in range(n))
        nx.add_path(reference, [(a, k) for k in range(n)])
    reference.add_edges_from(((a, u), (b, v)) for a, u, b, v in edges)
    for a, n in enumerate(lengths):
        for u in range(n):
            below = nx.descendants(reference, (a, u))
            for b, m in enumerate(lengths):
                for v in range(m):
                    expected = (b, v) in below
                    assert precedence.precedes(a, u, b, v) == expected


def test_a_part_never_moves_further_than_its_weights_say() -> None:
    robot = WitnessRobot(two_arms().robot("left"))
    rng = np.random.default_rng(5)
    corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    for _ in range(60):
        q, step = rng.uniform(-1.5, 1.5, 6), rng.uniform(-0.3, 0.3, 6)
        for part in robot.parts:
            points = part.centre + part.radius * corners / np.sqrt(3)
            frames = [robot.joint_frame(end, part.joint) for end in (q, q + step)]
            ends = [points @ frame[:3, :3].T + frame[:3, 3] for frame in frames]
            moved = np.linalg.norm(ends[1] - ends[0], axis=1).max()
            assert moved <= np.abs(step) @ part.weight + 1e-12
    base = robot.joint_frame(q, -1)
    far = measure(robot.parts[0], base, robot.parts[0], translation(0.0, 5.0, 0.0))
    assert far == pytest.approx(5.0 - 0.175, abs=0.02)


def test_others_run_on_until_they_wait_for_the_robot_that_stopped() -> None:
    tpg = graph(taking_turns(), (0, 1, 1, 0))
    assert run_until_still(tpg, 0, 1) == (1, 0)
    assert run_until_still(tpg, 1, 1) == (2, 1)
    assert run_until_still(tpg, 0, 0) == (0, 0)
    states = list(standing_states(tpg))
    assert [(s.robot, s.node, s.at_end, s.completed) for s in states] == [
        ("left", 1, False, (1, 0)),
        ("left", 1, True, (1, 0)),
    ]


@pytest.mark.parametrize("seed", range(3))
def test_standing_states_are_those_of_a_dispatcher(seed: int) -> None:
    tpg = build_tpg(random_turns(seed, 4, gap=0.62))
    index = tpg.chain_index
    states = list(standing_states(tpg))
    assert len(states) > 6
    for state in states:
        assert state.completed == run_until_still(tpg, index[state.robot], state.node)
