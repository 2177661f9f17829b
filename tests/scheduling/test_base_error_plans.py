"""Plans for bases that may be off: what is called free stays free wherever they are, and only that."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from planning.cell.workcell import PoseError, Workcell, WorldState, start_state
from planning.errors import PlanInvariantError
from planning.geometry.exact import place
from planning.geometry.moving_pairs import MovingPair
from planning.geometry.scene_checker import SceneChecker
from planning.tasks.task import AllowedContact
from planning.transforms import Array, translation
from scheduling.build_tpg import build_tpg
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.occupancy import rest_occupancy
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.invariant import check_invariant
from scheduling.verification.motion import Motion
from scheduling.verification.reference import (
    ReferenceBody,
    ReferenceRobot,
    measure,
    resting_parts,
)
from scheduling.verification.verify import verify_plan
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
        self.robots = {r.name: ReferenceRobot(r) for r in cell.robots}

    def parts(self, name: str, q: Array) -> list[tuple[ReferenceBody, Array, float]]:
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
    return cell, SceneChecker(cell, "left", start_state(cell))


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
        state = start_state(plain)
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
        pose = place(solid, np.zeros(0), np.zeros(0))[0]
        assert np.allclose(pose.getTranslation(), handed.pose[:3, 3])
        assert solid.strays_with_base(pose) == pytest.approx(way)
        lies = rest_occupancy(tpg.cell, replace(handed, holder=None), derived.entities)
        assert lies.solids[0].strays_with_base(pose) == 0.0
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
    state = replace(near, attachments=start_state(cell).attachments)
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
