"""The audit sees one planted violation of each kind, nothing in a clean run, and all that happens between what is looked at."""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Fixture
from planning.errors import OutputError
from planning.kinematics.kinematics import frame_pose
from planning.tasks.task import AllowedContact
from planning.transforms import translation
from scheduling.graph.plan_files import load_plan
from scheduling.witness.measuring import PRECISION
from tests.twin.audits.audit_cell import (
    BRICK,
    CONTACT,
    TOP,
    HandWrittenRun,
    along,
    brick,
    down_and_up,
    fixture,
    handled,
    in_hand,
    reach,
    two_arm_cell,
    with_fixture,
)
from twin.audits.audit import Auditor, AuditReport, audit_run
from twin.audits.contacts import CONTACT_DEPTH
from twin.audits.motion.executed import ReplayedRun, read_recording
from twin.audits.motion.pairs import SLACK
from twin.audits.motion.stretches import STEP, stretches
from twin.audits.worlds.world import AuditWorld, overlapping_at_home

X, Y = 0.42, -0.05
EDGE = X + BRICK[0] / 2
"""Where the tool's centre grips a brick at (X, Y): its lever is then outside the brick."""

SENSORS = 2 * 0.0472
"""Both force sensors touch where they are this far apart [m]."""


def only(report: AuditReport) -> tuple[set[str], float, float, float]:
    """The one violation of a report: its pair, depth, start and end."""
    assert len(report.violations) == 1, report.violations
    found = report.violations[0]
    return {found.first, found.second}, found.depth_m, found.t_start, found.t_end


def pressing(
    low: float, *names: str, allowed: Sequence[AllowedContact] = ()
) -> HandWrittenRun:
    """``left`` goes down to some height at (EDGE, Y) and up again; there may be bricks."""
    bricks = [brick(name, X - 0.016 * k, Y) for k, name in enumerate(names)]
    cell = two_arm_cell(bricks)
    run = HandWrittenRun(cell, list(allowed))
    run.move("left", *down_and_up(cell, EDGE, Y, low))
    return run


def test_a_brick_is_picked_lifted_and_put_back_without_violation(
    tmp_path: Path,
) -> None:
    run = pressing(CONTACT, "b1", "b2", allowed=handled("b1", "b2"))
    _, path = run.motions["left"]
    lift = np.vstack([path, path[1:]])
    run.move("left", np.linspace(0, 12, len(lift)), lift)
    start = run.cell.object("b1").start
    run.put(3.0, "b1", "left", in_hand(run.cell, "left", path[60], start))
    run.put(9.0, "b1", None, start)
    report = audit_run(run.write(tmp_path))
    assert report.violations == ()
    assert report.configurations >= 2 * len(path) - 2
    assert 0.05 < report.min_distance_m < 0.5


def test_arm_and_arm(tmp_path: Path) -> None:
    """The right arm comes 4 mm too close."""
    cell = two_arm_cell()
    run = HandWrittenRun(cell)
    run.stand("left", 6.0, reach(cell, "left", 0.40, 0.0, 0.3))
    far = reach(cell, "right", 0.40 + SENSORS - 0.004 + 0.060, 0.0, 0.3)
    path = along(cell, "right", far, (-0.060, 0.0, 0.0), 61)
    run.move("right", np.linspace(0, 6, 61), path)
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
    for robot, x in (("left", 0.40), ("right", 0.40 + SENSORS + 0.0025)):
        run.stand(robot, 1.0, reach(cell, robot, x, 0.0, 0.3))
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
        run.stand(robot, 1.0, q[robot])
    run.put(0.0, "rod", "left", in_hand(cell, "left", q["left"], at))
    world = AuditWorld(cell)
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
    assert to_rod["right/tool"] < min(arms, to_rod["right/arm"]) - 0.005
    least = min(arms, to_rod["right/arm"]) if meant else to_rod["right/tool"]
    report = audit_run(run.write(tmp_path))
    assert report.min_distance_m == pytest.approx(least, abs=2e-5)


