"""The audit sees one planted violation of each kind, and nothing in a clean run."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.errors import OutputError
from planning.kinematics.kinematics import frame_pose, inverse_kinematics
from planning.robots.registry import robot_model
from planning.tasks.task import AllowedContact
from planning.transforms import Array, translation
from scheduling.verification.reference import ReferenceRobot, measure
from tests.twin.audit.audit_cell import (
    BRICK,
    TOP,
    HandWrittenRun,
    brick,
    in_hand,
    reach,
    straight_down,
    two_arm_cell,
)
from twin.audit.audit import Auditor, AuditReport, audit_run
from twin.audit.grips import CONTACT_DEPTH, SLACK
from twin.audit.motion.executed import read_recording
from twin.audit.motion.pairs import FINEST
from twin.audit.motion.replay import Replay
from twin.audit.motion.sampling import STEP, stretches
from twin.audit.worlds.engines import open_world
from twin.audit.worlds.world import overlapping_at_home

X, Y = 0.42, -0.05
EDGE = X + BRICK[0] / 2
"""Where the tool's centre grips a brick at (X, Y): its lever is then outside the brick."""

CONTACT = TOP + BRICK[2]
HIGH = CONTACT + 0.06


def only(report: AuditReport) -> tuple[set[str], float, float, float]:
    """The one violation of a report: its pair, depth, start and end."""
    assert len(report.violations) == 1, report.violations
    found = report.violations[0]
    return {found.first, found.second}, found.depth_m, found.t_start, found.t_end


def down_and_up(low: float) -> tuple[Array, Array]:
    """Times and configurations of ``left`` going down on a brick at (X, Y) and up again.

    It reaches its lowest point at 3 s, 1 mm every 50 ms.
    """
    steps = 60
    path = straight_down(
        two_arm_cell(), "left", EDGE, Y, low + steps * 1e-3, low, steps + 1
    )
    return np.linspace(0, 6, 2 * steps + 1), np.vstack([path, path[-2::-1]])


def handled(*names: str, robot: str = "left", task: int = 0) -> list[AllowedContact]:
    """The tool may touch the bricks; bricks may touch each other and the plate."""
    tool = [AllowedContact(f"{robot}/tool", n, frozenset([task])) for n in names]
    others = combinations((*names, "plate"), 2)
    return tool + [AllowedContact(a, b, frozenset([task])) for a, b in others]


def test_a_brick_is_picked_lifted_and_put_back_without_violation(
    tmp_path: Path,
) -> None:
    cell = two_arm_cell([brick("b1", X, Y), brick("b2", X - 0.016, Y)])
    times, path = down_and_up(CONTACT)
    lift = np.vstack([path, path[1:]])
    run = HandWrittenRun(cell, handled("b1", "b2"))
    run.move("left", np.linspace(0, 12, len(lift)), lift)
    start = cell.object("b1").start
    run.put(3.0, "b1", "left", in_hand(cell, "left", path[60], start))
    run.put(9.0, "b1", None, start)
    report = audit_run(run.write(tmp_path))
    assert report.violations == ()
    assert report.configurations >= 2 * len(times) - 2
    assert 0.05 < report.min_distance_m < 0.5


def test_arm_and_arm(tmp_path: Path) -> None:
    cell = two_arm_cell()
    # Both force sensors have a radius of 47.2 mm; the right arm comes 4 mm too close.
    goal = 0.40 + 2 * 0.0472 - 0.004
    path = [reach(cell, "right", goal + 0.060, 0.0, 0.3)]
    for x in np.linspace(goal + 0.060, goal, 61)[1:]:
        target = frame_pose(cell.robot("right"), path[0], "tool").copy()
        target[0, 3] = x
        path.append(
            inverse_kinematics(cell.robot("right"), "tool", target, path[-1])[0]
        )
    run = HandWrittenRun(cell)
    still = reach(cell, "left", 0.40, 0.0, 0.3)
    run.move("left", [0.0, 6.0], np.array([still, still]))
    run.move("right", np.linspace(0, 6, 61), np.array(path))
    report = audit_run(run.write(tmp_path))
    pair, depth, start, end = only(report)
    assert pair == {"left/arm", "right/arm"}
    assert depth == pytest.approx(0.004, abs=1e-4)
    assert start == pytest.approx(5.65, abs=0.06)
    assert end == 6.0
    assert report.min_distance_m == -depth


