"""Plans for bases and skills that are not where they are planned: planned with, proved, named."""

from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from planning.cell.workcell import PoseError, Workcell, WorldState
from planning.errors import PlanInvariantError
from planning.geometry.exact import place_at_middle
from planning.geometry.scene_checker import SceneChecker
from planning.joint_motion.moving_pairs import MovingPair
from planning.motion.motion_plan import MotionPlan
from planning.tasks.task import AllowedContact
from planning.transforms import Array, translation
from scheduling.build_nodes import build_nodes
from scheduling.build_tpg import build_tpg
from scheduling.conflicts.derived_tpg import DerivedTpg, occupant_of_nodes
from scheduling.conflicts.occupancy import rest_occupancy
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.invariant import check_invariant
from scheduling.verification.verify import verify_plan
from scheduling.witness.motion import Motion
from scheduling.witness.parts import ConvexPart, measure, resting_parts
from scheduling.witness.robot import WitnessRobot
from tests.scheduling import two_arms as world
from tests.scheduling.two_arms import Writer, block
from tests.scheduling.verification.test_verification import at, go, graph, passing_on

ERROR = PoseError(2e-3, 0.003)


def off(cell: Workcell, error: PoseError = ERROR) -> Workcell:
    return replace(
        cell, robots=tuple(replace(r, base_error=error) for r in cell.robots)
    )


class Oracle:
    """Least distance of two arms, less what errors take: shape by shape, with coal and pinocchio."""

    def __init__(self, cell: Workcell) -> None:
        self.cell = cell
        self.robots = {r.name: WitnessRobot(r) for r in cell.robots}

    def parts(self, name: str, q: Array) -> list[tuple[ConvexPart, Array, float]]:
        robot, placed = self.robots[name], self.cell.robot(name)
        frames = robot.joint_frames_along(q[None])[0]
        out = []
        for part in robot.parts:
            frame = frames[part.joint + 1]
            motion = Motion(
                robot,
                part,
                np.stack([q, q]),
                np.stack([frame, frame]),
                placed.base_error,
                placed.base[:3, 3],
            )
            out.append((part, frame, motion.strays_at(frame)))
        return out

    def gap(self, q: Array, other: Array) -> float:
        """Between the arms."""
        return min(
            measure(a, frame_a, b, frame_b) - strays_a - strays_b
            for (a, frame_a, strays_a), (b, frame_b, strays_b) in product(
                self.parts("left", q), self.parts("right", other)
            )
        )

    def gap_at_rest(self, q: Array) -> float:
        """Between the left arm, its base not counted for fixtures, and what rests."""
        things = [(f.name, f.shape, f.pose, True) for f in self.cell.fixtures]
        things += [(o.name, o.shape, o.start, False) for o in self.cell.objects]
        return min(
            measure(a, frame, b, np.eye(4)) - strays
            for name, shape, pose, bolted in things
            for b in resting_parts(name, shape, pose)
            for a, frame, strays in self.parts("left", q)
            if a.joint >= 0 or not bolted
        )


def cell_and_checker() -> tuple[Workcell, SceneChecker]:
    pose = translation(0.42, 0.05, 0.27)
    cell = off(world.two_arms((block("block", (0.05, 0.05, 0.05), pose),), gap=0.7))
    return cell, SceneChecker(cell, "left", cell.start_state())


@pytest.mark.parametrize("seed", range(2))
def test_a_configuration_is_free_where_shape_by_shape_enough_is_left(seed: int) -> None:
    cell, checker = cell_and_checker()
    oracle, rng = Oracle(cell), np.random.default_rng(seed)
    other = cell.robot("right").home
    near = {True: 0, False: 0}
    for _ in range(60):
        spread = rng.uniform(-1, 1, 6) * [0.5, 0.9, 0.7, 0.5, 0.5, 1]
        q = cell.robot("left").home + spread + [0, 0.3, 0, 0, 0, 0]
        spare = min(oracle.gap(q, other) - 0.001, oracle.gap_at_rest(q))
        free = checker.configuration_free(q)
        contact = checker.contact(q)
        assert free == (contact is None)
        if contact and contact.second.startswith("left"):
            continue  # it touches itself
        # Robots are polyhedra in planning, round in the oracle: 0.6 mm of an arm.
        if spare > 1e-3:
            assert free, spare
        if spare < -1e-4:
            assert not free, spare
        near[free] += abs(spare) < 0.03
    assert min(near.values()) >= 2


def test_errors_make_a_motion_of_two_robots_wider() -> None:
    """The two may pass each other with the clearance, and not where errors take more."""
    plain = world.two_arms(gap=0.7)
    home = plain.robots[0].home
    oracle = Oracle(off(plain))
    bare = Oracle(plain)
    found = 0
    for reach in np.linspace(0.0, 0.6, 31):
        q = home + np.array([0, 1, 0.4, 0, 0, 0]) * reach
        if bare.gap(q, q) < 0.003:
            break
        state = plain.start_state()
        for cell, gap in ((plain, bare.gap(q, q)), (off(plain), oracle.gap(q, q))):
            pair = MovingPair(cell, "left", "right", state)
            spare = gap - 0.001
            if abs(spare) > 1e-3:
                assert pair.clear(q, q) == (spare > 0.0)
        found += oracle.gap(q, q) < 0.0
    assert found


