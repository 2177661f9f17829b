"""What a plan survives of base errors: held against bases that are moved in another engine."""

from dataclasses import replace
from functools import cache
from itertools import product

import coal
import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.cell.workcell import PoseError, Workcell
from planning.robots.registry import robot_model
from planning.tasks.task import AllowedContact
from planning.transforms import Array, Transform, rotation, translation
from scheduling.build_nodes import build_nodes
from scheduling.build_tpg import build_tpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.survived_errors import SurvivedErrors
from scheduling.verification.verify import verify_plan
from scheduling.witness.motion import Motion
from scheduling.witness.robot import WitnessRobot
from scheduling.witness.shapes import farthest_from
from tests.scheduling.two_arms import Writer, block, random_turns, two_arms
from twin.audits.worlds.world import AuditWorld

UNIT = PoseError(1e-3, np.radians(0.1))


def moved(base: Transform, way: Array, turn: Array) -> Transform:
    """A base whose origin is displaced and that is turned about it by a rotation vector."""
    angle = float(np.linalg.norm(turn))
    out = np.array(base)
    if angle > 0.0:
        axis = turn / angle
        cross = np.cross(np.eye(3), axis)
        turned = np.eye(3) + np.sin(angle) * cross
        turned += (1.0 - np.cos(angle)) * cross @ cross
        out[:3, :3] = turned @ base[:3, :3]
    out[:3, 3] += way
    return out


def on_ball(rng: np.random.Generator, radius: float) -> Array:
    way = rng.normal(size=3)
    return np.asarray(radius * way / np.linalg.norm(way))


def off(cell: Workcell, error: PoseError, rng: np.random.Generator) -> Workcell:
    """The cell with every base as far off as an error allows, in random directions."""
    robots = (
        replace(r, base=moved(r.base, on_ball(rng, error.m), on_ball(rng, error.rad)))
        for r in cell.robots
    )
    return replace(cell, robots=tuple(robots))


def nearest(world: AuditWorld, q: tuple[Array, Array]) -> float:
    """Least distance of two arms at configurations."""
    for robot, at in enumerate(q):
        world.configure(robot, at)
    shapes = world.robot_shapes
    pairs = product(
        [s for s in shapes if s.robot == 0], [s for s in shapes if s.robot == 1]
    )
    return min(world.distance(a, b, 0.05) for a, b in pairs)


def at_once(tpg: TemporalPlanGraph) -> list[tuple[int, int]]:
    """Ends of nodes of two robots at which both may stand at once, by paths of the graph."""
    graph: nx.DiGraph[tuple[int, int]] = nx.DiGraph()
    for k, chain in enumerate(tpg.chains):
        graph.add_nodes_from((k, n) for n in range(len(chain)))
        graph.add_edges_from(((k, n - 1), (k, n)) for n in range(1, len(chain)))
    graph.add_edges_from(((a, u), (b, v)) for a, u, b, v in tpg.edges.tolist())
    later = {node: nx.descendants(graph, node) | {node} for node in graph}
    first, second = (range(len(chain)) for chain in tpg.chains)
    return [
        (u, v)
        for u, v in product(first, second)
        # Neither has gone on before the other has come there.
        if (1, v) not in later.get((0, u + 1), ())
        and (0, u) not in later.get((1, v + 1), ())
    ]


@cache
def proved(
    seed: int, error: PoseError = UNIT
) -> tuple[TemporalPlanGraph, SurvivedErrors]:
    tpg = build_tpg(random_turns(seed, 4, gap=0.64))
    survived = verify_plan(tpg, base_error=error).survived
    assert survived is not None
    assert survived.robots.limiting is not None
    return tpg, survived