OTHERS = [
    AllowedContact("left/tool", "b1", frozenset([1])),  # another task
    AllowedContact("right/tool", "b1", frozenset([0])),  # another robot
    AllowedContact("left/arm", "b1", frozenset([0])),  # an arm never may
    AllowedContact("left/tool", "plate", frozenset([0])),  # another object
]


@pytest.mark.parametrize(
    ("low", "names", "allowed", "depth", "half"),
    [
        (TOP + 0.0032 - 0.002, (), [], 0.002, 0.1),
        (CONTACT - 0.002, ("b1",), [], 0.002, 0.1),
        *((CONTACT - 0.002, ("b1",), [other], 0.002, 0.1) for other in OTHERS),
        # Deeper than 3 mm is a violation, shallower is not.
        (CONTACT - 0.002, ("b1",), handled("b1"), 0.0, 0.0),
        (CONTACT - 0.0045, ("b1",), handled("b1"), 0.0045, 0.075),
    ],
)
def test_a_tool_touches_only_what_the_plan_lets_it_up_to_a_depth(
    tmp_path: Path,
    low: float,
    names: tuple[str, ...],
    allowed: list[AllowedContact],
    depth: float,
    half: float,
) -> None:
    assert CONTACT_DEPTH == 0.003
    report = audit_run(pressing(low, *names, allowed=allowed).write(tmp_path))
    if not depth:
        assert report.violations == ()
        return
    pair, found, start, end = only(report)
    assert pair == {"left/tool", *(names or ("plate",))}
    assert found == pytest.approx(depth, abs=1e-4)
    assert (start, end) == pytest.approx((3.0 - half, 3.0 + half), abs=0.06)


@pytest.mark.parametrize(("depth", "fine"), [(0.00015, True), (0.0006, False)])
def test_a_tool_that_only_grazes_goes_no_deeper_than_the_tolerance(
    tmp_path: Path, depth: float, fine: bool
) -> None:
    grazing = AllowedContact("left/tool", "b1", frozenset([0]), grazing=True)
    run = pressing(CONTACT - depth, "b1", allowed=[grazing])
    assert run.cell.clearances.contact_tolerance == 0.0002
    report = audit_run(run.write(tmp_path))
    assert (report.violations == ()) == fine
    assert report.contact_tolerance_m == 0.0002
    assert report.deepest_graze_m == pytest.approx(depth, abs=5e-5)
    if not fine:
        pair, found, _, _ = only(report)
        assert pair == {"left/tool", "b1"}
        assert found == pytest.approx(depth, abs=1e-4)


def test_tool_and_placed_brick(tmp_path: Path) -> None:
    """The left arm takes the brick 40 mm up and leaves it there; then the right one touches it."""
    run = pressing(CONTACT, "b1", allowed=handled("b1"))
    cell, (times, path) = run.cell, run.motions["left"]
    local = in_hand(cell, "left", path[60], cell.object("b1").start)
    run.put(3.0, "b1", "left", local)
    placed = frame_pose(cell.robot("left"), path[-21]) @ local
    run.put(8.0, "b1", None, placed)
    home = cell.robot("left").home
    run.move("left", [*times[:-20], 9.0, 11.0], [*path[:-20], path[-21], home])
    grip = placed[:3, 3] + [-0.005, 0.0, BRICK[2] / 2]
    above = reach(cell, "right", grip[0], grip[1], grip[2] + 0.06)
    approach = along(cell, "right", above, (0.0, 0.0, -0.062), 63)
    back = cell.robot("right").home
    after = np.linspace(14, 20.2, 63)[1:]
    run.move("right", [0.0, 12.0, 14.0, *after], [back, back, *approach])
    pair, depth, first, last = only(audit_run(run.write(tmp_path)))
    assert pair == {"right/tool", "b1"}
    # The lever reaches 3.2 mm beyond the grip plane.
    assert depth == pytest.approx(0.0052, abs=2e-4)
    assert first == pytest.approx(19.7, abs=0.15)
    assert last == pytest.approx(20.2)


