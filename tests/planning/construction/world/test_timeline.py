"""Timelines, the fixed world made of them, and dropping ways out.

What robots sweep: against corners of their bodies, and remembered against worked out anew.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.workcell import CellObject
from planning.construction.motion_plan_export import _tasks_of
from planning.construction.world.fixed_world import FixedWorld, PlannedTask, SweptTracks
from planning.construction.world.timeline import (
    STEP,
    HandChange,
    ObjectTimeline,
    RobotTimeline,
    cut_timeline,
    decode_pose,
)
from planning.construction.world.tracks import SweptTrack, sweep_track
from planning.errors import PlanInvariantError
from planning.kinematics.kinematics import joint_poses_of
from planning.tasks.task import Handling, TaskKind
from planning.transforms import Array, translation
from tests.planning.construction.toy_tasks import state_at, with_task
from tests.planning.construction.toy_teams import box, placed, rover, slider, team


def line() -> RobotTimeline:
    return RobotTimeline("a", np.array([1.0, 3.0]), np.array([[0.0, 0.0], [1.0, 2.0]]))


def test_it_stands_before_and_after() -> None:
    assert line().at(-5.0).tolist() == [0.0, 0.0]
    assert line().at(2.0).tolist() == [0.5, 1.0]
    assert line().at(99.0).tolist() == [1.0, 2.0]


def test_it_goes_on_only_from_where_it_stands() -> None:
    with pytest.raises(PlanInvariantError, match="stands at"):
        line().then(np.array([2.0, 4.0]), np.array([[1.0, 2.0], [0.0, 0.0]]))
    with pytest.raises(PlanInvariantError, match="stands at"):
        line().then(np.array([3.0, 4.0]), np.array([[1.0, 0.0], [0.0, 0.0]]))
    longer = line().then(np.array([4.0, 5.0]), np.array([[1.0, 2.0], [0.0, 0.0]]))
    assert longer.at(3.5).tolist() == [1.0, 2.0]
    assert longer.end == longer.busy_until == 5.0


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_it_does_not_move_between_two_motions_by_a_rounding_error(seed: int) -> None:
    rng = np.random.default_rng(seed)
    there = rng.uniform(-3.0, 3.0, 4)
    own = RobotTimeline("a", np.array([0.0, 1.0]), np.array([np.zeros(4), there]))
    for begin in (1.0, 3.0 + rng.random()):
        off = there + rng.choice([0.0, 1e-15, 1e-12, 9e-7], 4) * rng.choice([-1, 1], 4)
        path = np.array([off, there, rng.uniform(-3.0, 3.0, 4)])
        longer = own.then(begin + np.array([0.0, 1.0, 2.0]), path)
        assert longer.path[-1].tolist() == path[-1].tolist()
        pieces = cut_timeline(longer, 1.0, np.inf, 0.1, [begin])
        stands = pieces.end <= begin + 1.0 + 1e-9
        assert np.array_equal(pieces.q_a[stands], pieces.q_b[stands])


def test_shapes_and_falling_times_are_refused() -> None:
    with pytest.raises(PlanInvariantError, match="fall"):
        RobotTimeline("a", np.array([1.0, 0.5]), np.zeros((2, 2)))
    with pytest.raises(PlanInvariantError, match="times for a path"):
        RobotTimeline("a", np.array([1.0]), np.zeros((2, 2)))


def test_a_way_out_is_dropped_for_new_work_and_work_is_not() -> None:
    cell = team([placed("a", slider(), (0.0, 0.0))])
    work = PlannedTask("a", TaskKind.TRANSIT, [0.0, 1.0], [[0, 0], [0.5, 0]], 1, "work")  # type: ignore[arg-type]
    out = PlannedTask(
        "a",
        TaskKind.TRANSIT,
        np.array([1.0, 3.0]),
        np.array([[0.5, 0.0], [1.5, 0.0]]),
        1,
        "out",
    )
    world = with_task(with_task(FixedWorld(cell), work), out, work=False)
    assert world.end == 3.0
    assert world.free_from("a") == 1.0
    assert world.without_retreat("a").robots["a"].at(9.0).tolist() == [0.5, 0.0]
    assert world.robots["a"].at(9.0).tolist() == [1.5, 0.0]


def test_objects_change_hands_in_order() -> None:
    cell = team(
        [placed("a", slider(), (0.0, 0.0))],
        objects=(box("b", (0.1, 0.1, 0.1), (1.0, 0.0, 0.05)),),
    )
    pick = PlannedTask(
        "a",
        "pick",
        np.array([0.0, 1.0]),
        np.zeros((2, 2)),
        1,
        "pick",
        "b",
        (Handling("b", 1, "a", translation(1.0, 0.0, -0.2)),),
    )
    world = with_task(FixedWorld(cell), pick)
    assert state_at(world, 0.5).attachments["b"].holder is None
    assert state_at(world, 1.0).attachments["b"].holder == "a"
    assert world.robots["a"].skills == ((0.0, 1.0),)
    with pytest.raises(PlanInvariantError, match="before its last"):
        world.objects["b"].then(0.5, None, np.eye(4))
    assert ObjectTimeline("b").at(3.0) is None


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_pieces_follow_the_timeline_without_gaps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 8))
    time = np.cumsum(rng.uniform(0.01, 0.9, count))
    path = rng.normal(size=(count, 2))
    stand = rng.random(count) < 0.3
    for k in range(1, count):
        if stand[k]:
            path[k] = path[k - 1]
    k = int(rng.integers(count - 1))
    whole = RobotTimeline("a", time, path, ((float(time[k]), float(time[k + 1])),))
    begin = float(rng.uniform(0.0, time[-1]))
    changes = [float(rng.uniform(0.0, time[-1] + 1.0))]
    pieces = cut_timeline(whole, begin, np.inf, 0.25, changes)
    assert np.array_equal(pieces.q_a[1:], pieces.q_b[:-1])
    assert pieces.end[-1] == np.inf
    assert pieces.start[0] <= begin + 1e-9
    for i in range(len(pieces.start)):
        a, b = pieces.start[i], pieces.end[i]
        if pieces.whole[i]:
            assert (a, b) == whole.skills[0]
            continue
        assert np.allclose(pieces.q_a[i], whole.at(a))
        assert np.allclose(pieces.q_b[i], whole.at(min(b, 1e6)))
        if np.any(pieces.q_a[i] != pieces.q_b[i]):
            middle = 0.5 * (a + b)
            assert np.allclose(whole.at(middle), (pieces.q_a[i] + pieces.q_b[i]) / 2)
            # Within one cell of time.
            assert np.floor(a / 0.25 + 1e-6) == np.ceil(b / 0.25 - 1e-6) - 1
        if i:
            assert a == pytest.approx(pieces.end[i - 1], abs=1e-9)
        if np.isfinite(b) and a < changes[0] - 1e-6:
            assert b <= changes[0] + 1e-6 or np.any(pieces.q_a[i] != pieces.q_b[i])


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
        pose = poses[-1] @ ROVER.model.flange @ decode_pose(kept)
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
            np.testing.assert_allclose(
                np.asarray(one)[1:], np.asarray(other)[1:], atol=1e-9
            )
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


def test_tracks_of_several_robots_are_joined_once() -> None:
    rng, memory = np.random.default_rng(3), SweptTracks()
    lines = [random_line(rng) for _ in range(3)]
    robots = [(ROVER, line, random_changes(rng, line)) for line in lines]
    carriers, tracks = memory.joined(0.0, robots[:2], item)
    assert memory.joined(0.0, robots[:2], item)[1] is tracks
    swept = [memory.since(0.0, *robot, item) for robot in robots[:2]]
    assert len(carriers) == sum(len(s.carriers) for s in swept)
    assert np.diff(tracks.first).tolist() == [len(s.hand) for s in swept]
    for others in (robots[1:], robots[:1], robots[1::-1]):
        assert memory.joined(0.0, others, item)[1] is not tracks


def test_rests_follow_the_skills_of_who_held_the_object() -> None:
    # Worlds made from one another remember what was worked out before.
    parts = (box("a", (0.1, 0.1, 0.1), (0.0, 0.0, 0.0)),)
    fixed = FixedWorld(team([ROVER], objects=parts))
    held = ObjectTimeline("a").then(2.0, ROVER.name, np.eye(4))
    for end in (3.0, 4.0, 3.0):
        stand = np.tile(ROVER.home, (3, 1))
        line = RobotTimeline(
            ROVER.name, np.array([0.0, 1.0, end]), stand, ((1.0, end),)
        )
        (rest,) = fixed.with_robot(line).with_object(held).rests("a")
        assert rest.end == end


def test_another_hand_is_another_sweep() -> None:
    line = random_line(np.random.default_rng(1))
    changes = random_changes(np.random.default_rng(2), line)
    memory = SweptTracks()
    full = memory.since(0.0, ROVER, line, changes, item)
    bare = memory.since(0.0, ROVER, line, [(-np.inf, ())], item)
    assert len(full.carriers) > 1
    parts = len(ROVER.model.parts)
    assert [len(carrier.bodies.entities) for carrier in bare.carriers] == [parts]


@given(st.integers(1, 400), st.integers(-3, 3), st.booleans())
@settings(max_examples=60, deadline=None)
def test_a_stand_that_begins_a_rounding_error_off_the_grid_is_a_stand(
    cell: int, ulps: int, changes: bool
) -> None:
    """It belongs to the tasks before and after it, whose contacts it may make."""
    arrival = cell * STEP
    for _ in range(abs(ulps)):
        arrival = float(np.nextafter(arrival, np.inf if ulps > 0 else -np.inf))
    end = arrival + 4.0
    there, home = np.array([[1.1, -0.7]]), np.zeros((1, 2))
    own = RobotTimeline(
        "a", np.array([arrival - 0.03, arrival]), np.vstack([home, there])
    )
    own = own.then(np.array([arrival, end]), np.vstack([there, there]))
    own = own.then(np.array([end, end + 1.0]), np.vstack([there, home]))
    tasks = [
        PlannedTask(
            "a", TaskKind.TRANSIT, np.array(span), np.vstack([home, there]), k, "on"
        )
        for k, span in enumerate([(arrival - 0.03, arrival), (end, end + 1.0)], start=1)
    ]
    given_times = [arrival - 0.03, arrival, end, end + 1.0]
    given_times += [arrival + 3.9] * changes
    pieces = cut_timeline(own, 0.0, np.inf, STEP, sorted(given_times))
    stand = (pieces.start >= arrival - 1e-6) & (pieces.end <= end + 1e-6)
    owners = _tasks_of(pieces, tasks, [0, 1])
    assert stand.sum() >= 1 + changes
    assert {tuple(own) for own in owners[stand].tolist()} == {(0, 1)}