@pytest.mark.parametrize("seed", range(2))
def test_bases_that_are_off_by_what_is_survived_touch_nothing(seed: int) -> None:
    tpg, survived = proved(seed)
    error = survived.largest(survived.robots)
    pairs = at_once(tpg)
    rng = np.random.default_rng(seed)
    nominal = AuditWorld(tpg.cell)
    ends = [chain.waypoints[chain.first[1:] - 1] for chain in tpg.chains]
    some = [pairs[k] for k in rng.choice(len(pairs), 200, replace=False)]
    some.sort(key=lambda p: nearest(nominal, (ends[0][p[0]], ends[1][p[1]])))
    least = np.inf
    for _ in range(4):
        world = AuditWorld(off(tpg.cell, error, rng))
        for u, v in some[:30]:
            least = min(least, nearest(world, (ends[0][u], ends[1][v])))
    assert 0.0 < least < 0.03


@pytest.mark.parametrize("seed", range(2))
def test_of_ways_alone_the_proof_is_exact(seed: int) -> None:
    """Two bases that go towards each other take up all the distance there is, and no less."""
    tpg, survived = proved(seed, PoseError(1e-3, 0.0))
    limiting = survived.robots.limiting
    assert limiting is not None
    most = survived.robots.share * 1e-3
    assert limiting.taken_m == pytest.approx(2e-3)
    assert most == pytest.approx(0.5 * limiting.distance_m, abs=2e-5)
    # So far apart are they in the nodes that are named, and it is bases that close the gap.
    ways = []
    for chain, side in zip(tpg.chains, (limiting.first, limiting.second), strict=True):
        end = int(chain.first[side.node])
        before = chain.waypoints[end - 1] if end else chain.start
        after = before if side.standing else chain.waypoints[end]
        steps = 1 if side.standing else 12
        ways.append(before + np.linspace(0.0, 1.0, steps)[:, None] * (after - before))
    world = AuditWorld(tpg.cell)
    least = min(nearest(world, q) for q in product(*ways))
    assert least == pytest.approx(2.0 * most, abs=1e-4)


def planted(gap: float, *, meant: bool = False) -> TemporalPlanGraph:
    """Left turns a little and back; a block stands beside its tool at HOME."""
    cell = two_arms()
    model = robot_model("gp4")
    robot = WitnessRobot(cell.robots[0])
    frame = robot.joint_frame(model.home, robot.dof - 1)
    knots, frames = np.zeros((2, 0)), np.tile(frame, (2, 1, 1))
    still = [
        Motion(None, part, knots, frames)
        for part in robot.parts
        if part.joint == robot.dof - 1
    ]
    down = max(m.reach(np.zeros(1, np.int64), -np.array([0, 0, 1.0]))[0] for m in still)
    at = robot.flange_pose(model.home)[:3, 3]
    pose = translation(at[0], at[1], -down - gap - 0.005)
    cell = two_arms((block("block", (0.2, 0.2, 0.01), pose),))
    writer = Writer(cell)
    turned = cell.robots[0].home + 0.3 * np.eye(6)[0]
    for goal in (turned, cell.robots[0].home):
        writer.move("left", goal)
    if meant:
        tasks = frozenset(task.index for task in writer.tasks)
        writer.allowed.append(AllowedContact("left/tool", "block", tasks))
    return build_nodes(writer.plan())


def test_a_planted_tight_pair_is_found_and_named() -> None:
    survived = verify_plan(planted(0.0004), base_error=UNIT).survived
    assert survived is not None
    limiting = survived.rest.limiting
    assert limiting is not None
    assert {limiting.first.body, limiting.second.body} == {"left/tool", "block"}
    assert limiting.first.robot == "left"
    assert limiting.distance_m == pytest.approx(0.0004, abs=2e-5)
    # The errors take what the way takes, and the angle at the tool's distance from the base.
    assert limiting.taken_m == pytest.approx(1e-3 + UNIT.rad * 0.45, rel=0.15)
    assert survived.least is survived.rest
    assert not survived.ok
    assert limiting.margin_m < 0.0


def test_contacts_that_are_meant_take_the_error_up() -> None:
    report = verify_plan(planted(-0.0001, meant=True), base_error=UNIT)
    assert report.ok
    touching = verify_plan(planted(-0.00001), base_error=UNIT)
    assert touching.survived is not None
    assert touching.survived.rest.share == 0.0
    assert not touching.ok


