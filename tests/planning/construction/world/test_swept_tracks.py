"""What robots sweep: against corners of their bodies, and remembered against worked out anew."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.workcell import CellObject
from planning.construction.world.fixed_world import SweptTracks
from planning.construction.world.timeline import (
    STEP,
    HandChange,
    RobotTimeline,
    cut_timeline,
    pose_of,
)
from planning.construction.world.tracks import SweptTrack, sweep_track
from planning.kinematics.kinematics import joint_poses_of
from planning.transforms import Array, translation
from tests.planning.construction.toy_teams import box, placed, rover

ROVER = placed("rover", rover(), (0.0,) * 5)
ITEMS = {
    name: box(name, (0.2, 0.3, 0.1), (9.0, 9.0, 0.0)) for name in ("beam", "plate")
}


def random_line(rng: np.random.Generator) -> RobotTimeline:
    """A few motions, stands among them, the third of them a skill."""
    path = rng.uniform(-1.0, 1.0, (7, 5))
    path[2] = path[1]
    time = np.cumsum(rng.uniform(0.03, 1.5, 7))
    return RobotTimeline("rover", time, path, ((float(time[3]), float(time[4])),))


def random_changes(rng: np.random.Generator, line: RobotTimeline) -> list[HandChange]:
    """It takes one thing, changes it for another, and puts that down."""
    times = np.sort(rng.uniform(line.time[0], line.end, 3)).tolist()
    hands = [
        ((name, translation(*rng.uniform(-0.3, 0.3, 3)).tobytes()),) for name in ITEMS
    ]
    return list(zip([-np.inf, *times], [(), *hands, ()], strict=True))


def corners(q: Array, changes: list[HandChange], t: float) -> list[Array]:
    """Corners of all bodies of the rover, and of what it holds at ``t``, in the world."""
    poses = joint_poses_of(ROVER, q)
    out = [
        part.body.vertices @ pose[:3, :3].T + pose[:3, 3]
        for part, pose in ((p, poses[p.joint + 1]) for p in ROVER.model.parts)
    ]
    for name, kept in [hand for since, hand in changes if since <= t][-1]:
        pose = poses[-1] @ ROVER.model.flange @ pose_of(kept)
        out.append(ITEMS[name].shape.pieces[0].vertices @ pose[:3, :3].T + pose[:3, 3])
    return out


def item(name: str) -> CellObject:
    return ITEMS[name]


def anew(line: RobotTimeline, changes: list[HandChange], start: float) -> SweptTrack:
    """The oracle: all of the timeline is swept, and what ends before ``start`` left out."""
    pieces = cut_timeline(line, 0.0, np.inf, STEP, [t for t, _ in changes[1:]])
    return sweep_track(ROVER, pieces, changes, item).since(start)


@given(st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_boxes_hold_all_bodies_all_the_time(seed: int) -> None:
    rng = np.random.default_rng(seed)
    line = random_line(rng)
    changes = random_changes(rng, line)
    track = anew(line, changes, 0.0)
    sweeps = track.sweeps
    for k, (a, b) in enumerate(zip(track.pieces.start, track.pieces.end, strict=True)):
        # In a skill the hand changes within the piece's time, not within its motion.
        whole = bool(track.pieces.whole[k])
        for share in (0.01, 0.4, 0.99):
            t = a + share * (min(b, line.end + 1.0) - a)
            q_a, q_b = track.pieces.q_a[k], track.pieces.q_b[k]
            q = q_a + share * (q_b - q_a)
            if not whole:
                np.testing.assert_allclose(q, line.at(t), atol=1e-9)
            bodies = corners(q, changes, float(track.pieces.moment[k]) if whole else t)
            first = sweeps.body_first[k]
            assert sweeps.body_first[k + 1] - first == len(bodies)
            for n, found in enumerate(bodies):
                low, high = np.split(sweeps.body_box[first + n], 2)
                assert np.all(found >= low - 1e-9)
                assert np.all(found <= high + 1e-9)
                assert np.all(low >= sweeps.box[k, :3])
                assert np.all(high <= sweeps.box[k, 3:])


@given(st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_what_is_remembered_equals_what_is_worked_out_anew(seed: int) -> None:
    rng = np.random.default_rng(seed)
    memory = SweptTracks()
    lines = [random_line(rng) for _ in range(3)]
    changes = [random_changes(rng, line) for line in lines]
    for _ in range(12):
        k = int(rng.integers(3))
        line = lines[k]
        start = float(rng.uniform(line.time[0], line.end + 1.0))
        found = memory.since(start, ROVER, line, changes[k], item)
        wanted = anew(line, changes[k], start)
        assert [found.carriers[n].bodies.entities for n in found.hand] == [
            wanted.carriers[n].bodies.entities for n in wanted.hand
        ]
        # A stand that began before the cell of ``start`` is cut there, and a motion is not.
        assert found.pieces.start[0] <= start
        for one, other in zip(found.pieces, wanted.pieces, strict=True):
            np.testing.assert_allclose(one[1:], other[1:], atol=1e-9)
        ours, theirs = found.sweeps, wanted.sweeps
        np.testing.assert_allclose(ours.box, theirs.box, atol=1e-9)
        for first, *columns in (
            (ours.body_first, (ours.body_box, theirs.body_box)),
            (
                ours.capsule_first,
                (ours.capsule_a, theirs.capsule_a),
                (ours.capsule_b, theirs.capsule_b),
                (ours.radius, theirs.radius),
            ),
        ):
            for one, other in columns:
                assert first[-1] == len(one)
                np.testing.assert_allclose(one, other, atol=1e-9)


def test_another_hand_is_another_sweep() -> None:
    line = random_line(np.random.default_rng(1))
    changes = random_changes(np.random.default_rng(2), line)
    memory = SweptTracks()
    full = memory.since(0.0, ROVER, line, changes, item)
    bare = memory.since(0.0, ROVER, line, [(-np.inf, ())], item)
    assert len(full.carriers) > 1
    parts = len(ROVER.model.parts)
    assert [len(carrier.bodies.entities) for carrier in bare.carriers] == [parts]