def test_robots_report_their_least_distance_when_they_stay_apart(
    tmp_path: Path,
) -> None:
    cell = two_arm_cell()
    run = HandWrittenRun(cell)
    for robot, x in (("left", 0.40), ("right", 0.40 + 2 * 0.0472 + 0.0025)):
        q = reach(cell, robot, x, 0.0, 0.3)
        run.move(robot, [0.0, 1.0], np.array([q, q]))
    report = audit_run(run.write(tmp_path))
    assert report.violations == ()
    assert report.min_distance_m == pytest.approx(0.0025, abs=2e-5)
    assert report.configurations == 1


@pytest.mark.parametrize("meant", [False, True])
def test_what_a_robot_carries_counts_where_no_contact_is_meant(
    tmp_path: Path, meant: bool
) -> None:
    """The left arm holds out a rod towards the tool of the right one."""
    at = translation(0.48, 0.0, 0.3)
    rod = CellObject("rod", "rod", box_shape("rod", (0.16, 0.02, 0.02)), at)
    cell = two_arm_cell([rod])
    both = frozenset({0, 1})
    allowed = [AllowedContact("rod", "right/tool", both)] if meant else []
    run = HandWrittenRun(cell, allowed)
    q = {r: reach(cell, r, x, 0.0, 0.3) for r, x in (("left", 0.4), ("right", 0.62))}
    for robot in q:
        run.move(robot, [0.0, 1.0], np.array([q[robot], q[robot]]))
    run.put(0.0, "rod", "left", in_hand(cell, "left", q["left"], at))
    world = open_world(cell)
    for k, robot in enumerate(("left", "right")):
        world.configure(k, q[robot])
    (carried,) = world.objects
    world.place(carried, at)
    left, right = ([s for s in world.robot_shapes if s.robot == k] for k in (0, 1))
    arms = min(world.distance(a, b, 1.0) for a in left for b in right)
    to_rod = {s.entity: 1.0 for s in right}
    for shape in right:
        found = world.distance(carried, shape, 1.0)
        to_rod[shape.entity] = min(to_rod[shape.entity], found)
    world.close()
    assert to_rod["right/tool"] < min(arms, to_rod["right/arm"]) - 0.005
    least = min(arms, to_rod["right/arm"]) if meant else to_rod["right/tool"]
    report = audit_run(run.write(tmp_path))
    assert report.min_distance_m == pytest.approx(least, abs=2e-5)


def test_tool_and_plate(tmp_path: Path) -> None:
    times, path = down_and_up(TOP + 0.0032 - 0.002)
    run = HandWrittenRun(two_arm_cell())
    run.move("left", times, path)
    pair, depth, start, end = only(audit_run(run.write(tmp_path)))
    assert pair == {"left/tool", "plate"}
    assert depth == pytest.approx(0.002, abs=1e-4)
    assert (start, end) == pytest.approx((2.9, 3.1), abs=0.06)


def test_tool_and_stock_brick(tmp_path: Path) -> None:
    times, path = down_and_up(CONTACT - 0.002)
    run = HandWrittenRun(two_arm_cell([brick("b1", X, Y)]))
    run.move("left", times, path)
    pair, depth, start, end = only(audit_run(run.write(tmp_path)))
    assert pair == {"left/tool", "b1"}
    assert depth == pytest.approx(0.002, abs=1e-4)
    assert (start, end) == pytest.approx((2.9, 3.1), abs=0.06)