def test_carried_brick_and_brick_at_rest(tmp_path: Path) -> None:
    """Up by 2 mm, then sideways until the side of b1 is 2.5 mm within b2."""
    cell = two_arm_cell([brick("b1", X, Y), brick("b2", X - 0.040, Y)])
    _, path = down_and_up(cell, EDGE, Y, CONTACT)
    run = HandWrittenRun(cell, handled("b1"))
    way = (-(0.040 - BRICK[0] + 0.0025), 0.0, 0.0)
    motion = np.vstack([path[:62], along(cell, "left", path[62], way, 55)])
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
    run.stand("left", 3.0, left)
    # A tip of 16 x 16 mm comes from 33 mm away to 3 mm within the beam's end.
    right = reach(cell, "right", 0.34 + 0.192 + 0.008 + 0.030, 0.0, 0.236)
    path = along(cell, "right", right, (-0.033, 0.0, 0.0), 31)
    run.move("right", np.linspace(0.0, 3.0, 31), path)
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
    assert start == pytest.approx(4.76, abs=0.1)
    assert end == 5.0


def test_two_stretches_of_one_contact_are_two_violations(tmp_path: Path) -> None:
    run = pressing(CONTACT - 0.002, "b1")
    times, path = run.motions["left"]
    run.move("left", [*times, *(times[1:] + 6.0)], np.vstack([path, path[1:]]))
    found = audit_run(run.write(tmp_path)).violations
    assert [(v.first, v.second) for v in found] == [("left/tool", "b1")] * 2
    assert found[0].t_end < 6.0 < found[1].t_start


def _random_run(seed: int, folder: Path) -> Path:
    rng = np.random.default_rng(seed)
    others = [brick(f"b{k}", 0.3 + 0.03 * k, 0.1) for k in (1, 2)]
    cell = two_arm_cell([brick("b0", X, Y), *others], gap=0.6)
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
    tpg = load_plan(folder)
    recording = read_recording(folder, tpg.cell)
    with Auditor(tpg) as auditor:
        report = auditor.audit(recording)
    world = AuditWorld(tpg.cell)
    exempt = overlapping_at_home(world)
    least, samples, largest = np.inf, 0, 0.0
    deepest: dict[tuple[str, str], float] = {}
    for stretch in stretches(world, ReplayedRun(tpg.cell, recording)):
        largest = max(largest, float(stretch.travel.max(initial=0.0)))
        arms = [shape for shape in world.robot_shapes if shape.joint >= 0]
        bases = [shape for shape in world.robot_shapes if shape.joint < 0]
        held = list(stretch.held())
        resting = [shape for shape, _ in stretch.resting]
        for shape, pose in stretch.resting:
            world.place(shape, pose)
        loads = [shape for _, shape, _ in held]
        holder = {shape.number: robot for robot, shape, _ in held}
        moving = sorted([*arms, *bases, *loads], key=lambda shape: shape.number)
        for sample in range(len(stretch.t)):
            samples += 1
            for index, path in enumerate(stretch.paths):
                world.configure(index, path[sample])
            for robot, shape, pose in held:
                (frame,) = world.robots[robot].joint_frames_along(
                    stretch.paths[robot][sample : sample + 1]
                )
                world.place(shape, frame[-1] @ pose)
            for a, b in combinations([*moving, *resting], 2):
                if a in resting or (a in bases and b in resting):
                    continue
                if (a.number, b.number) in exempt:
                    continue
                gap = world.distance(a, b, 0.2)
                of = [holder.get(s.number, s.robot) for s in (a, b)]
                if None not in of and of[0] != of[1]:
                    least = min(least, gap)
                pair = (a.entity, b.entity)
                deepest[pair] = max(deepest.get(pair, -1.0), -gap)
    assert samples > 100
    # No point moves further than that between two samples.
    assert STEP / 2 < largest <= STEP
    # What is measured in between may be nearer, and deeper, than any sample.
    assert report.min_distance_m <= least + 1e-9
    assert report.min_distance_bound_m <= report.min_distance_m
    assert report.min_distance_bound_m >= report.min_distance_m - PRECISION
    expected = {pair: d for pair, d in deepest.items() if d > SLACK}
    seen: dict[tuple[str, str], float] = {}
    for v in report.violations:
        if v.kind != "contact":  # random motions are quick, and go beyond limits
            continue
        seen[v.first, v.second] = max(seen.get((v.first, v.second), 0.0), v.depth_m)
    assert expected.keys() <= seen.keys()
    for pair, depth in expected.items():
        assert depth - 1e-6 <= seen[pair] <= depth + STEP


