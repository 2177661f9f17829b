"""The audit sees objects that hang, grips that do not fit, wrong places and missing supports."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planning.statics.standing_rules import StandingRules
from planning.transforms import Array, Transform, rotation, translation
from tests.twin.audits.audit_cell import (
    BRICK,
    CONTACT,
    HandWrittenRun,
    brick,
    down_and_up,
    handled,
    in_hand,
    straight_down,
    two_arm_cell,
)
from twin.audits.audit import Auditor, audit_run
from twin.audits.case import Violation
from twin.audits.expectations import Expectations, Hold, Place
from twin.audits.motion.executed import read_recording

X, Y = 0.42, -0.08
EDGE = X + BRICK[0] / 2
STUDS = Expectations(hold="studs")
START = brick("b1", X, Y).start


def at(x: float, y: float, z: float = CONTACT - BRICK[2] / 2) -> Transform:
    return translation(x, y, z)


def taking(above: float = 0.0) -> HandWrittenRun:
    """``left`` goes down to b1 at (X, Y), takes it at 3 s, though it may be above it, and goes up."""
    cell = two_arm_cell([brick("b1", X, Y)])
    run = HandWrittenRun(cell, handled("b1"))
    times, path = down_and_up(cell, EDGE, Y, CONTACT + above)
    run.move("left", times, path)
    run.put(3.0, "b1", "left", in_hand(cell, "left", path[60], START))
    return run


def moved_brick(to: Transform | None = START) -> HandWrittenRun:
    """``left`` takes b1 at 3 s, lifts it, comes down again, and puts it somewhere at 9 s, or keeps it."""
    run = taking()
    _, path = run.motions["left"]
    twice = np.vstack([path, path[1:]])
    run.move("left", np.linspace(0, 12, len(twice)), twice)
    if to is not None:
        run.put(9.0, "b1", None, to)
    return run


def found(
    run: HandWrittenRun, folder: Path, wanted: Expectations, *kinds: str
) -> tuple[Violation, ...]:
    """The violations of some kinds."""
    report = audit_run(run.write(folder), wanted=wanted)
    return tuple(v for v in report.violations if not kinds or v.kind in kinds)


@pytest.mark.parametrize(
    ("place", "away"),
    [
        (Place("step 7", START, "2x4", "b1"), 0.0),
        (Place("step 7", START, "2x4"), 0.0),
        (Place("step 7", START @ rotation("z", np.pi), "2x4"), 0.0),
        (Place("step 7", at(X + 0.008, Y), "2x4"), 0.008),
        (Place("step 7", at(X, Y + 0.0011), "2x4", "b1"), 0.0011),
        # A named part must not be turned.
        (Place("step 7", START @ rotation("z", np.pi), "2x4", "b1"), 0.036784),
    ],
)
def test_a_brick_that_ends_beside_its_place(
    tmp_path: Path, place: Place, away: float
) -> None:
    violations = found(moved_brick(), tmp_path, replace(STUDS, places=(place,)))
    assert [(v.kind, round(v.depth_m, 6)) for v in violations] == (
        [("place", away)] if away else []
    )
    for v in violations:
        assert (v.first, v.second, v.t_start) == ("b1", "step 7", 12.0)
        assert f"up to {away * 1e3:.2f} mm off" in v.detail


@pytest.mark.parametrize(("room", "hangs"), [(0.029, False), (0.02, True), (0.0, True)])
def test_what_is_joined_across_a_gap_rests_as_near_as_its_joint_says(
    room: float, hangs: bool, tmp_path: Path
) -> None:
    """30 mm above the plate that it is joined to."""
    goal = at(X, Y, CONTACT - BRICK[2] / 2 + 0.03)
    joined = {frozenset({"b1", "plate"}): room}
    wanted = Expectations(
        (Place("step 1", goal, "2x4", "b1"),), "weight", joined=joined
    )
    seen = found(moved_brick(goal), tmp_path, wanted, "hanging")
    assert [v.second for v in seen] == (["plate"] if hangs else [])


@pytest.mark.parametrize(
    ("inside", "joined", "falls"),
    [(0.002, False, False), (-0.002, False, True), (-0.002, True, False)],
)
def test_what_is_put_down_on_an_edge_falls(
    inside: float, joined: bool, falls: bool, tmp_path: Path
) -> None:
    """The edge of the plate is at 0.29 m; two millimetres more or less decide."""
    goal = at(0.29 + inside, Y)
    statics = StandingRules(joined_within=0.001 if joined else 0.0)
    places = (Place("its place", goal, "2x4", "b1"),)
    wanted = Expectations(places, statics=statics)
    seen = found(moved_brick(goal), tmp_path, wanted, "balance")
    assert [(v.first, v.second, v.t_start) for v in seen] == (
        [("b1", "gravity", 9.0)] if falls else []
    )
    assert all("no forces between it and plate" in v.detail for v in seen)


def test_a_brick_that_stays_in_the_hand_or_is_no_object_of_the_plan(
    tmp_path: Path,
) -> None:
    kept = moved_brick(None)
    wanted = replace(STUDS, places=(Place("step 1", START, "2x4", "b1"),))
    (v,) = found(kept, tmp_path, wanted, "place")
    assert v.detail == "is still held by left"
    wanted = replace(STUDS, places=(Place("step 1", START, "2x6"),))
    (v,) = found(moved_brick(), tmp_path, wanted, "place")
    assert (v.first, v.second, v.detail) == ("2x6", "step 1", "no 2x6 is there")
    (v,) = found(kept, tmp_path, wanted, "place")[1:]
    assert "in the hand of left" in v.detail


def test_a_run_that_has_not_come_to_its_end_has_no_wrong_places(tmp_path: Path) -> None:
    wanted = replace(STUDS, places=(Place("step 1", np.eye(4), "2x6"),))
    folder = moved_brick().write(tmp_path)
    assert audit_run(folder, wanted=wanted, finished=False).violations == ()


def test_a_brick_that_starts_elsewhere_than_in_the_cell(tmp_path: Path) -> None:
    folder, other = (
        HandWrittenRun(two_arm_cell([brick("b1", x, Y)])) for x in (X, X + 0.016)
    )
    for name, run in (("run", folder), ("other", other)):
        run.stand("left", 1.0)
        run.write(tmp_path / name)
    moved = tmp_path / "other" / "objects.parquet"
    moved.replace(tmp_path / "run" / "objects.parquet")
    (v,) = audit_run(tmp_path / "run").violations
    assert (v.kind, v.first) == ("place", "b1")
    assert v.depth_m == pytest.approx(0.016, abs=1e-9)


@pytest.mark.parametrize("t", [10.0, 13.0])  # also after everybody has stopped
def test_a_brick_that_moves_while_nobody_holds_it(tmp_path: Path, t: float) -> None:
    run = moved_brick()
    run.put(t, "b1", None, translation(0.008, 0.0, 0.0) @ START)
    (v,) = found(run, tmp_path, STUDS, "jump")
    assert (v.first, v.second, v.t_start, v.t_end) == ("b1", "jump", t, t)
    assert v.depth_m == pytest.approx(0.008, abs=1e-9)


def still(*objects: tuple[float, float, float]) -> HandWrittenRun:
    """Nobody moves for a second; bricks are at rest somewhere (layers may be broken)."""
    run = HandWrittenRun(
        two_arm_cell([brick(f"b{k}", *place) for k, place in enumerate(objects)])
    )
    run.stand("left", 1.0)
    return run


@pytest.mark.parametrize(
    ("hold", "objects", "hangs"),
    [
        ("studs", [(X, Y, 1)], []),
        ("weight", [(X, Y, 1), (X, Y, 2)], []),
        ("joints", [(X, Y, 1.1)], []),  # 0.96 mm above the plate
        ("joints", [(X, Y, 1.3)], ["b0"]),  # 2.88 mm
        ("weight", [(X, Y, 1.3)], ["b0"]),
        ("studs", [(X, Y, 2)], ["b0"]),
        ("studs", [(X, Y, 2), (X, Y, 3)], ["b0", "b1"]),
        # Beside another brick, 0.2 mm away: only joints hold it.
        ("joints", [(X, Y, 1), (X, Y, 2), (X + 0.016, Y, 2)], []),
        ("weight", [(X, Y, 1), (X, Y, 2), (X + 0.016, Y, 2)], ["b2"]),
        ("studs", [(X, Y, 1), (X, Y, 2), (X + 0.016, Y, 2)], ["b2"]),
        # Under the overhang of the brick beside: its studs hold it, its weight does not.
        ("studs", [(X, Y, 1), (X, Y, 2), (X + 0.008, Y, 3), (X + 0.016, Y, 2)], []),
        (
            "weight",
            [(X, Y, 1), (X, Y, 2), (X + 0.008, Y, 3), (X + 0.016, Y, 2)],
            ["b3"],
        ),
    ],
)
def test_what_rests_on_nothing(
    tmp_path: Path,
    hold: Hold,
    objects: list[tuple[float, float, float]],
    hangs: list[str],
) -> None:
    violations = found(still(*objects), tmp_path, Expectations(hold=hold))
    assert [(v.kind, v.first) for v in violations] == [("hanging", b) for b in hangs]
    for v in violations:
        assert (v.t_start, v.t_end) == (0.0, 1.0)


def test_joints_have_room_in_their_places_only(tmp_path: Path) -> None:
    """The brick hangs 10 mm beside another: a joint, if the scenario puts it there."""
    poses = [(X, Y, 1), (X, Y, 2), (X + 0.026, Y, 2)]
    run = still(*poses)
    places = [Place("place", box.start, box.kind, box.name) for box in run.cell.objects]
    wanted = Expectations(tuple(places), "joints", 0.012)
    assert found(run, tmp_path, wanted) == ()
    (v,) = found(run, tmp_path, replace(wanted, places=tuple(places[:2])))
    assert (v.kind, v.first, v.second) == ("hanging", "b2", "plate")
    assert v.depth_m == pytest.approx(BRICK[2], abs=1e-5)
    assert "9.60 mm away from plate" in v.detail


def test_a_brick_that_is_let_go_in_the_air_and_caught_again(tmp_path: Path) -> None:
    run = moved_brick()
    _, path = run.motions["left"]
    grip = run.placements[0][3]
    up = at(0.0, 0.0, 0.03) @ START
    assert in_hand(run.cell, "left", path[90], up) == pytest.approx(grip, abs=1e-6)
    run.put(4.5, "b1", None, up)
    run.put(7.5, "b1", "left", grip)
    (v,) = found(run, tmp_path, STUDS, "hanging")
    assert (v.first, v.second, v.t_start, v.t_end) == ("b1", "plate", 4.5, 7.5)
    assert v.depth_m == pytest.approx(0.03, abs=1e-5)


@pytest.mark.parametrize(
    ("keeps", "since"), [({}, 4.5), ({"b1": "cap"}, 6.5), ({"b2": "cap"}, 4.5)]
)
def test_what_is_kept_hold_of_hangs_in_the_air_only_once_its_robot_leaves(
    tmp_path: Path, keeps: dict[str, str], since: float
) -> None:
    """``left`` lets go of b1 30 mm above the plate at 4.5 s, and stands there until 6.5 s."""
    run = taking()
    times, path = run.motions["left"]
    late = np.where(times > 4.5, times + 2.0, times)
    run.move("left", np.insert(late, 91, 6.5), np.insert(path, 91, path[90], axis=0))
    run.put(4.5, "b1", None, at(0.0, 0.0, 0.03) @ START)
    (v,) = found(run, tmp_path, replace(STUDS, keeps=keeps), "hanging")
    assert (v.first, v.second) == ("b1", "plate")
    assert v.t_start == since
    assert v.t_end == pytest.approx(8.0)
    assert v.depth_m == pytest.approx(0.03, abs=1e-5)


@pytest.mark.parametrize(
    ("below", "opening", "gap"),
    [
        (0.0080, 0.0, 0.0),
        (0.0083, 0.0, 0.0051),
        (0.0083, BRICK[2] + 0.004, 0.0),  # fingers that close by 2 mm
        (0.0103, BRICK[2] + 0.004, 0.0071),
    ],
)
def test_an_object_that_hangs_away_from_the_tool(
    tmp_path: Path, below: float, opening: float, gap: float
) -> None:
    """The brick is taken though the tool is that far above it; its lever is 3.2 mm nearer."""
    run = taking(below)
    violations = found(run, tmp_path, Expectations(opening_m=opening))
    assert [v.kind for v in violations] == (["grip"] if gap else [])
    for v in violations:
        assert (v.first, v.second, v.t_start, v.t_end) == ("b1", "left", 3.0, 6.0)
        assert v.depth_m == pytest.approx(gap, abs=1e-4)
        assert "away from left/tool" in v.detail


def supported(leaves: float, comes: float = 0.0) -> HandWrittenRun:
    """``left`` puts b1 down from 3 s to 9 s; ``right`` stands on b2 in the meantime.

    Args:
        leaves: when ``right`` begins to go up.
        comes: when it is there.
    """
    run = moved_brick()
    x, y = 0.48, 0.08
    run.cell = two_arm_cell([brick("b1", X, Y), brick("b2", x, y)])
    run.allowed += handled("b2", robot="right", task=1)
    spot = run.cell, "right", x + BRICK[0] / 2, y
    high, low = straight_down(*spot, CONTACT + 0.05, CONTACT + 0.0015, 2)
    times = [0.0, comes, leaves, 12.0] if comes else [0.0, leaves, 12.0]
    run.move("right", times, np.array([high, low, low, high][-len(times) :]))
    return run


HELD = replace(STUDS, places=(Place("step 1", START, "2x4", "b1", held=True),))


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("leaves", "comes", "kinds"),
    [
        (9.0, 0.0, []),
        (8.94, 0.0, ["support"]),  # before the node of the release is over
        (10.0, 8.95, []),
        (10.0, 8.96, ["support"]),  # after it has begun
    ],
)
def test_a_support_that_leaves_early_or_comes_late(
    tmp_path: Path, leaves: float, comes: float, kinds: list[str]
) -> None:
    run = supported(leaves, comes)
    run.motions["right"][1][-2, 5] += 1e-12  # rounding is no motion
    violations = found(run, tmp_path, HELD)
    assert [v.kind for v in violations] == kinds
    for v in violations:
        # The node of the release.
        assert (v.first, v.t_end) == ("b1", 9.0)
        assert v.t_start == pytest.approx(8.95)
        assert "put down without its support" in v.detail
    # Where neither scenario nor plan asks for a support, none is missed.
    assert found(run, tmp_path, STUDS, "support") == ()


def test_a_support_that_stands_beside_the_structure(tmp_path: Path) -> None:
    run = supported(9.0)
    times, path = run.motions["right"]
    run.move("right", times, np.repeat(path[-1:], 3, axis=0))
    (v,) = found(run, tmp_path, HELD)
    assert (v.kind, v.second) == ("support", "right")
    assert v.depth_m == pytest.approx(0.05 + 0.0015 - 0.0032, abs=4e-3)


@pytest.mark.parametrize(("turn", "kinds"), [(0.0, []), (0.05, ["support"])])
def test_a_handover_between_two_that_move(
    tmp_path: Path, turn: float, kinds: list[str]
) -> None:
    """The brick goes from hand to hand while both arms turn, and while one stands."""
    run = taking()
    q: Array = np.repeat(run.cell.robot("right").home[None], 4, axis=0)
    q[1:, 0] += turn * np.arange(3)
    run.move("right", [0.0, 4.0, 5.0, 6.0], q)
    there = translation(0.0, 0.0, 0.03) @ START
    in_between = q[1] + 0.5 * (q[2] - q[1])
    run.put(4.5, "b1", "right", in_hand(run.cell, "right", in_between, there))
    assert [v.kind for v in found(run, tmp_path, STUDS, "support")] == kinds


@pytest.mark.parametrize(("leaves", "kinds"), [(9.0, []), (8.94, ["support"])])
def test_a_support_of_the_plan_is_missed_too(
    tmp_path: Path, leaves: float, kinds: list[str]
) -> None:
    """The scenario gives a structure, the planner chose where it is held."""
    run = supported(leaves)
    plan = run.tpg()
    place, support = plan.tasks
    tasks = (
        replace(place, kind="place-down", object="b1"),
        replace(support, kind="support-top"),
    )
    recording = read_recording(run.write(tmp_path), run.cell)
    with Auditor(replace(plan, tasks=tasks), wanted=STUDS) as auditor:
        report = auditor.audit(recording, ordered=False)
    assert [v.kind for v in report.violations] == kinds
