"""The audit sees joints out of range or too fast, and nodes that begin before they may."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planning.errors import OutputError
from planning.transforms import Array
from tests.twin.audit.audit_cell import HandWrittenRun, two_arm_cell
from twin.audit.audit import audit_run
from twin.audit.violation import Violation


def turning(joint: int, values: list[float]) -> Array:
    """Configurations of ``left``, HOME but for one joint."""
    home = two_arm_cell().robot("left").home
    path = np.repeat(home[None], len(values), axis=0)
    path[:, joint] += values
    return path


def found_in(run: HandWrittenRun, folder: Path) -> tuple[Violation, ...]:
    return audit_run(run.write(folder)).violations


def test_a_joint_beyond_its_limit(tmp_path: Path) -> None:
    model = two_arm_cell().robot("left").model
    beyond = model.upper[0] + 0.01
    run = HandWrittenRun(two_arm_cell())
    times = [0.0, 5.0, 10.0, 15.0]
    run.move("left", times, turning(0, [0.0, 0.1, 0.1, 0.0]))
    folder = run.write(tmp_path)
    rows = pq.read_table(folder / "trajectory.parquet")
    q = pa.array([0.0, beyond, beyond, 0.0])
    rows = rows.set_column(rows.column_names.index("q_0"), "q_0", q)
    pq.write_table(rows, folder / "trajectory.parquet")
    (found,) = audit_run(folder).violations
    assert (found.kind, found.first, found.second) == (
        "joint-limit",
        "left",
        model.joint_names[0],
    )
    assert (found.t_start, found.t_end) == (5.0, 10.0)
    assert f"{beyond:.6g} rad, its limit is {model.upper[0]:.6g} rad" in found.detail


@pytest.mark.parametrize(("share", "kinds"), [(1.0, []), (1.001, ["joint-speed"])])
def test_a_joint_that_is_faster_than_it_may_be(
    tmp_path: Path, share: float, kinds: list[str]
) -> None:
    model = two_arm_cell().robot("left").model
    run = HandWrittenRun(two_arm_cell())
    seconds = 0.5 / model.velocity[0] / share
    run.move("left", [0.0, 1.0, 1.0 + seconds, 5.0], turning(0, [0.0, 0.0, -0.5, -0.5]))
    found = found_in(run, tmp_path)
    assert [v.kind for v in found] == kinds
    for v in found:
        assert (v.first, v.second) == ("left", model.joint_names[0])
        assert (v.t_start, v.t_end) == pytest.approx((1.0, 1.0 + seconds))
        limit = model.velocity[0]
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
    found = found_in(run, tmp_path)
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
