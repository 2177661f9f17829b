"""Parts that lie beside where they were said to be are measured, and picked from there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from planning.kinematics.kinematics import frame_pose
from planning.tasks.task import TaskKind
from planning.transforms import Transform
from planning.worlds.measured import MeasuredWork, offset_on_surface
from tests.twin.operations.operated import (
    FEW,
    at_the_end,
    gone,
    operated,
    planned,
    require_safe,
)
from tests.twin.operations.random_operations import plan_of
from tests.twin.operations.test_windows import TEXT
from tests.twin.written import refusal, written
from twin.operations import failure_triage
from twin.operations.operation import Operation
from twin.runs.events import Event
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult

FAR = {"m": 0.006, "rad": 0.08}
MACHINES = Path(__file__).parents[3] / "scenarios" / "assembly" / "machine_tending.yaml"


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    return planned(written(tmp_path_factory.mktemp("gluing"), TEXT))


def found_beside(chance: float, **values: Any) -> dict[str, Any]:
    item = {"probability": chance, "retries": 0, "loses": 1.0, "beside": 1.0}
    return {"failures.pick": {**item, "offset": FAR, **values}}


def off(said: Transform, found: Transform) -> tuple[float, float]:
    """Return how far a pose is from another one [m], and by how much it is turned [rad]."""
    turn = found[:3, :3] @ said[:3, :3].T
    angle = np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))
    return float(np.linalg.norm(found[:3, 3] - said[:3, 3])), float(angle)


def require_picked_there(done: Operation, events: Sequence[Event]) -> int:
    """Check that parts are gripped where they were found; return how many were."""
    require_safe(done.tpg)
    places: dict[str, list[Transform]] = {}
    for h in done.tpg.handlings:
        task = done.tpg.task_of(h)
        start = done.tpg.cell.object(h.object).start
        lies = places.setdefault(h.object, [start])
        if task.kind == TaskKind.FAILED and h.holder is None:
            way, turn = off(lies[-1], h.pose)
            assert way <= FAR["m"] + 1e-9
            assert turn <= FAR["rad"] + 1e-6
            assert h.pose[2, 3] == pytest.approx(start[2, 3])
            lies.append(h.pose)
        elif task.kind == "pick":
            # The tool closes on it where it lies: its pose in the world does not change.
            chain = done.tpg.chains[h.robot]
            at = chain.waypoints[int(chain.first[h.node]) + h.waypoint - 1]
            robot = done.tpg.cell.robot(chain.robot)
            held = frame_pose(robot, at) @ h.pose
            way, turn = off(lies[-1], held)
            assert way < 1e-3
            assert turn < 1e-2
    told = [e for e in events if e.detail == "found beside its place"]
    moved = sum(len(own) - 1 for own in places.values())
    assert len(told) == moved
    return moved


@settings(max_examples=2, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_what_lies_beside_is_picked_there(plan: PlanResult, seed: int) -> None:
    done, events = operated(plan, seed, **found_beside(0.4), **{"recovery.again": 100})
    moved = require_picked_there(done, events)
    words = [e.detail for e in events if e.kind == "recovered"]
    assert sum("and is picked there" in own for own in words) == moved
    assert (done.record.outcome == "completed") == (len(words) == moved)
    # Nothing is lost: what cannot be used stays where it is.
    assert not gone(done)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [28, 40])
def test_what_a_person_has_brought_is_picked_where_it_is_found(seed: int) -> None:
    plan, ask = plan_of("reworked"), {"answer_s": 5, "helps": 1.0, "times": 3}
    values = {**found_beside(0.6, beside=0.5), "recovery.again": 5}
    done, events = operated(plan, seed, **values, **{"recovery.ask": ask})
    assert require_picked_there(done, events)
    assert [t.object for t in done.tpg.tasks if t.kind == "pick"][-1] == "pin.1"


def test_how_far_it_lies_is_told_and_is_all_that_is_different(plan: PlanResult) -> None:
    sure = found_beside(0.0, parts={"block_b": 1.0})
    done, events = operated(plan, 0, **sure, **{"recovery.again": 1})
    # It is found twice, the second time beside where it was found the first time, and then given up.
    (first, second) = [e.detail for e in events if e.kind == "recovered"]
    lies = [
        h.pose
        for h in done.tpg.handlings
        if done.tpg.task_of(h).kind == TaskKind.FAILED
    ]
    way, turn = off(done.tpg.cell.object("block_b").start, lies[0])
    assert first == (
        f"step 7 is begun anew: block_b lies beside its place, {1e3 * way:.1f} mm and"
        f" {np.degrees(turn):.1f} degrees off, and is picked there"
    )
    assert "given up" in second
    state = at_the_end(done)
    assert np.array_equal(state["block_b"].pose, lies[-1])
    assert (
        np.allclose(state["block_a"].pose, done.tpg.cell.object("block_a").start)
        is False
    )


def lying_at(plan: PlanResult, name: str, *xyz: float) -> Transform:
    pose = np.array(plan.motions.cell.object(name).start)
    pose[:3, 3] = xyz
    return pose


def test_what_cannot_be_picked_where_it_was_found_is_not_allowed(
    plan: PlanResult,
) -> None:
    work, chosen, known = plan.motions.work, plan.motions.task_plan, MeasuredWork()
    assert work is not None

    def allowed(*xyz: float) -> bool:
        poses = {"block_a": lying_at(plan, "block_a", *xyz)}
        return known.allows(work, chosen, poses)

    assert allowed(0.353, 0.252, 0.02)
    assert not allowed(3.0, 0.25, 0.02)
    # In the camera, and where the plate lies.
    assert not allowed(0.3, 0.4, 0.02)
    assert not allowed(-0.35, 0.3, 0.015)


@pytest.mark.parametrize(
    ("part", "xyz", "asked"),
    [
        ("block_a", (0.3, 0.4, 0.02), True),
        # Where the other robot is about to look at the camera.
        ("plate", (0.3, 0.4, 0.15), False),
    ],
)
def test_what_is_found_where_it_cannot_be_used_is_left_alone(
    plan: PlanResult,
    monkeypatch: pytest.MonkeyPatch,
    part: str,
    xyz: tuple[float, float, float],
    asked: bool,
) -> None:
    found, asks = lying_at(plan, part, *xyz), list[str]()
    allows = MeasuredWork.allows

    def noted(own: MeasuredWork, *rest: Any) -> bool:
        asks.append(part)
        return allows(own, *rest)

    monkeypatch.setattr(failure_triage, "offset_on_surface", lambda *_: found)
    monkeypatch.setattr(MeasuredWork, "allows", noted)
    done, events = operated(plan, 0, **found_beside(0.0, parts={part: 1.0}))
    assert bool(asks) == asked
    words = [e.detail for e in events if e.kind == "recovered"]
    assert words[0].endswith("lies beside its place, where nobody can pick it")
    require_safe(done.tpg)
    assert f"{part} is lost" in done.given_up.values()
    state = at_the_end(done)
    start = done.tpg.cell.object(part).start
    assert np.array_equal(state[part].pose, start)


def test_what_is_left_of_a_run_knows_where_parts_were_found(
    plan: PlanResult, tmp_path: Path
) -> None:
    text = TEXT + (
        "  failures:\n"
        f"    pick: {{probability: 0, parts: {{block_a: 0.5}}, retries: 0, loses: 1, beside: 1, offset: {FAR}}}\n"
    )
    file = written(tmp_path, text)
    for seed in range(1, 9):
        again = load(file).varied({**FEW, "seed": seed})
        out = tmp_path / f"{seed}"
        run = twin.operate(again, out=out, recording=False, audit=False)
        swaps = [e.t_ns / 1e9 for e in run.history if e.kind == "replanned"]
        if len(swaps) == 1:
            break
    else:
        raise AssertionError("it never lies beside")
    assert twin.audit(run).clean
    # Right after it was found, and before it is picked.
    left = twin.plan(world=f"{run.files}@{swaps[0] + 0.1}")
    require_safe(left.tpg)
    said = run.tpg.cell.object("block_a").start
    way, _ = off(said, left.tpg.cell.object("block_a").start)
    assert 0.0 < way <= FAR["m"]
    (pick,) = [
        h
        for h in left.tpg.handlings
        if h.object == "block_a" and h.holder == left.tpg.chains[h.robot].robot
    ]
    chain = left.tpg.chains[pick.robot]
    at = chain.waypoints[int(chain.first[pick.node]) + pick.waypoint - 1]
    held = frame_pose(left.tpg.cell.robot(chain.robot), at) @ pick.pose
    assert off(held, left.tpg.cell.object("block_a").start)[0] < 1e-3


@given(
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    st.floats(-3.0, 3.0),
    st.integers(0, 1000),
)
def test_a_pose_beside_is_turned_about_the_vertical_through_it(
    way: tuple[float, float], turn: float, seed: int
) -> None:
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    pose[:3, 3] = [0.3, -0.2, 0.05]
    found = offset_on_surface(pose, np.array(way), turn)
    about = Rotation.from_rotvec([0.0, 0.0, turn]).as_matrix()
    assert np.allclose(found[:3, :3], about @ pose[:3, :3])
    assert np.allclose(found[:3, 3] - pose[:3, 3], [*way, 0.0])


@pytest.mark.parametrize(
    ("failures", "says"),
    [
        (
            "place-down: {probability: 0.1, beside: 0.5}",
            "nothing is found beside its place",
        ),
        (
            "pick: {probability: 0.1, wrong: 0.6, beside: 0.5}",
            "more than all that are lost",
        ),
        (
            "pick: {probability: 0.1, beside: 0.5, offset: {m: 0.2}}",
            "must be at most 0.1",
        ),
    ],
)
def test_what_cannot_be_found_beside_is_said(
    tmp_path: Path, failures: str, says: str
) -> None:
    assert says in str(refusal(tmp_path, f"{TEXT}  failures:\n    {failures}\n"))


def test_what_comes_from_a_source_lies_as_said(tmp_path: Path) -> None:
    text = MACHINES.read_text().replace(
        "\nexecution:\n",
        "\nexecution:\n  failures: {pick: {probability: 0.1, beside: 1}}\n",
    )
    assert "without sources and products" in str(refusal(tmp_path, text))