def test_recordings_that_do_not_fit_the_plan_are_refused(tmp_path: Path) -> None:
    run = HandWrittenRun(two_arm_cell())
    run.stand("left", 1.0)
    folder = run.write(tmp_path)
    (folder / "trajectory.parquet").unlink()
    with pytest.raises(OutputError, match=r"trajectory\.parquet"):
        audit_run(folder)
    home = run.cell.robot("left").home
    run.move("left", [0.0, 0.0], np.stack([home, home + 0.1]))
    with pytest.raises(OutputError, match="jumps"):
        audit_run(run.write(tmp_path))


def test_bullet_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    with Auditor(HandWrittenRun(two_arm_cell()).tpg()):
        pass
    assert capfd.readouterr() == ("", "")


def sweep(turn: float) -> HandWrittenRun:
    """The left arm turns about its base, past the right one; nobody has rows in between."""
    cell = two_arm_cell()
    run = HandWrittenRun(cell)
    run.stand("right", 6.0, reach(cell, "right", 0.40 + 2 * 0.0472 + 0.004, 0.0, 0.3))
    middle = reach(cell, "left", 0.40, 0.0, 0.3)
    path = np.stack([middle, middle, middle])
    path[0, 0] -= turn
    path[1, 0] += 0.7 * turn
    path[2, 0] += 0.9 * turn
    run.move("left", [0.0, 3.0, 6.0], path)
    return run


def finely(run: HandWrittenRun, steps: int = 1500) -> float:
    """Oracle: least distance of the two robots in very many configurations."""
    world = AuditWorld(run.cell)
    shapes = [[s for s in world.robot_shapes if s.robot == k] for k in (0, 1)]
    times, path = run.motions["left"]
    world.configure(1, run.motions["right"][1][0])
    least = np.inf
    for t in np.linspace(times[0], times[-1], steps):
        world.configure(0, np.array([np.interp(t, times, q) for q in path.T]))
        for a in shapes[0]:
            for b in shapes[1]:
                least = min(least, world.distance(a, b, 0.05))
    return least


def test_the_least_distance_is_that_of_the_motion(tmp_path: Path) -> None:
    run = sweep(0.6)
    least = finely(run)
    report = audit_run(run.write(tmp_path))
    assert least < 0.01
    assert report.violations == ()
    assert report.min_distance_bound_m <= least + 1e-6
    assert least - PRECISION <= report.min_distance_m <= least + PRECISION
    assert report.min_distance_m - PRECISION <= report.min_distance_bound_m


@pytest.mark.parametrize(("depth", "seen"), [(0.0005, True), (-0.0005, False)])
def test_a_graze_between_two_configurations_is_seen(
    tmp_path: Path, depth: float, seen: bool
) -> None:
    """A thin post stands where the arm is in the middle of one straight line."""
    q = reach(two_arm_cell(), "left", 0.40, 0.0, 0.3)
    low, high = 0.40, 0.60
    while high - low > 1e-6:  # where the post touches the arm, by bisection
        x = 0.5 * (low + high)
        low, high = (x, high) if _overlaps(q, x) else (low, x)
    run = HandWrittenRun(with_fixture(two_arm_cell(), post(low - depth)))
    path = np.stack([q, q])
    path[0, 0] -= 0.5
    path[1, 0] += 0.4
    run.move("left", [0.0, 5.0], path)
    kinds = {(v.kind, v.second) for v in audit_run(run.write(tmp_path)).violations}
    assert kinds == ({("contact", "post")} if seen else set())


def post(x: float) -> Fixture:
    return fixture("post", [0.01, 0.01, 0.05], translation(x, 0.0, 0.36))


def _overlaps(q: np.ndarray, x: float) -> bool:
    world = AuditWorld(with_fixture(two_arm_cell(), post(x)))
    world.configure(0, q)
    arm = [s for s in world.robot_shapes if s.robot == 0]
    gap = min(world.distance(s, world.fixtures[-1], 0.1) for s in arm)
    return gap <= 0.0
