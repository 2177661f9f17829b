"""Limits of motion and order of nodes: what keeps them passes, whatever is planted is found, and only that."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from planning.cell.motion_limits import MotionLimits
from planning.cell.workcell import Workcell
from planning.errors import OutputError
from planning.transforms import Array
from scheduling.witness.robot import JointLimits
from tests.twin.audits.audit_cell import HandWrittenRun, two_arm_cell
from tests.twin.audits.swings import jerked, swing
from tests.twin.driven_toys import driven_tpg
from tests.twin.simulated import simulate
from tests.twin.twin_toys import toy_cell
from twin.audits.audit import audit_run
from twin.audits.case import Violation
from twin.audits.joint_limits import joint_violations
from twin.audits.motion.executed import Recording, ReplayedRun, RobotRows
from twin.audits.motion_limits import limit_violations
from twin.durations.measured import packaged_timings
from twin.durations.nanoseconds import NANOSECONDS
from twin.runs.trajectory import robot_trajectories
from twin.uncertainty.disturbances import Disturbances, EmergencyStop, Stalls
from twin.uncertainty.skill_durations import SkillDurations

CALM = Disturbances()
KINDS = ("joint-speed", "joint-acceleration", "joint-jerk")
UNITS = {"joint-speed": "", "joint-acceleration": "^2", "joint-jerk": "^3"}
KEYS = ("velocity", "acceleration", "jerk")


def found_in(cell: Workcell, rows: Mapping[str, RobotRows]) -> list[Violation]:
    end = max(float(r.t[-1]) for r in rows.values())
    return list(limit_violations(ReplayedRun(cell, Recording(rows, (), end))))


def executed(
    seed: int, disturbances: Disturbances = CALM, jerk: float | None = None
) -> tuple[Workcell, dict[str, RobotRows]]:
    """A made-up run of robots within limits, as its table tells it."""
    tpg = driven_tpg(seed, tasks=10, edges=20, jerk=jerk)
    times = SkillDurations(packaged_timings())
    run = simulate(tpg, times, seed=seed, disturbances=disturbances)
    rows = {
        m.robot: RobotRows(m.t_ns / NANOSECONDS, m.q, m.node, m.v, m.a)
        for m in robot_trajectories(tpg, run)
    }
    return tpg.cell, rows


STALLED = Disturbances(stalls=Stalls(count_per_robot=3))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_runs_within_limits_pass(seed: int) -> None:
    for disturbances in (CALM, STALLED):
        assert found_in(*executed(seed, disturbances)) == []


@pytest.mark.parametrize("jerk", [5e4, 1e6])
def test_runs_pass_whatever_the_scale_of_their_limits(jerk: float) -> None:
    """Accelerations build up within microseconds, of which a nanosecond is not little."""
    for seed in range(6):
        assert found_in(*executed(seed, STALLED, jerk)) == []


@pytest.mark.parametrize(
    ("jerk", "number"),
    [(j, k) for j in (5e4, 1e6) for k in range(3) if (j, k) != (1e6, 2)],
)
def test_what_is_beyond_a_limit_is_found_at_any_scale(jerk: float, number: int) -> None:
    """By a ten thousandth; of a jerk of 1e6 ten microseconds of whole nanoseconds tell no more."""
    cell, rows = executed(1, STALLED, jerk)
    robot, own = cell.robots[0], rows["robot_0"]
    assert own.v is not None
    assert own.a is not None
    assert robot.limits is not None
    long = np.diff(own.t) > 1e-5
    jerks = np.abs(np.diff(own.a, axis=0)) / np.diff(own.t)[:, None]
    told = [np.abs(own.v), np.abs(own.a), jerks[long]]
    most = told[number].max(axis=0)
    joint = int(np.argmax(most))
    limit = np.array(getattr(robot.limits, KEYS[number]))
    limit[joint] = most[joint] / 1.00012
    changes: dict[str, Any] = {KEYS[number]: limit}
    tight = replace(robot.limits, **changes)
    found = found_in(limited(cell, tight), {"robot_0": own})
    seen = {(v.kind, v.second) for v in found}
    assert seen == {(KINDS[number], robot.model.joint_names[joint])}
    for v in found:
        said, limited_to = v.detail.split(", its limit is ")
        assert float(said.split()[0]) > float(limited_to.split()[0])


def test_an_acceleration_that_is_there_at_once_is_found() -> None:
    """Within a nanosecond, in a motion whose positions and speeds fit it."""
    t = np.array([0.0, 0.5, 0.5 + 1e-9, 1.0])
    a = np.array([[0.0], [0.0], [9.0], [9.0]])
    since = np.maximum(t - 0.5, 0.0)[:, None]
    rows = RobotRows(t, 4.5 * since**2, np.arange(4), 9.0 * since, a)
    limits = MotionLimits(np.array([10.0]), np.array([10.0]), np.array([1e6]))
    (found,) = found_in(limited(toy_cell([1]), limits), {"robot_0": rows})
    assert found.kind == "joint-jerk"
    assert found.detail.startswith("9e+09 rad/s^3, its limit is 1e+06 rad/s^3")


def made(seed: int, joints: int = 2) -> RobotRows:
    """A motion of random jerks, each constant for a while, from rest; times are nanoseconds.

    Accelerations are known to a millionth of their limit: a jerk that lasts shorter is known less exactly
    than to the ten thousandth by which limits are exceeded here.
    """
    rng = np.random.default_rng(seed)
    span = rng.integers(5 * 10**7, 10**9, 12) / NANOSECONDS
    return jerked(span, rng.uniform(-5.0, 5.0, (len(span), joints)))


def greatest(rows: RobotRows) -> dict[str, Array]:
    """Greatest speed, acceleration and jerk of each joint, by looking very often."""
    assert rows.v is not None
    assert rows.a is not None
    tops = {kind: np.zeros(rows.q.shape[1]) for kind in KINDS}
    for k, h in enumerate(np.diff(rows.t)):
        s = np.linspace(0.0, h, 4001)[:, None]
        jerk = (rows.a[k + 1] - rows.a[k]) / h
        found = (
            rows.v[k] + s * rows.a[k] + s * s * jerk / 2.0,
            rows.a[k] + s * jerk,
            jerk[None],
        )
        for kind, values in zip(KINDS, found, strict=True):
            tops[kind] = np.maximum(tops[kind], np.abs(values).max(axis=0))
    return tops


def limited(cell: Workcell, limits: MotionLimits) -> Workcell:
    return replace(cell, robots=(replace(cell.robots[0], limits=limits),))


@settings(max_examples=60, deadline=None)
@example(13625, "joint-acceleration", 0, 0.9999)
@given(
    st.integers(0, 10**6),
    st.sampled_from(KINDS),
    st.integers(0, 1),
    st.sampled_from([0.9999, 1.0001]),
)
def test_a_limit_is_exceeded_where_looking_often_says_so(
    seed: int, kind: str, joint: int, share: float
) -> None:
    """A limit a little under or over the greatest value that there is."""
    rows = made(seed)
    tops = greatest(rows)
    wide = {name: top * 1.01 for name, top in tops.items()}
    wide[kind][joint] = tops[kind][joint] * share
    speed, acceleration, jerk = (wide[name] for name in KINDS)
    limits = MotionLimits(speed, acceleration, jerk)
    cell = limited(toy_cell([2]), limits)
    found = found_in(cell, {"robot_0": rows})
    seen = {(v.kind, v.first, v.second) for v in found}
    assert seen == ({(kind, "robot_0", f"joint_{joint}")} if share < 1.0 else set())
    # It may be exceeded more than once, by the greatest value in one of them.
    top, limit = tops[kind][joint], wide[kind][joint]
    told = [float(v.detail.split()[0]) for v in found]
    assert not found or max(told) == float(f"{top:.6g}")
    for v in found:
        assert f" rad/s{UNITS[kind]}, its limit is {limit:.6g} rad/s" in v.detail
        assert 0.0 <= v.t_start < v.t_end <= rows.t[-1]


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from("qva"),
    st.integers(1, 11),
    st.sampled_from([1e-4, -1e-3]),
)
def test_columns_that_do_not_fit_are_found(
    seed: int, column: str, row: int, change: float
) -> None:
    rows = made(seed)
    values = np.array(getattr(rows, column))
    values[row, 1] += change
    wide = np.full(2, np.inf)
    cell = limited(toy_cell([2]), MotionLimits(wide, wide, wide))
    assert found_in(cell, {"robot_0": rows}) == []
    changes: dict[str, Any] = {column: values}
    (found,) = found_in(cell, {"robot_0": replace(rows, **changes)})
    assert (found.kind, found.second) == ("joint-motion", "joint_1")
    assert found.t_start == pytest.approx(rows.t[row - 1])
    assert found.t_end == pytest.approx(rows.t[row + 1])


def test_a_run_that_is_played_faster_breaks_its_limits() -> None:
    cell, rows = executed(8)
    quick = {
        name: RobotRows(r.t / 1.001, r.q, r.node, r.v * 1.001, r.a * 1.001**2)
        for name, r in rows.items()
        if r.v is not None and r.a is not None
    }
    kinds = {v.kind for v in found_in(cell, quick)}
    assert {"joint-acceleration", "joint-jerk"} <= kinds
    assert "joint-motion" not in kinds


def test_a_table_without_speeds_is_no_motion_within_limits() -> None:
    cell, rows = executed(8)
    bare = {name: replace(r, v=None, a=None) for name, r in rows.items()}
    assert {v.kind for v in found_in(cell, bare)} == {"joint-motion"}
    free = replace(cell, robots=tuple(replace(r, limits=None) for r in cell.robots))
    assert found_in(free, bare) == []


def test_robots_that_the_clock_stops_brake_within_limits() -> None:
    """Also in the middle of skills; most of the runs are later than without stops."""
    later = 0
    stops = tuple(
        EmergencyStop(robot="robot_1", at_s=at, duration_s=1.5)
        for at in (3.0, 8.0, 13.0, 18.0)
    )
    for seed in range(12):
        cell, rows = executed(seed, Disturbances(emergency_stops=stops))
        _, calm = executed(seed)
        later += bool(rows["robot_1"].t[-1] > calm["robot_1"].t[-1])
        assert found_in(cell, rows) == []
    assert later > 6


@pytest.mark.parametrize(
    ("joint", "lowered", "kinds"),
    [
        (0, None, []),
        (0, "velocity", ["joint-speed"]),
        (1, "acceleration", ["joint-acceleration"]),
        (1, "jerk", ["joint-jerk"]),
    ],
)
def test_the_audit_of_a_run_holds_it_to_its_limits(
    joint: int, lowered: str | None, kinds: list[str], tmp_path: Path
) -> None:
    cell = two_arm_cell()
    limits = MotionLimits(np.full(6, 1.0), np.full(6, 4.0), np.full(6, 40.0))
    tops = {"velocity": 0.225, "acceleration": 1.5, "jerk": 10.0}
    if lowered is not None:
        tight = np.array(getattr(limits, lowered))
        tight[joint] = tops[lowered] / 1.00001
        changes: dict[str, Any] = {lowered: tight}
        limits = replace(limits, **changes)
    left, right = (replace(robot, limits=limits) for robot in cell.robots)
    run = HandWrittenRun(replace(cell, robots=(left, right)))
    rows = swing(10.0, 0.15, np.eye(6)[joint], left.home)
    run.move("left", rows.t, rows.q)
    folder = run.write(tmp_path)
    table = pq.read_table(folder / "trajectory.parquet")
    for name, values in (("v", rows.v), ("a", rows.a)):
        assert values is not None
        for j in range(6):
            table = table.append_column(f"{name}_{j}", pa.array(values[:, j]))
    pq.write_table(table, folder / "trajectory.parquet")
    found = audit_run(folder).violations
    assert [v.kind for v in found] == kinds
    for violation in found:
        assert violation.first == "left"
        assert violation.second == left.model.joint_names[joint]
        said, limited_to = violation.detail.split(", its limit is ")
        assert float(said.split()[0]) > float(limited_to.split()[0])


MODEL = two_arm_cell().robot("left").model


def turning(joint: int, values: list[float]) -> Array:
    """Configurations of ``left``, HOME but for one joint."""
    path = np.repeat(MODEL.home[None], len(values), axis=0)
    path[:, joint] += values
    return path


def test_a_joint_beyond_its_limit(tmp_path: Path) -> None:
    beyond = MODEL.upper[0] + 0.01
    run = HandWrittenRun(two_arm_cell())
    times = [0.0, 5.0, 10.0, 15.0]
    run.move("left", times, turning(0, [0.0, 0.1, 0.1, 0.0]))
    folder = run.write(tmp_path)
    rows = pq.read_table(folder / "trajectory.parquet")
    q = pa.array([0.0, beyond, beyond, 0.0])
    rows = rows.set_column(rows.column_names.index("q_0"), "q_0", q)
    pq.write_table(rows, folder / "trajectory.parquet")
    (found,) = audit_run(folder).violations
    who = found.kind, found.first, found.second
    assert who == ("joint-limit", "left", MODEL.joint_names[0])
    assert (found.t_start, found.t_end) == (5.0, 10.0)
    assert f"{beyond:.6g} rad, its limit is {MODEL.upper[0]:.6g} rad" in found.detail


@pytest.mark.parametrize(("share", "kinds"), [(1.0, []), (1.001, ["joint-speed"])])
def test_a_joint_that_is_faster_than_it_may_be(
    tmp_path: Path, share: float, kinds: list[str]
) -> None:
    run = HandWrittenRun(two_arm_cell())
    seconds = 0.5 / MODEL.velocity[0] / share
    run.move("left", [0.0, 1.0, 1.0 + seconds, 5.0], turning(0, [0.0, 0.0, -0.5, -0.5]))
    found = audit_run(run.write(tmp_path)).violations
    assert [v.kind for v in found] == kinds
    for v in found:
        assert (v.first, v.second) == ("left", MODEL.joint_names[0])
        assert (v.t_start, v.t_end) == pytest.approx((1.0, 1.0 + seconds))
        limit = MODEL.velocity[0]
        said = f"{1.001 * limit:.6g} rad/s, its limit is {limit:.6g} rad/s"
        assert v.detail.startswith(said)


@pytest.mark.parametrize(
    ("edge", "kinds"), [((0, 0, 1, 1), []), ((0, 1, 1, 1), ["edge-order"])]
)
def test_a_node_that_moves_before_what_it_waits_for_is_over(
    tmp_path: Path, edge: tuple[int, int, int, int], kinds: list[str]
) -> None:
    """The right robot begins its node 1 when the left one ends its node 0, not its node 1."""
    run = HandWrittenRun(two_arm_cell())
    run.edges = [edge]
    run.move("left", [0.0, 4.0, 8.0], turning(0, [0.0, -0.1, -0.2]))
    run.move("right", [0.0, 4.0, 8.0], turning(0, [0.0, 0.1, 0.2]))
    found = audit_run(run.write(tmp_path)).violations
    assert [v.kind for v in found] == kinds
    for v in found:
        assert (v.first, v.second, v.t_start, v.t_end) == ("left", "right", 4.0, 8.0)
        assert "node 1 began before node 1 of left was over" in v.detail
    assert audit_run(tmp_path, ordered=False).violations == ()


def test_the_log_is_held_to_the_edges_too(tmp_path: Path) -> None:
    """In the trajectory nobody moves, so only the log says who began when."""
    run = HandWrittenRun(two_arm_cell())
    run.edges = [(0, 0, 1, 0)]
    for robot in ("left", "right"):
        run.move(robot, [0.0, 5.0], turning(0, [0.0, 0.0]))
    line = '{{"t_s": {}, "robot": "{}", "kind": "{}", "task": 0, "node": 0}}\n'
    kept = [
        line.format("0.000000000", "left", "started"),
        line.format("2.000000000", "left", "completed"),
        line.format("2.000000000", "right", "started"),
    ]
    log = run.write(tmp_path) / "events.jsonl"
    log.write_text("".join(kept))
    assert audit_run(tmp_path).violations == ()
    log.write_text(
        "".join(kept).replace('2.000000000, "robot": "right"', '1.9, "robot": "right"')
    )
    (found,) = audit_run(tmp_path).violations
    assert (found.kind, found.t_start, found.t_end) == ("edge-order", 1.9, 2.0)
    assert "events.jsonl" in found.detail
    log.write_text(kept[0] + kept[2])
    (found,) = audit_run(tmp_path).violations
    assert "never was" in found.detail
    log.write_text(kept[0].replace("left", "nobody"))
    with pytest.raises(OutputError, match=r"events\.jsonl:1"):
        audit_run(tmp_path)


# What was measured


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1.0, 1.3]),
    st.sampled_from([0.002, 0.01, 0.03]),
)
def test_of_what_was_measured_times_are_not_exact(
    seed: int, speed: float, period_s: float
) -> None:
    """Positions at times that are wrong by up to 10 ms: at the limit nothing is found, 30 % beyond it is."""
    rng = np.random.default_rng(seed)
    at = np.arange(0.0, 3.0, period_s)
    q = np.clip(at - 1.0, 0.0, 0.8)[:, None] * speed
    told = np.maximum.accumulate(at + rng.uniform(-0.01, 0.01, len(at)))
    rows = {"arm": RobotRows(told, q, np.zeros(len(at), np.int64))}
    one = np.ones(1)
    limits = {"arm": JointLimits(("joint",), -10 * one, 10 * one, one, ("rad",))}
    found = list(joint_violations(rows, limits, {"arm"}))
    assert bool(found) == (speed > 1.0)
    assert all(
        v.kind == "joint-speed" and v.t_start < 1.8 < v.t_end + 0.8 for v in found
    )


def test_a_jump_of_what_was_measured_is_found() -> None:
    t, one = np.linspace(0.0, 1.0, 101), np.ones(1)
    limits = {"arm": JointLimits(("joint",), -10 * one, 10 * one, one, ("rad",))}
    for far, jumps in ((0.025, False), (0.04, True)):
        q = np.where(t > 0.5, far, 0.0)[:, None]
        rows = {"arm": RobotRows(t, q, np.zeros(len(t), np.int64))}
        assert bool(list(joint_violations(rows, limits, {"arm"}))) == jumps
        assert list(joint_violations(rows, limits))