def test_the_same_contact_is_fine_while_the_plan_allows_it_up_to_a_depth(
    tmp_path: Path,
) -> None:
    times, path = down_and_up(CONTACT - 0.002)
    run = HandWrittenRun(two_arm_cell([brick("b1", X, Y)]), handled("b1"))
    run.move("left", times, path)
    assert audit_run(run.write(tmp_path)).violations == ()
    times, path = down_and_up(CONTACT - 0.0045)
    run.move("left", times, path)
    pair, depth, start, end = only(audit_run(run.write(tmp_path)))
    assert pair == {"left/tool", "b1"}
    assert depth == pytest.approx(0.0045, abs=1e-4)
    # Deeper than 3 mm is a violation, shallower is not.
    assert (start, end) == pytest.approx((2.925, 3.075), abs=0.06)
    assert depth > CONTACT_DEPTH


def test_a_tool_that_only_grazes_goes_no_deeper_than_the_tolerance(
    tmp_path: Path,
) -> None:
    cell = two_arm_cell([brick("b1", X, Y)])
    assert cell.clearances.contact_tolerance == 0.0002
    grazing = AllowedContact("left/tool", "b1", frozenset([0]), grazing=True)
    for depth, fine in ((0.00015, True), (0.0006, False)):
        times, path = down_and_up(CONTACT - depth)
        run = HandWrittenRun(cell, [grazing])
        run.move("left", times, path)
        report = audit_run(run.write(tmp_path))
        assert (report.violations == ()) == fine
        assert report.contact_tolerance_m == 0.0002
        assert report.deepest_graze_m == pytest.approx(depth, abs=5e-5)
        if not fine:
            pair, found, _, _ = only(report)
            assert pair == {"left/tool", "b1"}
            assert found == pytest.approx(depth, abs=1e-4)


@pytest.mark.parametrize(
    "entry",
    [
        AllowedContact("left/tool", "b1", frozenset([1])),  # another task
        AllowedContact("right/tool", "b1", frozenset([0])),  # another robot
        AllowedContact("left/arm", "b1", frozenset([0])),  # an arm never may
        AllowedContact("left/tool", "plate", frozenset([0])),  # another object
    ],
)
def test_a_contact_must_be_the_one_allowed(
    tmp_path: Path, entry: AllowedContact
) -> None:
    times, path = down_and_up(CONTACT - 0.002)
    run = HandWrittenRun(two_arm_cell([brick("b1", X, Y)]), [entry])
    run.move("left", times, path)
    assert only(audit_run(run.write(tmp_path)))[0] == {"left/tool", "b1"}


def test_tool_and_placed_brick(tmp_path: Path) -> None:
    cell = two_arm_cell([brick("b1", X, Y)])
    run = HandWrittenRun(cell, handled("b1"))
    times, path = down_and_up(CONTACT)
    # The left arm takes the brick 40 mm up and leaves it there; then the right one touches it.
    run.move("left", [*times[:-20], 20.0], np.vstack([path[:-20], path[-21]]))
    start = cell.object("b1").start
    local = in_hand(cell, "left", path[60], start)
    run.put(3.0, "b1", "left", local)
    placed = frame_pose(cell.robot("left"), path[-21]) @ local
    run.put(8.0, "b1", None, placed)
    home = cell.robot("left").home
    run.move(
        "left", [*times[:-20], 9.0, 11.0], np.vstack([path[:-20], path[-21], home])
    )
    grip = placed[:3, 3] + [-0.005, 0.0, BRICK[2] / 2]
    approach = [reach(cell, "right", grip[0], grip[1], grip[2] + 0.06)]
    away = approach[0]
    for z in np.linspace(0.06, -0.002, 63)[1:]:
        target = frame_pose(cell.robot("right"), away, "tool").copy()
        target[2, 3] = grip[2] + z
        found = inverse_kinematics(cell.robot("right"), "tool", target, approach[-1])
        approach.append(found[0])
    back = cell.robot("right").home
    run.move(
        "right",
        [0.0, 12.0, 14.0, *np.linspace(14, 20.2, 63)[1:]],
        np.vstack([back, back, approach]),
    )
    pair, depth, first, last = only(audit_run(run.write(tmp_path)))
    assert pair == {"right/tool", "b1"}
    # The lever reaches 3.2 mm beyond the grip plane.
    assert depth == pytest.approx(0.0052, abs=2e-4)
    assert first == pytest.approx(19.7, abs=0.15)
    assert last == pytest.approx(20.2)