@pytest.mark.parametrize("seed", range(2))
def test_a_plan_made_with_errors_survives_them(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the proof says, with other code, of what was planned; and little more room is kept."""
    usual = world.two_arms
    monkeypatch.setattr(world, "two_arms", lambda *a, **k: off(usual(*a, **k)))
    tpg = build_tpg(world.random_turns(seed, 4, gap=0.64))
    check_invariant(DerivedTpg(tpg))
    report = verify_plan(tpg, base_error=ERROR)
    assert report.ok
    survived = report.survived
    assert survived is not None
    limiting = survived.robots.limiting
    assert limiting is not None
    # The clearance of 1 mm and what planning tolerates; no more than 2 mm of room is given away.
    assert limiting.margin_m < 0.004


def test_conflicts_of_bases_that_are_off_are_found() -> None:
    """Built without errors, the plan is not safe with them; built with them, it has more edges."""
    plain = world.random_turns(0, 4, gap=0.64)
    wide = replace(plain, cell=off(plain.cell, PoseError(0.004, 0.006)))
    tight = build_tpg(plain)
    assert not verify_plan(replace(tight, cell=wide.cell)).ok
    # As turns are taken one after the other some conflicts cannot be mended: stands.
    assert len(tight.edges) >= 1


def test_what_a_robot_holds_out_errs_with_it() -> None:
    """A beam that right has been handed keeps away from left by the errors of both."""
    writer = passing_on()
    ways, fine = (5e-4, 0.02, 0.1), []
    for way in ways:
        error = PoseError(way, 0.0)
        writer.cell = off(writer.cell, error)
        tpg = graph(writer, (1, 0, 0, 1), (0, 2, 1, 1))
        derived = DerivedTpg(tpg)
        (handed,) = (
            r for r in derived.history.rests if r.holder is not None and r.after
        )
        beam = rest_occupancy(
            tpg.cell, handed, derived.entities, tpg.cell.robot("right")
        )
        (solid,) = beam.solids
        pose = place_at_middle(solid, np.zeros(0), np.zeros(0))[0]
        assert np.allclose(pose.getTranslation(), handed.pose[:3, 3])
        assert solid.deviation_bound_with_base(pose) == pytest.approx(way)
        lies = rest_occupancy(tpg.cell, replace(handed, holder=None), derived.entities)
        assert lies.solids[0].deviation_bound_with_base(pose) == 0.0
        try:
            check_invariant(derived)
            sound = True
        except PlanInvariantError:
            sound = False
        assert sound == verify_plan(tpg).ok
        fine.append(sound)
    assert fine[0]
    assert not fine[-1]


def test_a_grip_is_planned_as_without_errors() -> None:
    """A contact that is meant takes the error up: the tool may be 0.1 mm in the block."""
    size, pose = (0.05, 0.05, 0.04), translation(0.45, 0.1, 0.23)
    cell = off(world.two_arms((block("block", size, pose),)))
    writer = Writer(cell)
    down = at(writer, "left", 0.45, 0.1, 0.2531)  # its lever is 3.2 mm longer
    go(writer, ("left", (0.45, 0.1, 0.3)), ("left", down), ("left", None))
    tasks = frozenset(task.index for task in writer.tasks)
    assert not verify_plan(graph(writer)).ok
    writer.allowed.append(AllowedContact("left/tool", "block", tasks))
    assert verify_plan(graph(writer)).ok
    near = WorldState({r.name: r.home for r in cell.robots}, {})
    state = replace(near, attachments=cell.start_state().attachments)
    checker = SceneChecker(cell, "left", state)
    assert checker.tool_comes_within(np.stack([down, down]), "block", 0.0)
    assert not checker.tool_comes_within(np.stack([down, down]), "block", -0.0005)
    assert not checker.configuration_free(down)


def test_errors_come_back_with_a_plan(tmp_path: Path) -> None:
    plain = build_tpg(world.random_turns(1, 2))
    wide = replace(plain, cell=off(plain.cell))
    assert plan_sha256(wide) != plan_sha256(plain)
    save_plan(wide, tmp_path)
    again = load_plan(tmp_path)
    assert [r.base_error for r in again.cell.robots] == [ERROR, ERROR]
    assert plan_sha256(again) == plan_sha256(wide)


OFF = PoseError(0.001, 0.002)


def with_skills(plan: MotionPlan, every: int = 1) -> MotionPlan:
    """The same with motions that are skills, of one node each."""
    tasks = tuple(
        replace(task, kind="press", path=motion.path[1:])
        if task.index % every == 0
        else task
        for task, motion in zip(plan.tasks, plan.motions, strict=True)
    )
    return replace(plan, tasks=tasks)


def deviating(plan: MotionPlan, error: PoseError = OFF) -> MotionPlan:
    return replace(plan, cell=replace(plan.cell, deviations={"press": error}))


@pytest.mark.parametrize("seed", range(3))
def test_a_plan_made_with_a_deviation_survives_it(seed: int) -> None:
    """By the proof's own code; and links that do not deviate are asked for no more."""
    plan = with_skills(world.random_turns(seed, 4, gap=0.64), every=2)
    tpg = build_tpg(deviating(plan))
    assert any(chain.skill.any() for chain in tpg.chains)
    check_invariant(DerivedTpg(tpg))
    report = verify_plan(tpg, deviation=OFF)
    assert report.ok, report.problems
    assert report.survived is None
    assert report.deviated is not None
    assert report.deviated.ok


@cache
def meeting() -> tuple[MotionPlan, float]:
    """Right leans in and stands; left comes down beside it in a skill, less than 2 mm away."""
    cell = world.two_arms(gap=0.7)
    home = cell.robots[0].home
    robots = {r.name: WitnessRobot(r) for r in cell.robots}
    lean = np.array([0, 1, 0.4, 0, 0, 0])

    def gap(share: float) -> float:
        q = home + share * lean
        parts = [
            [
                (p, r.joint_frame(q, p.joint) if p.joint >= 0 else r.base)
                for p in r.parts
            ]
            for r in (robots["left"], robots["right"])
        ]
        return min(measure(*a, *b) for a, b in product(*parts))

    near, far = 0.6, 0.0
    for _ in range(40):
        middle = 0.5 * (near + far)
        near, far = (near, middle) if gap(middle) > 0.0018 else (middle, far)
    writer = Writer(cell)
    writer.move("right", home + far * lean)
    writer.move("left", home + far * lean)
    writer.move("left", home)
    writer.move("right", home)
    plan = writer.plan()
    tasks = list(plan.tasks)
    for k in (1, 2):
        tasks[k] = replace(tasks[k], kind="press", path=plan.motions[k].path[1:])
    return replace(plan, tasks=tuple(tasks)), gap(far)


def test_two_skills_that_come_too_near_are_named() -> None:
    plan, gap = meeting()
    tpg = build_tpg(plan)
    assert verify_plan(tpg).ok
    report = verify_plan(tpg, deviation=PoseError(0.004, 0.004))
    survived = report.deviated
    assert survived is not None
    assert not report.ok
    assert not report.problems
    limiting = survived.robots.limiting
    assert limiting is not None
    assert {limiting.first.robot, limiting.second.robot} == {"left", "right"}
    assert limiting.first.task in (1, 2) or limiting.second.task in (1, 2)
    assert limiting.distance_m == pytest.approx(gap, abs=2e-4)
    assert survived.least is survived.robots
    # In the cell that says so it is a matter of the clearance, and cannot be planned either.
    wide = deviating(plan, PoseError(0.004, 0.004))
    assert not verify_plan(replace(tpg, cell=wide.cell)).ok
    with pytest.raises(PlanInvariantError):
        check_invariant(DerivedTpg(build_tpg(wide)))


def test_what_is_no_skill_does_not_deviate() -> None:
    plan = world.random_turns(0, 4, gap=0.64)
    tpg = build_tpg(plan)
    large = verify_plan(tpg, deviation=PoseError(0.05, 0.05))
    assert large.ok
    assert large.deviated is not None
    assert large.deviated.robots.limiting is None
    same = build_tpg(deviating(plan, PoseError(0.05, 0.05)))
    assert np.array_equal(same.edges, tpg.edges)


def test_deviating_nodes_are_other_occupants() -> None:
    """What is remembered of nodes that follow their path does not hold of those that do not."""
    plan = with_skills(world.random_turns(0, 2))
    plain, wide = (DerivedTpg(build_nodes(p)) for p in (plan, deviating(plan)))
    count = len(plain.tpg.chains[0])
    one, other = (occupant_of_nodes(g, 0, 0, count) for g in (plain, wide))
    assert one.content != other.content
    assert not one.occupancy.hulls.deviates.any()
    assert other.occupancy.hulls.deviates.any()


def test_deviations_come_back_with_a_plan(tmp_path: Path) -> None:
    plain = build_tpg(with_skills(world.random_turns(1, 2)))
    wide = replace(plain, cell=replace(plain.cell, deviations={"press": OFF}))
    assert plan_sha256(wide) != plan_sha256(plain)
    none = replace(plain, cell=replace(plain.cell, deviations={}))
    assert plan_sha256(none) == plan_sha256(plain)
    save_plan(wide, tmp_path)
    again = load_plan(tmp_path)
    assert again.cell.deviations == {"press": OFF}
    assert plan_sha256(again) == plan_sha256(wide)
