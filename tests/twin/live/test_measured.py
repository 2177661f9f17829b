"""What is measured: samples that were lost, against an arm that was watched all the time, and rows of one that stands."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from planning.motion.near_path import nearest_points_on_path
from twin.drivers.driver import ClearedNode, Sample
from twin.drivers.simulated_arm import SimulatedArm
from twin.live.lost_samples import samples_between
from twin.live.measured_log import MeasuredLog
from twin.live.measured_rows import MeasuredRows

EVERY_S = 0.01


def some_nodes(rng: np.random.Generator) -> list[ClearedNode]:
    nodes = []
    for k in range(rng.integers(2, 7)):
        count = rng.integers(1, 4)
        corners = rng.uniform(-1.0, 1.0, (count, 2))
        seconds = np.cumsum(rng.uniform(0.1, 0.6, count))
        nodes.append(ClearedNode(k, k, "transit", "go", corners, seconds))
    return nodes


@given(st.integers(0, 2**32 - 1))
def test_what_nobody_heard_of_is_where_the_path_leads(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nodes, start = some_nodes(rng), np.zeros(2)
    whole_s = sum(float(node.seconds[-1]) for node in nodes)
    now = 0.0
    arm = SimulatedArm(lambda: now)
    arm.begin(start, 0)
    cleared_s = np.sort(rng.uniform(0.0, whole_s, len(nodes)))
    given_to, seen = 0, list[tuple[int, Sample]]()
    while now < 2 * whole_s + 0.5:
        more = [n for n in nodes[given_to:] if cleared_s[n.node] <= now]
        arm.take(more)
        given_to += len(more)
        seen += [(round(s.at_s * 1e9), s) for s in arm.state().samples]
        now += EVERY_S
    begin_s = rng.uniform(0.0, now)
    end_s = begin_s + rng.uniform(0.12, now)
    kept = [own for own in seen[:-1] if not begin_s < own[1].at_s < end_s] + seen[-1:]

    rows = MeasuredRows()
    rows.cleared_ns = [round(t * 1e9) for t in cleared_s]
    for t_ns, sample in kept:
        if rows.last is not None and rows.is_new(sample):
            path = nodes, rows.cleared_ns, start
            for own in samples_between(rows.last, (t_ns, sample), *path):
                assert rows.add(*own)
        rows.add(t_ns, sample)
    found = rows.measured()
    # No corner is cut, and of no node is missing when it was passed.
    line = found.q[np.r_[True, np.any(np.diff(found.q, axis=0), axis=1)]]
    off = nearest_points_on_path(line, np.array([s.q for _, s in seen])).off
    assert off.max() < 1e-6
    assert np.all(np.diff(found.t_ns) >= 0)
    assert len(rows.end_ns) == len(nodes)
    assert all(b >= c for b, c in zip(rows.begin_ns, rows.cleared_ns, strict=True))


def test_a_driver_with_another_clock_goes_on() -> None:
    rows = MeasuredRows()
    rows.cleared_ns = [0, 0]
    assert rows.add(10, Sample(1000.0, np.array([0.5]), 1, 0))
    assert not rows.add(10, Sample(1000.0, np.array([0.5]), 1, 0))
    # The machine of the driver was started anew, and counts from zero.
    assert rows.add(20, Sample(1.0, np.array([1.0]), 1, 1))
    assert rows.end_ns == [20]


def test_a_robot_that_settles_while_it_stands_has_not_begun_its_next_node() -> None:
    rows = MeasuredRows()
    rows.cleared_ns = [0, 0]
    told = [
        (0, 0.0, 0, 0),
        (10, 0.0, 1, 0),
        (20, 1.0, 1, 1),
        (30, 1.001, 1, 1),
        (40, 1.002, 1, 1),
        (50, 1.1, 2, 1),
        (60, 2.0, 2, 2),
    ]
    for t_ns, q, begun, done in told:
        rows.add(t_ns, Sample(t_ns / 1e9, np.array([q]), begun, done))
    found = rows.measured()
    second = found.t_ns[found.node == 1]
    # Its first row is the last one of standing, where nothing moves between the two nodes.
    assert second.min() == 40
    assert rows.begin_ns == [10, 50]
    at = np.flatnonzero(found.t_ns == 40)
    assert found.node[at].tolist() == [0, 1]
    assert np.ptp(found.q[at]) == 0.0


def test_of_a_standstill_the_first_and_the_last_sample_are_written(
    tmp_path: Path,
) -> None:
    """Also of one in the middle of a node; nothing else is left out."""
    clear, at_s = np.array([0.3, 0.4]), itertools.count()
    moves = [Sample(next(at_s), clear * k, 1, 0) for k in range(5)]
    held = [Sample(next(at_s), clear * 5, 1, 0) for _ in range(1000)]
    ends = [Sample(next(at_s), clear * 6, 1, 1)]
    noise = np.random.default_rng(0).normal(0.0, 1e-5, (1000, 2))
    stands = [Sample(next(at_s), clear * 6 + off, 1, 1) for off in noise]
    begins = [Sample(next(at_s), clear * 6, 2, 1)]
    rows, log = MeasuredRows(), MeasuredLog(tmp_path / "measured.csv")
    given = [*moves, *held, *ends, *stands, *begins]
    for k, own in enumerate(given):
        if rows.add(k, own):
            log.write("left", k, own)
    rests = [Sample(next(at_s), clear * 7, 2, 2) for _ in range(1000)]
    for own in rests:
        log.write("left", round(own.at_s), own)
    log.close()
    written = [
        own.at_s
        for _, _, own in MeasuredLog(tmp_path / "measured.csv").before({"left": (2, 2)})
    ]
    kept = [*moves, held[0], held[-1], *ends, stands[-1], *begins, rests[0], rests[-1]]
    assert written == [own.at_s for own in kept]
    assert len(rows.t_ns) == len(moves) + 2 + 1 + 2 + 1
    again = MeasuredRows()
    for _, t_ns, own in MeasuredLog(tmp_path / "measured.csv").before({"left": (2, 2)}):
        again.add(t_ns, own)
    assert again.t_ns[: len(rows.t_ns)] == rows.t_ns


GOOD = "left,5,0.5,1,0,0.1,0.2,;\n"


@pytest.mark.parametrize(
    "line",
    [
        "right,5,0.5,1,0,0.1,0.2",  # a robot that nobody moves
        "left,5,0.5,1,0,0.1",  # one joint of two
        "left,5,0.5,3,0,0.1,0.2",  # a node that was not released
        "left,5,0.5,0,1,0.1,0.2",
        "left,5,0.5,1,-1,0.1,0.2",
        "left,5,nan,1,0,0.1,0.2",
        "left,5,0.5,1,0,0.1,inf",
        "left,-1,0.5,1,0,0.1,0.2",
        f"left,{10**30},0.5,1,0,0.1,0.2",
        f"left,{'9' * 5000},0.5,1,0,0.1,0.2",
        "left,5,0.5,1,x,0.1,0.2",
        "left,\ud800".encode("utf-8", "surrogatepass").decode("latin-1"),
        "",
    ],
)
def test_a_line_that_is_no_sample_is_left_out(tmp_path: Path, line: str) -> None:
    path = tmp_path / "measured.csv"
    path.write_text(f"{GOOD}{line},;\n{GOOD}", encoding="latin-1")
    found = list(MeasuredLog(path).before({"left": (2, 2)}))
    assert [(robot, t_ns) for robot, t_ns, _ in found] == [("left", 5)] * 2


def test_samples_after_a_line_that_was_cut_off_are_read(tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    path.write_text(GOOD + "left,6,0.6,1,0,0.")
    log = MeasuredLog(path)
    log.write("left", 7, Sample(0.7, np.array([0.3, 0.4]), 1, 0))
    log.close()
    assert [t for _, t, _ in log.before({"left": (2, 2)})] == [5, 7]


@example([(True, 60, 0), (True, 90, 0), (True, 80, 1)])
@example([(False, 60, 1), (True, 50, 1)])
@given(
    st.lists(
        st.tuples(st.booleans(), st.integers(0, 100), st.integers(0, 2)), max_size=12
    )
)
def test_nodes_begin_and_end_in_their_order_whatever_comes_first(
    told: list[tuple[bool, int, int]],
) -> None:
    """Nodes that are noted without samples, and samples of them that come later and are earlier."""
    rows, counted = MeasuredRows(), 0
    for sampled, at, more in told:
        counted += more
        begun, done = (counted + 1) // 2, counted // 2
        if sampled:
            rows.add(at, Sample(float(at), np.array([float(at > 50)]), begun, done))
        else:
            rows.note(at, begun, done)
    times = [
        t for pair in itertools.zip_longest(rows.begin_ns, rows.end_ns) for t in pair
    ]
    known = [t for t in times if t is not None]
    assert known == sorted(known)
    assert rows.t_ns == sorted(rows.t_ns)
    assert len(rows.end_ns) <= len(rows.begin_ns) <= len(rows.end_ns) + 1