def test_carried_brick_and_brick_at_rest(tmp_path: Path) -> None:
    near = brick("b2", X - 0.040, Y)
    cell = two_arm_cell([brick("b1", X, Y), near])
    _, path = down_and_up(CONTACT)
    # Up by 2 mm, then sideways until the side of b1 is 2.5 mm within b2.
    side = [path[62]]
    for step in np.linspace(0.0, 0.040 - BRICK[0] + 0.0025, 55)[1:]:
        target = frame_pose(cell.robot("left"), path[62], "tool").copy()
        target[0, 3] -= step
        found = inverse_kinematics(cell.robot("left"), "tool", target, side[-1])
        side.append(found[0])
    run = HandWrittenRun(cell, handled("b1"))
    motion = np.vstack([path[:63], side[1:]])
    run.move("left", 0.05 * np.arange(len(motion)), motion)
    start = cell.object("b1").start
    run.put(3.0, "b1", "left", in_hand(cell, "left", path[60], start))
    pair, depth, first, last = only(audit_run(run.write(tmp_path)))
    assert pair == {"b1", "b2"}
    assert depth == pytest.approx(0.0025, abs=1e-4)
    end = 0.05 * (len(motion) - 1)
    assert last == pytest.approx(end)
    assert first == pytest.approx(end - 0.05 * 0.0025 / 0.0005, abs=0.1)


def test_carried_object_and_other_arm(tmp_path: Path) -> None:
    size = np.array([0.2, 0.016, 0.0096])
    beam = CellObject("beam", "beam", box_shape("beam", size), translation(0, 0, 5))
    cell = two_arm_cell([beam])
    left = reach(cell, "left", 0.34, 0.0, 0.26)
    # The beam's end is 192 mm ahead of the tool's centre, 20 mm below the grip plane.
    ahead = translation(0.34 + 0.092, 0.0, 0.24)
    run = HandWrittenRun(cell, [AllowedContact("left/tool", "beam", frozenset([0]))])
    run.put(0.0, "beam", "left", in_hand(cell, "left", left, ahead))
    run.move("left", [0.0, 3.0], np.array([left, left]))
    # A tip of 16 x 16 mm comes from 33 mm away to 3 mm within the beam's end.
    right = reach(cell, "right", 0.34 + 0.192 + 0.008 + 0.030, 0.0, 0.236)
    path = [right]
    for step in np.linspace(0.0, 0.033, 31)[1:]:
        target = frame_pose(cell.robot("right"), right, "tool").copy()
        target[0, 3] -= step
        path.append(
            inverse_kinematics(cell.robot("right"), "tool", target, path[-1])[0]
        )
    run.move("right", np.linspace(0.0, 3.0, 31), np.array(path))
    pair, depth, first, last = only(audit_run(run.write(tmp_path)))
    assert pair == {"beam", "right/tool"}
    assert depth == pytest.approx(0.003, abs=2e-4)
    assert first == pytest.approx(3.0 - 3.0 / 11, abs=0.12)
    assert last == 3.0


def test_a_robot_and_itself(tmp_path: Path) -> None:
    cell = two_arm_cell()
    home = cell.robot("left").home
    run = HandWrittenRun(cell)
    bent = home.copy()
    bent[4] = np.radians(100.0)
    run.move("left", [0.0, 5.0], np.array([home, bent]))
    assert audit_run(run.write(tmp_path)).violations == ()
    bent[4] = np.radians(119.0)  # the force sensor meets the forearm
    run.move("left", [0.0, 5.0], np.array([home, bent]))
    pair, depth, start, end = only(audit_run(run.write(tmp_path)))
    assert pair == {"left/arm"}
    assert depth == pytest.approx(0.0116, abs=1e-3)
    assert start == pytest.approx(4.76, abs=0.05)
    assert end == 5.0


