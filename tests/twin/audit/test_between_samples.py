"""What happens between two configurations that are looked at is not missed by the audit."""

from pathlib import Path

import numpy as np
import pytest

from planning.cell.workcell import Fixture
from planning.transforms import translation
from tests.twin.audit.audit_cell import (
    HandWrittenRun,
    fixture,
    reach,
    two_arm_cell,
    with_fixture,
)
from twin.audit.audit import Auditor, audit_run
from twin.audit.motion.executed import ReplayedRun, read_recording
from twin.audit.motion.movers import stretches
from twin.audit.motion.pairs import FINEST
from twin.audit.worlds.engines import open_world


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
    world = open_world(run.cell)
    shapes = [[s for s in world.robot_shapes if s.robot == k] for k in (0, 1)]
    times, path = run.motions["left"]
    world.configure(1, run.motions["right"][1][0])
    least = np.inf
    for t in np.linspace(times[0], times[-1], steps):
        world.configure(0, np.array([np.interp(t, times, q) for q in path.T]))
        for a in shapes[0]:
            for b in shapes[1]:
                least = min(least, world.distance(a, b, 0.05))
    world.close()
    return least


def test_the_least_distance_is_that_of_the_motion(tmp_path: Path) -> None:
    run = sweep(0.6)
    least = finely(run)
    report = audit_run(run.write(tmp_path))
    assert least < 0.01
    assert report.violations == ()
    assert report.min_distance_bound_m <= least + 1e-6
    assert least - FINEST / 2 <= report.min_distance_m <= least + FINEST / 2
    assert report.min_distance_m - FINEST / 2 <= report.min_distance_bound_m


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
    world = open_world(with_fixture(two_arm_cell(), post(x)))
    world.configure(0, q)
    arm = [s for s in world.robot_shapes if s.robot == 0]
    gap = min(world.distance(s, world.fixtures[-1], 0.1) for s in arm)
    world.close()
    return gap <= 0.0


def test_nothing_gets_further_than_its_bound(tmp_path: Path) -> None:
    """Oracle: points on the spheres, at twenty moments between two samples."""
    run = sweep(0.9)
    with Auditor(run.tpg()) as auditor:
        recording = read_recording(run.write(tmp_path), run.cell)
        world = auditor._world
        tightest = 0.0
        for stretch in stretches(world, ReplayedRun(run.cell, recording)):
            rows = stretch.robots[0]
            for k in range(0, len(stretch.t) - 1, 7):
                share = np.linspace(0.0, 1.0, 20)[:, None]
                q = rows.q[k] + share * (rows.q[k + 1] - rows.q[k])
                rotation, position = world.link_frames(0, q)
                steps = stretch.movers.steps[k]
                for track, step in zip(stretch.movers.tracks, steps, strict=True):
                    if track.holder != 0 or step == 0.0:
                        continue
                    shape, link = track.shape, track.link
                    for side in np.vstack([np.eye(3), -np.eye(3)]):
                        local = shape.centre + shape.radius * side
                        points = rotation[:, link] @ local + position[:, link]
                        way = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
                        assert way <= step + 1e-7  # Bullet rounds poses
                        tightest = max(tightest, way / step)
    assert tightest > 0.5
