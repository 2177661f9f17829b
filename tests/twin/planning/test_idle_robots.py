"""Robots without a task are named, with what they could do and why they get nothing."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

import twin
from planning.parts.assembly import PartAssembly, PlacePart, Process, Spot, Work
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    SupportCandidate,
)
from planning.tasks.work import AssemblyWork
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.supply import remove_idle_chains
from tests.twin.twin_toys import random_tpg
from twin.kinds.construction.kind import ConstructionKind
from twin.kinds.goals.kind import GoalsKind
from twin.kinds.lego.kind import LegoKind
from twin.kinds.parts.kind import PartKind
from twin.planning.idle_robots import find_idle_robots, idle_robots_of_manifest

SOLO = """\
version: 1
name: two_of_three
cell:
  robots:
    - {name: left, model: ur5e, base: {xyz_m: [-0.6, 0, 0]}}
    - {name: right, model: ur5e, base: {xyz_m: [0.6, 0, 0]}}
    - {name: spare, model: ur5e, base: {xyz_m: [0, 2, 0]}}
assembly:
  kind: goals
  moves:
    - {robot: left, to_rad_or_m: [0.4, -1.2, 1.2, -1.5, -1.5, 0.2]}
    - {robot: right, to_rad_or_m: [0.2, -1.4, 1.4, -1.5, -1.5, 0.1]}
planning: {speed_model: l1, shortcut_candidates: 0}
"""


def without_last() -> TemporalPlanGraph:
    return remove_idle_chains(random_tpg(1, dofs=(2, 2), tasks=4, edges=0), {1})


def motions(
    primaries: list[PrimaryCandidate],
    supports: list[SupportCandidate],
    *,
    by: str = "robot_0",
    assembly: Any = "bricks",
) -> Any:
    problem = AssignmentProblem(
        ("robot_0", "robot_1"),
        ("a", "b"),
        (True, True),
        tuple(primaries),
        tuple(supports),
    )
    work = AssemblyWork(problem, lambda *_: None, assembly=assembly)  # type: ignore[arg-type]
    tasks = (SimpleNamespace(robot=by),)
    cell = without_last().cell
    return SimpleNamespace(
        work=work,
        assembly=assembly,
        cell=cell,
        motion_plan=SimpleNamespace(tasks=tasks),
    )


def candidate(step: int, robot: str, partner: str | None = None) -> PrimaryCandidate:
    return PrimaryCandidate(step, robot, f"part{step}", 0, 1.0, partner=partner)


BOTH = [candidate(1, "robot_0"), candidate(2, "robot_0"), candidate(2, "robot_1")]
ALONE = BOTH[:2]
SCREW = Process("screw", tool="driver", frame="flange")


def work(process: Process) -> Work:
    """Return work at a spot that nobody asks for."""
    return Work(process=process, spot=cast(Spot, None))


def made_of(*steps: Any) -> PartAssembly:
    return PartAssembly({}, steps)


@pytest.mark.parametrize(
    ("first", "reason", "serves"),
    [
        (motions(BOTH, []), "balance", 1),
        (motions(BOTH, [], by="robot_1"), "makespan", 1),
        (motions(ALONE, [SupportCandidate(1, "robot_1", 0, 1.0)]), "balance", 1),
        (motions([candidate(1, "robot_0", "robot_1")], []), "balance", 1),
        (motions(ALONE, []), "no reach", 0),
        (motions(ALONE, [], assembly=None), "not allowed", 0),
        (
            motions(
                ALONE, [], assembly=made_of(PlacePart(part="a", robots=("robot_0",)))
            ),
            "not allowed",
            0,
        ),
        (
            motions(ALONE, [], assembly=made_of(work(SCREW))),
            "tools",
            0,
        ),
        (
            motions(
                ALONE,
                [],
                assembly=made_of(work(replace(SCREW, tool=None))),
            ),
            "no reach",
            0,
        ),
    ],
)
def test_why_a_robot_gets_no_task(first: Any, reason: str, serves: int) -> None:
    kind: Any = GoalsKind if first.assembly is None else LegoKind
    if isinstance(first.assembly, PartAssembly):
        kind = PartKind
    (found,) = find_idle_robots(without_last(), first, kind(None))
    assert (found.robot, found.reason, found.serves) == ("robot_1", reason, serves)
    assert found.steps == 2
    assert f"of 2 steps it can serve {serves}" in found.message


@pytest.mark.parametrize(
    ("reached", "reason"), [(("a", "c"), "search"), ((), "no reach")]
)
def test_of_a_construction_the_parts_that_an_idle_robot_reaches_are_counted(
    reached: tuple[str, ...], reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = SimpleNamespace(parts=("a", "b", "c"))
    bounds = SimpleNamespace(serves=lambda robot: iter(reached))
    monkeypatch.setattr(
        "planning.construction.problem.reach_bounds.reach_bounds", lambda _: bounds
    )
    first: Any = SimpleNamespace(work=None, assembly=SimpleNamespace(problem=problem))
    kind: Any = ConstructionKind
    (found,) = find_idle_robots(without_last(), first, kind(None))
    assert (found.reason, found.serves, found.steps) == (reason, len(reached), 3)


def test_a_run_names_robots_without_tasks(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(SOLO)
    plan = twin.plan(path)
    run = twin.simulate(plan)
    assert run.outcome == "completed"
    expected = {"reason": "not allowed", "serves": 0, "steps": 2}
    assert run.summary["idle"] == {"spare": expected}
    (words,) = [w for w in run.summary["warnings"] if "spare" in w]
    assert words.startswith("spare gets no task")
    assert run.wait_s["spare"] == run.makespan_s
    assert set(run.wait_s) == {"left", "right", "spare"}
    assert repr(run).startswith("<run of 'two_of_three': completed, ")
    kept = plan.save(tmp_path / "plan")
    read = twin.simulate(twin.read_plan(kept, path))
    assert read.summary["idle"]["spare"]["reason"] == "unknown"
    done = twin.run(path, out=tmp_path / "run", recording=False, audit=False)
    again = twin.simulate(twin.read_plan(done.folder or ""))
    assert again.summary["idle"] == {"spare": expected}


@pytest.mark.parametrize(
    "content",
    [None, [], {"a": 1}, {"a": {}}, {"a": {"reason": "moon"}}, {"a": {"reason": []}}],
)
def test_damaged_reasons_are_left_out(content: object) -> None:
    assert idle_robots_of_manifest(content) == ()