def test_an_object_that_is_not_where_it_was(tmp_path: Path) -> None:
    cell = two_arm_cell([brick("b1", X, Y)])
    run = HandWrittenRun(cell)
    run.move("left", [0.0, 2.0], np.stack([cell.robot("left").home] * 2))
    moved = cell.object("b1").start.copy()
    moved[0, 3] += 0.002
    run.put(1.0, "b1", None, moved)
    pair, depth, start, end = only(audit_run(run.write(tmp_path)))
    assert pair == {"b1", "jump"}
    assert depth == pytest.approx(0.002)
    assert start == end == 1.0


def test_two_stretches_of_one_contact_are_two_violations(tmp_path: Path) -> None:
    times, path = down_and_up(CONTACT - 0.002)
    run = HandWrittenRun(two_arm_cell([brick("b1", X, Y)]))
    run.move("left", [*times, *(times[1:] + 6.0)], np.vstack([path, path[1:]]))
    found = audit_run(run.write(tmp_path)).violations
    assert [(v.first, v.second) for v in found] == [("left/tool", "b1")] * 2
    assert found[0].t_end < 6.0 < found[1].t_start


def _random_run(seed: int, folder: Path) -> Path:
    rng = np.random.default_rng(seed)
    held, others = (
        brick("b0", X, Y),
        [brick(f"b{k}", 0.3 + 0.03 * k, 0.1) for k in (1, 2)],
    )
    cell = two_arm_cell([held, *others], gap=0.6)
    run = HandWrittenRun(cell)
    for robot in ("left", "right"):
        home, model = cell.robot(robot).home, cell.robot(robot).model
        path = home + np.vstack([np.zeros(6), rng.uniform(-0.6, 0.6, (3, 6))])
        path = np.clip(path, model.lower, model.upper)
        run.move(robot, [0.0, 1.0, 2.0, 3.0], path)
    grip = translation(0.0, 0.0, 0.111 + BRICK[2] / 2)
    run.put(0.0, "b0", "left", grip)
    return run.write(folder)


@pytest.mark.parametrize("seed", range(2))
def test_skipping_measurements_changes_nothing(tmp_path: Path, seed: int) -> None:
    """Oracle: every pair at every sample, without spheres or skipped samples."""
    folder = _random_run(seed, tmp_path)
    from scheduling.graph.plan_files import load_plan

    tpg = load_plan(folder)
    recording = read_recording(folder, tpg.cell)
    with Auditor(tpg) as auditor:
        report = auditor.audit(recording)
    world = open_world(tpg.cell)
    exempt = overlapping_at_home(world)
    least, deepest, samples = np.inf, {}, 0
    for stretch in stretches(world, Replay(tpg.cell, recording)):
        moving, resting = stretch.movers.tracks, stretch.boxes.tracks
        arms = len(world.robot_shapes)
        for sample in range(len(stretch.t)):
            samples += 1
            for index, robot in enumerate(stretch.robots):
                world.configure(index, robot.q[sample])
            for load in moving[arms:]:
                at, link = stretch.robots[load.holder], np.eye(4)
                link[:3, :3] = at.rotation[sample, load.link]
                link[:3, 3] = at.position[sample, load.link]
                world.place(load.shape, link @ load.pose)
            for i, a in enumerate(moving):
                for j, b in enumerate([*moving, *resting]):
                    if j <= i or (i, j) in exempt:
                        continue
                    if b.holder is None and i < arms and a.link == 0:
                        continue
                    gap = world.distance(a.shape, b.shape, 0.2)
                    if b.holder is not None and a.holder != b.holder:
                        least = min(least, gap)
                    pair = (a.shape.entity, b.shape.entity)
                    deepest[pair] = max(deepest.get(pair, -1.0), -gap)
    world.close()
    assert samples > 100
    # What is measured in between may be nearer, and deeper, than any sample.
    assert report.min_distance_m <= least + 1e-9
    assert report.min_distance_bound_m <= report.min_distance_m
    assert report.min_distance_bound_m >= report.min_distance_m - FINEST / 2
    expected = {pair: d for pair, d in deepest.items() if d > SLACK}
    seen: dict[tuple[str, str], float] = {}
    for v in report.violations:
        if v.kind != "contact":  # random motions are quick, and go beyond limits
            continue
        seen[v.first, v.second] = max(seen.get((v.first, v.second), 0.0), v.depth_m)
    assert expected.keys() <= seen.keys()
    for pair, depth in expected.items():
        assert depth - 1e-6 <= seen[pair] <= depth + STEP


