"""The MCAP file, read back by the package of others, tells of the run what its tables tell."""

import sys
from collections import defaultdict
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio
import pyarrow as pa
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.testing import assert_array_equal

from planning.cell.workcell import CellObject, Fixture
from planning.errors import OutputError
from planning.robots.registry import robot_model
from planning.transforms import Array, Indices, from_quat_wxyz, translation
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.driven_toys import driven_tpg
from tests.twin.exports.exported_runs import DISTURBED, exported, toy_run
from tests.twin.twin_toys import random_tpg
from twin.durations.nanoseconds import NANOSECONDS
from twin.exports.ros.mcap_file import _times
from twin.exports.segments import segments
from twin.recorders.run_tables import write_table
from twin.runs.trajectory import Trajectory
from twin.trial.run_result import RunResult
from twin.uncertainty.disturbances import Disturbances

Messages = dict[str, list[Any]]
MODELS = ("gp4", "mobile-manipulator")
RATE_HZ = 40.0
TRIANGLE_LIST, ADD, DELETE_ALL = 11, 0, 3


def with_real_robots(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    """Give the robots of a toy bodies, and one more brick."""
    robots = tuple(
        replace(robot, model=robot_model(name))
        for robot, name in zip(tpg.cell.robots, MODELS, strict=True)
    )
    brick = replace(tpg.cell.objects[0], name="another", start=translation(0, 0, 1))
    objects = (*tpg.cell.objects, brick)
    return replace(tpg, cell=replace(tpg.cell, robots=robots, objects=objects))


@pytest.fixture(scope="module", params=["limits", "full speed"])
def run(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> RunResult:
    smooth = request.param == "limits"
    make = driven_tpg if smooth else random_tpg
    tpg = with_real_robots(make(6, dofs=(6, 7), tasks=12, edges=20))
    folder = tmp_path_factory.mktemp("run")
    # Emergency stops in the middle of a skill are at once, within limits too.
    disturbances = Disturbances() if smooth else DISTURBED
    return toy_run(folder, 6, tpg=tpg, disturbances=disturbances)[0]


@pytest.fixture(scope="module")
def messages(run: RunResult) -> Messages:
    return read(exported(run, "mcap", rate_hz=RATE_HZ)["run.mcap"])


def read(data: bytes) -> Messages:
    """Return the decoded messages of every topic, with the times that they were logged at."""
    found = defaultdict(list)
    reader = make_reader(BytesIO(data), decoder_factories=[DecoderFactory()])
    for _, channel, message, decoded in reader.iter_decoded_messages():
        assert message.log_time == message.publish_time
        found[channel.topic].append(SimpleNamespace(t=message.log_time, m=decoded))
    return dict(found)


def stamp(header: Any) -> int:
    return int(header.stamp.sec * NANOSECONDS + header.stamp.nanosec)


def pose_of(transform: Any) -> Array:
    t, r = transform.translation, transform.rotation
    norm = np.linalg.norm([r.x, r.y, r.z, r.w])
    assert norm == pytest.approx(1.0, abs=1e-12)
    return from_quat_wxyz((t.x, t.y, t.z), (r.w, r.x, r.y, r.z))


class Frames:
    """Where frames are at a time: of each the last that was said of it."""

    def __init__(self, messages: Messages, t_ns: int) -> None:
        self._parents: dict[str, tuple[str, Array]] = {}
        said = [*messages["/tf_static"], *messages["/tf"]]
        for item in said:
            if item.t <= t_ns:
                for each in item.m.transforms:
                    frame = each.header.frame_id, pose_of(each.transform)
                    self._parents[each.child_frame_id] = frame

    def __getitem__(self, frame: str) -> Array:
        pose = np.eye(4)
        while frame != "world":
            frame, own = self._parents[frame]
            pose = own @ pose
        return pose

    def names(self) -> set[str]:
        return set(self._parents)


def links_by_pinocchio(robot: Any, q: Array) -> dict[str, Array]:
    """Where the links of a description are in the world, read and posed by pinocchio."""
    model = pinocchio.buildModelFromUrdf(str(robot.model.urdf))
    data = model.createData()
    full = pinocchio.neutral(model)
    for name, value in zip(robot.model.joint_names, q, strict=True):
        full[model.joints[model.getJointId(name)].idx_q] = value
    pinocchio.framesForwardKinematics(model, data, full)
    return {
        frame.name: robot.base @ data.oMf[k].homogeneous
        for k, frame in enumerate(model.frames)
        if frame.type == pinocchio.FrameType.BODY
    }


def full_seconds(run: RunResult) -> list[int]:
    """Times at which all robots say where they are: some at which an object is held, some others."""
    rows = run.objects.to_pylist()
    times = list(range(0, run.makespan_ns, NANOSECONDS))
    held = []
    for t_ns in times:
        parents = {r["object"]: r["parent"] for r in rows if r["t_s"] * 1e9 <= t_ns}
        if set(parents.values()) != {"world"}:
            held.append(t_ns)
    return sorted({*held[:: max(len(held) // 4, 1)], *times[:: len(times) // 4]})


def joint_states(messages: Messages, robot: str) -> tuple[list[Any], Indices, Array]:
    """The messages of where a robot's joints are, their times [ns], and the values [rad or m]."""
    said = messages[f"/{robot}/joint_states"]
    times, values = [item.t for item in said], [item.m.position for item in said]
    return said, np.array(times), np.array(values)


def test_joint_states_are_those_of_the_table(
    run: RunResult, messages: Messages
) -> None:
    for robot in run.tpg.cell.robots:
        motion = run.motions[robot.name]
        said, t_ns, q = joint_states(messages, robot.name)
        assert t_ns.tolist() == [stamp(item.m.header) for item in said]
        assert (t_ns[0], t_ns[-1]) == (0, motion.t_ns[-1])
        assert np.array_equal(q, motion.at(t_ns))
        assert {tuple(item.m.name) for item in said} == {robot.model.joint_names}
        v = np.array([item.m.velocity for item in said])
        if motion.v is None:
            assert v.size == 0
        else:
            assert np.array_equal(v, motion.states_at(t_ns)[1])
            assert np.max(np.abs(v)) > 0.1


def test_who_interpolates_sees_the_motion(run: RunResult, messages: Messages) -> None:
    """What is left out is nothing: robots stand, or move as straight as the rate lets them."""
    for robot in run.tpg.cell.robots:
        motion = run.motions[robot.name]
        _, t_ns, q = joint_states(messages, robot.name)
        fine = np.arange(0, motion.t_ns[-1], NANOSECONDS // 500)
        exact = motion.at(fine)
        seen = np.stack([np.interp(fine, t_ns, column) for column in q.T], axis=1)
        step = np.abs(np.diff(exact, axis=0)).max() * 500 / RATE_HZ
        assert np.max(np.abs(seen - exact)) <= step
        assert np.max(np.diff(t_ns)) <= NANOSECONDS
        assert len(t_ns) < len(np.arange(0, motion.t_ns[-1], NANOSECONDS / RATE_HZ))
        if motion.a is not None:
            bent = np.max(np.abs(motion.a)) / RATE_HZ**2 / 8.0
            assert np.max(np.abs(seen - exact)) <= bent + 1e-9


def test_links_are_where_pinocchio_puts_them(
    run: RunResult, messages: Messages
) -> None:
    compared = 0
    for t_ns in full_seconds(run):
        frames = Frames(messages, t_ns)
        for robot in run.tpg.cell.robots:
            q = run.motions[robot.name].at(np.array([t_ns]))[0]
            for link, pose in links_by_pinocchio(robot, q).items():
                found = frames[f"{robot.name}/{link}"]
                assert np.allclose(found, pose, rtol=0.0, atol=1e-9)
                compared += 1
    assert compared > 50


def test_objects_are_where_the_table_says(run: RunResult, messages: Messages) -> None:
    table = run.objects.to_pylist()
    held = 0
    for t_ns in full_seconds(run):
        frames = Frames(messages, t_ns)
        now = {
            row["object"]: row
            for row in table
            if round(row["t_s"] * NANOSECONDS) <= t_ns
        }
        for name, row in now.items():
            pose = from_quat_wxyz(row["xyz"], row["quat_wxyz"])
            if row["parent"] != "world":
                robot = run.tpg.cell.robot(row["parent"].removesuffix("/flange"))
                q = run.motions[robot.name].at(np.array([t_ns]))[0]
                links = links_by_pinocchio(robot, q)
                pose = links[robot.model.flange_link] @ pose
                held += 1
            assert np.allclose(frames[f"objects/{name}"], pose, rtol=0.0, atol=1e-9)
    assert held > 0


def test_who_joins_late_knows_all_after_a_second(
    run: RunResult, messages: Messages
) -> None:
    everything = Frames(messages, run.makespan_ns).names()
    late = [item for item in messages["/tf"] if item.t > 2 * NANOSECONDS]
    heard = {**messages, "/tf": late}
    assert Frames(heard, 3 * NANOSECONDS).names() == everything


def test_what_is_seen_hangs_on_frames_that_there_are(
    run: RunResult, messages: Messages
) -> None:
    frames = Frames(messages, run.makespan_ns)
    for topic in ("/robots", "/fixtures", "/objects"):
        (item,) = messages[topic]
        first, *markers = item.m.markers
        assert first.action == DELETE_ALL
        ids = [(marker.ns, marker.id) for marker in markers]
        assert len(set(ids)) == len(ids) > 0
        for marker in markers:
            assert (marker.type, marker.action) == (TRIANGLE_LIST, ADD)
            assert marker.frame_locked
            assert stamp(marker.header) == 0
            assert (marker.lifetime.sec, marker.lifetime.nanosec) == (0, 0)
            assert marker.scale.x == marker.scale.y == marker.scale.z == 1.0
            assert marker.color.a == 1.0
            assert len(marker.points) % 3 == 0
            assert np.isfinite(frames[marker.header.frame_id]).all()


def test_bodies_have_the_size_of_their_shapes(
    run: RunResult, messages: Messages
) -> None:
    cell = run.tpg.cell
    (shown,) = messages["/fixtures"]
    markers = {marker.ns: marker for marker in shown.m.markers[1:]}
    (others,) = messages["/objects"]
    markers |= {marker.ns: marker for marker in others.m.markers[1:]}
    items: list[Fixture | CellObject] = [*cell.fixtures, *cell.objects]
    for item in items:
        corners = points_of(markers[item.name])
        assert np.allclose(corners.max(axis=0), item.size / 2.0)
        assert np.allclose(corners.min(axis=0), -item.size / 2.0)
        assert volume(corners) == pytest.approx(np.prod(item.size))


def test_robots_look_as_large_as_they_are(run: RunResult, messages: Messages) -> None:
    """Boxes around what is seen and around what collides, of robots that have both alike."""
    robot = run.tpg.cell.robots[0]
    (shown,) = messages["/robots"]
    frames = Frames(messages, 0)
    seen = np.vstack(
        [
            points_of(m) @ (pose := frames[m.header.frame_id])[:3, :3].T + pose[:3, 3]
            for m in shown.m.markers[1:]
            if m.ns == robot.name
        ]
    )
    q = run.motions[robot.name].at(np.array([0]))[0]
    links = links_by_pinocchio(robot, q)
    names = ["base_link", *(f"link_{j}" for j in range(1, 7))]
    parts = np.vstack(
        [
            part.body.vertices @ (pose := links[names[part.joint + 1]])[:3, :3].T
            + pose[:3, 3]
            for part in robot.model.parts
        ]
    )
    # Polyhedra around round things are a little larger.
    for side in (np.min, np.max):
        assert np.allclose(side(seen, axis=0), side(parts, axis=0), rtol=0, atol=2e-3)


def points_of(marker: Any) -> Array:
    return np.array([[p.x, p.y, p.z] for p in marker.points])


def volume(corners: Array) -> float:
    """Six times it are the triple products of outward triangles."""
    a, b, c = corners.reshape(-1, 3, 3).transpose(1, 0, 2)
    return float(np.einsum("fx,fx->", np.cross(a, b), c) / 6.0)


def test_trajectories_are_the_segments(run: RunResult, messages: Messages) -> None:
    said: dict[str, list[Any]] = defaultdict(list)
    for robot in run.tpg.cell.robots:
        said[robot.name] += messages[f"/{robot.name}/joint_trajectory"]
    count = 0
    for segment in segments(run, RATE_HZ):
        begin = (segment.motion or segment.executed)[0]
        if begin < 0:
            continue
        item = next(s for s in said[segment.robot] if s.t == begin)
        said[segment.robot].remove(item)
        assert stamp(item.m.header) == begin
        assert tuple(item.m.joint_names) == segment.joint_names
        points = item.m.points
        assert np.array_equal([p.positions for p in points], segment.q)
        times = [p.time_from_start for p in points]
        t_ns = [t.sec * NANOSECONDS + t.nanosec for t in times]
        assert t_ns == segment.t_ns.tolist()
        for name, values in (("velocities", segment.v), ("accelerations", segment.a)):
            rates = [list(getattr(p, name)) for p in points]
            assert rates == ([[]] * len(points) if values is None else values.tolist())
        count += 1
    assert count > 5
    assert not any(said.values())


def test_the_file_says_what_it_is(run: RunResult) -> None:
    reader = make_reader(BytesIO(exported(run, "mcap")["run.mcap"]))
    assert reader.get_header().profile == "ros2"
    summary = reader.get_summary()
    assert summary is not None
    types = {
        "tf": "tf2_msgs/msg/TFMessage",
        "tf_static": "tf2_msgs/msg/TFMessage",
        "joint_states": "sensor_msgs/msg/JointState",
        "joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
        "robots": "visualization_msgs/msg/MarkerArray",
        "fixtures": "visualization_msgs/msg/MarkerArray",
        "objects": "visualization_msgs/msg/MarkerArray",
    }
    latched = {"/tf_static", "/robots", "/fixtures", "/objects"}
    seen = set()
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        last = channel.topic.rpartition("/")[2]
        assert (schema.name, schema.encoding) == (types[last], "ros2msg")
        assert channel.message_encoding == "cdr"
        (offer,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
        assert (offer["durability"] == 1) == (channel.topic in latched)
        assert offer["reliability"] == offer["history"] == 1
        seen.add(last)
    assert seen == set(types)


def test_objects_come_and_go(run: RunResult, tmp_path: Path) -> None:
    recorded, _ = toy_run(tmp_path, 6, tpg=run.tpg)
    first, second, *_ = (item.name for item in run.tpg.cell.objects)
    far = pytest.approx(np.array([0.0, 0.0, 1.0]))
    rows = [
        (0.0, first, "world", 0.0),
        (1.5, second, "world", 1.0),
        (2.25, first, "(gone)", 0.0),
    ]
    table = {
        "t_s": [row[0] for row in rows],
        "object": [row[1] for row in rows],
        "parent": [row[2] for row in rows],
        "xyz": [[0.0, 0.0, row[3]] for row in rows],
        "quat_wxyz": [[1.0, 0.0, 0.0, 0.0]] * 3,
    }
    write_table(tmp_path / "objects.parquet", pa.table(table))
    found = read(exported(recorded, "mcap")["run.mcap"])
    shown = [(s.t, [m.ns for m in s.m.markers[1:]]) for s in found["/objects"]]
    assert shown == [
        (0, [first]),
        (1_500_000_000, [first, second]),
        (2_250_000_000, [second]),
    ]
    told = {
        s.t
        for s in found["/tf"]
        for each in s.m.transforms
        if each.child_frame_id == f"objects/{first}"
    }
    assert told == {0, NANOSECONDS, 2 * NANOSECONDS}
    assert Frames(found, 2 * NANOSECONDS)[f"objects/{second}"][:3, 3] == far


def test_topics_have_names_that_ros_takes(run: RunResult, tmp_path: Path) -> None:
    tpg = run.tpg
    names = ("arm-1", "arm_1")
    robots = tuple(
        replace(robot, name=name)
        for robot, name in zip(tpg.cell.robots, names, strict=True)
    )
    chains = tuple(
        replace(chain, robot=name)
        for chain, name in zip(tpg.chains, names, strict=True)
    )
    handlings = tuple(
        replace(h, holder={"robot_0": "arm-1", "robot_1": "arm_1"}.get(h.holder or ""))
        for h in tpg.handlings
    )
    cell = replace(tpg.cell, robots=robots)
    renamed = replace(tpg, cell=cell, chains=chains, handlings=handlings)
    recorded, _ = toy_run(tmp_path, 6, tpg=renamed)
    topics = set(read(exported(recorded, "mcap")["run.mcap"]))
    assert {t for t in topics if t.endswith("joint_states")} == {
        "/arm_1/joint_states",
        "/arm_1_/joint_states",
    }


def test_without_the_package_the_extra_is_named(
    run: RunResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(OutputError, match=r"pip install 'assembly-twin\[mcap\]'"):
        exported(run, "mcap")


@pytest.mark.parametrize("rate_hz", [0.5, 1001.0, float("nan")])
def test_a_rate_out_of_range_is_refused(rate_hz: float, run: RunResult) -> None:
    with pytest.raises(OutputError, match="is not from 1 to 1000"):
        exported(run, "mcap", rate_hz=rate_hz)


def times_of_the_whole_grid(motion: Trajectory, rate_hz: float) -> Indices:
    """Return when something is said of a robot, by looking at every period of the run."""
    end = int(motion.t_ns[-1])
    count = int(end * rate_hz / NANOSECONDS) + 1
    grid = np.rint(np.arange(count) * (NANOSECONDS / rate_hz)).astype(np.int64)
    times = np.unique(np.append(grid[grid < end], [0, end]))
    moves = np.any(np.diff(motion.at(times), axis=0) != 0.0, axis=1)
    second = np.diff(times // NANOSECONDS, prepend=-1) > 0
    told: Indices = times[second | np.append(moves, True) | np.append(True, moves)]
    return told


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.floats(0.001, 3.0), st.booleans()), min_size=1, max_size=8),
    st.sampled_from([1.0, 7.0, 50.0]),
)
def test_what_stands_is_said_again_for_a_minute(
    spans: list[tuple[float, bool]], rate_hz: float
) -> None:
    def motion(stand: float) -> Trajectory:
        """Move and stand in turn, the longest at the end of a standstill of some seconds."""
        seconds = [0.0, *(s for s, _ in spans), stand, 1.0]
        ways = [0.0, *(float(moves) for _, moves in spans), 0.0, 1.0]
        t_ns = np.rint(np.cumsum(seconds) * NANOSECONDS).astype(np.int64)
        node = np.zeros(len(t_ns), dtype=np.int64)
        return Trajectory("arm", t_ns, np.cumsum(ways)[:, None], node)

    own = motion(20.0)
    assert_array_equal(_times(own, rate_hz), times_of_the_whole_grid(own, rate_hz))
    whole = times_of_the_whole_grid(motion(200.0), rate_hz)
    some = _times(motion(200.0), rate_hz)
    assert np.isin(some, whole).all()
    moved = motion(200.0).at(whole)
    changes = np.flatnonzero(np.any(np.diff(moved, axis=0) != 0.0, axis=1))
    assert np.isin(whole[[*changes, *(changes + 1)]], some).all()
    assert len(_times(motion(1e6), rate_hz)) <= len(_times(motion(100.0), rate_hz)) + 2