def test_what_is_asked_alone_decides() -> None:
    tpg = planted(0.0004)
    small = verify_plan(tpg, base_error=PoseError(1e-4, 1e-4))
    assert small.ok
    assert small.survived is not None
    assert small.survived.ok
    assert verify_plan(tpg).survived is None


@pytest.mark.parametrize("seed", range(4))
def test_no_point_strays_further_than_its_bound(seed: int) -> None:
    """And no bound is twice what is reached: each link has its own, by where it is."""
    rng = np.random.default_rng(seed)
    placed = two_arms().robots[seed % 2]
    robot, error = WitnessRobot(placed), PoseError(2e-3, 0.02)
    knots = placed.home + np.cumsum(rng.uniform(-0.15, 0.15, (4, robot.dof)), axis=0)
    frames = robot.joint_frames_along(knots)
    bases = [
        moved(placed.base, on_ball(rng, error.m), on_ball(rng, error.rad))
        @ np.linalg.inv(placed.base)
        for _ in range(60)
    ]
    for part in robot.parts:
        motion = Motion(
            robot, part, knots, frames[:, part.joint + 1], error, placed.base[:3, 3]
        )
        pieces = np.arange(len(motion))
        low, high = motion.extents(pieces)
        bare = replace(motion, error=PoseError()).extents(pieces)
        strays = motion.strays(pieces)
        assert np.allclose(high - bare[1], strays)
        assert np.allclose(bare[0] - low, strays)
        shape = part.shape
        shape.computeLocalAABB()
        around = shape.aabb_local
        ends = zip(around.min_, around.max_, strict=True)
        corners = np.array(list(product(*ends)))
        if isinstance(shape, coal.ConvexBase):
            corners = np.asarray(shape.points())
        elif not isinstance(shape, coal.Box):
            corners = np.array([around.min_ + around.max_]) / 2
        for piece in pieces:
            frame = motion.frame(int(piece)) @ part.local
            points = corners @ frame[:3, :3].T + frame[:3, 3]
            gone = max(
                np.linalg.norm(points @ b[:3, :3].T + b[:3, 3] - points, axis=1).max()
                for b in bases
            )
            assert gone <= motion.strays_at(motion.frame(int(piece))) + 1e-12
            assert gone <= strays[piece] + 1e-12
            if isinstance(shape, (coal.ConvexBase, coal.Box)):
                assert gone >= 0.6 * strays[piece]


SHAPES = (
    coal.Box(0.1, 0.2, 0.3),
    coal.Sphere(0.1),
    coal.Capsule(0.1, 0.3),
    coal.Cylinder(0.1, 0.3),
)


@given(
    st.sampled_from(range(len(SHAPES))),
    st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    st.integers(0, 1000),
)
def test_the_farthest_point_of_a_shape_is_as_far_as_said(
    which: int, place: tuple[float, ...], seed: int
) -> None:
    """Against support points along directions, of which the one away from the place is best."""
    shape, rng = SHAPES[which], np.random.default_rng(seed)
    here = np.array(place)
    found = float(farthest_from(shape, here[None])[0])
    ways = rng.normal(size=(400, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    if isinstance(shape, coal.Box):
        points = np.sign(ways) * shape.halfSide
    elif isinstance(shape, coal.Sphere):
        points = ways * shape.radius
    else:
        up = np.sign(ways[:, 2:]) * [[0.0, 0.0, shape.halfLength]]
        flat = ways * [1.0, 1.0, 0.0]
        flat /= np.linalg.norm(flat, axis=1)[:, None]
        round_end = isinstance(shape, coal.Capsule)
        points = up + shape.radius * (ways if round_end else flat)
    best = float(np.linalg.norm(points - here, axis=1).max())
    assert best <= found + 1e-9
    assert found <= best + 0.02


def test_a_turned_base_is_turned_about_its_origin() -> None:
    base = translation(1.0, 2.0, 3.0) @ rotation("z", 0.4)
    turn = np.array([0.0, 0.0, 0.3])
    expected = translation(1.0, 2.0, 3.0) @ rotation("z", 0.7)
    assert np.allclose(moved(base, np.zeros(3), turn), expected)