def test_no_point_moves_further_than_the_step(tmp_path: Path) -> None:
    folder = _random_run(7, tmp_path)
    from scheduling.graph.plan_files import load_plan

    tpg = load_plan(folder)
    recording = read_recording(folder, tpg.cell)
    world = open_world(tpg.cell)
    largest = 0.0
    for stretch in stretches(world, Replay(tpg.cell, recording)):
        largest = max(largest, float(stretch.movers.steps.max()))
    world.close()
    assert STEP / 2 < largest <= STEP


@pytest.mark.parametrize("name", ["gp4", "panda", "iiwa14"])
def test_bullet_measures_what_coal_measures(tmp_path: Path, name: str) -> None:
    """The slack of the audit is more than twice the difference of the two libraries."""
    model = robot_model(name)
    placed = PlacedRobot("arm", model, translation(0.1, 0.2, 0.3), model.home)
    size = np.array([0.1, 0.08, 0.06])
    box = CellObject("box", "box", box_shape("box", size), np.eye(4))
    run = HandWrittenRun(Workcell((placed,), (), (box,)))
    run.move("arm", [0.0, 1.0], np.stack([model.home] * 2))
    world = open_world(run.tpg().cell)
    reference = ReferenceRobot(placed)
    assert [s.entity for s in world.robot_shapes] == [p.entity for p in reference.parts]
    rng = np.random.default_rng(3)
    worst, close = 0.0, 0
    (held,) = reference.loads("box", box.shape, np.eye(4))
    for _ in range(150):
        q = rng.uniform(model.lower, model.upper)
        world.configure(0, q)
        k = int(rng.integers(len(reference.parts)))
        part = reference.parts[k]
        frame = reference.joint_frame(q, part.joint)
        centre = frame[:3, :3] @ part.centre + frame[:3, 3]
        away = rng.normal(size=3)
        pose = translation(*(centre + away / np.linalg.norm(away) * part.radius))
        world.place(world.objects[0], pose)
        at_rest = type(held)(
            "box", -1, np.eye(4), held.shape, np.zeros(3), 0.0, held.weight
        )
        expected = measure(part, frame, at_rest, pose)
        if not -0.004 < expected < 0.05:
            continue
        close += 1
        found = world.distance(world.robot_shapes[k], world.objects[0], 0.2)
        worst = max(worst, abs(found - expected))
    world.close()
    assert close > 25
    assert worst < SLACK / 2


def test_recordings_that_do_not_fit_the_plan_are_refused(tmp_path: Path) -> None:
    cell = two_arm_cell()
    run = HandWrittenRun(cell)
    home = cell.robot("left").home
    run.move("left", [0.0, 1.0], np.stack([home, home]))
    folder = run.write(tmp_path)
    (folder / "trajectory.parquet").unlink()
    with pytest.raises(OutputError, match=r"trajectory\.parquet"):
        audit_run(folder)
    run.move("left", [0.0, 0.0], np.stack([home, home + 0.1]))
    with pytest.raises(OutputError, match="jumps"):
        audit_run(run.write(tmp_path))


def test_bullet_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    open_world(two_arm_cell()).close()
    assert capfd.readouterr() == ("", "")
