"""The bundled cliff, boat of rods, arch of a torso, task board, gearbox and shapes, from their files to clean runs."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.stalled_runs import run_with_stalls
from planning.cell.differences import cell_differences
from planning.cell.shape import Capsule, Cylinder, Mesh
from planning.errors import OutputError
from planning.tasks.task import TaskKind
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.verification.verify import verify_plan
from tests.shipped_runs import ShippedRuns
from tests.twin.recorders.recorded_toys import static
from tests.twin.scenarios.executed import executed
from twin.planning.build_workcell import build_workcell
from twin.scenario.sections.scenario import resolve_scenario, restore_scenario
from twin.verification.standing_states import audit_standing_states

CLIFF, BOAT, TORSO = "lego/cliff", "multi_arm/assembly", "multi_arm/torso"
BOARD, GEARBOX, SHAPES = "assembly/taskboard", "assembly/gearbox", "assembly/shapes"


@pytest.mark.parametrize(
    ("name", "pairs", "configurations", "share"),
    [
        (CLIFF, 100_000, 2_000, 0.75),
        pytest.param(BOAT, 10_000, 4_000, 0.5, marks=pytest.mark.nightly),
        pytest.param(TORSO, 10_000, 2_000, 0.6, marks=pytest.mark.nightly),
        pytest.param(BOARD, 0, 0, 1.0, marks=pytest.mark.nightly),
        pytest.param(GEARBOX, 0, 0, 1.0, marks=pytest.mark.nightly),
        pytest.param(SHAPES, 0, 500, 1.0, marks=pytest.mark.nightly),
        pytest.param("lines/mix", 10_000, 20_000, 0.8, marks=pytest.mark.nightly),
    ],
)
def test_a_plan_is_proved_safe_and_its_run_clean(
    shipped: ShippedRuns,
    tmp_path: Path,
    name: str,
    pairs: int,
    configurations: int,
    share: float,
) -> None:
    """All pairs that may happen at once are apart; the run is complete, and so much faster."""
    run = shipped(name)
    tpg, base = run.planned.tpg, run.file.parent
    report = verify_plan(tpg)
    assert report.problems == ()
    assert report.pairs_checked > pairs
    recorded = name in (GEARBOX, SHAPES)
    trial = executed(run.scenario, tpg, tmp_path / "run", base=base, recording=recorded)
    summary = trial.summary
    assert summary["outcome"] == "completed"
    assert summary["audit"]["configurations"] > configurations
    assert summary["makespan_s"] <= share * summary["makespan_sequential_s"]
    if name == SHAPES:
        recording = tmp_path / "run" / "run.rrd"
        corners = static(recording, "/objects/housing", "Mesh3D:vertex_positions")
        assert len(corners) == 3 * 224


@pytest.mark.parametrize(
    ("name", "seed", "stalls"),
    [
        *((CLIFF, seed, 20) for seed in (1, 2, 3)),
        pytest.param(BOAT, 1, 10, marks=pytest.mark.nightly),
    ],
)
def test_stalls_neither_block_it_nor_make_anything_touch(
    shipped: ShippedRuns, name: str, seed: int, stalls: int
) -> None:
    shown = shipped(name)
    tpg, base = shown.planned.tpg, shown.file.parent
    run = run_with_stalls(shown.scenario, tpg, base, seed, stalls=stalls)
    assert run.outcome == "completed"
    assert run.violations == ()
    assert run.makespan_s > shown.trial.summary["makespan_s"]


@pytest.mark.parametrize(
    "name",
    [CLIFF, *(pytest.param(n, marks=pytest.mark.nightly) for n in (GEARBOX, SHAPES))],
)
def test_a_run_remembers_its_scenario(shipped: ShippedRuns, name: str) -> None:
    """Shapes with all their defaults filled in are read as they were written."""
    scenario = shipped(name).scenario
    assert restore_scenario(resolve_scenario(scenario)) == scenario


def test_the_cliff_is_what_it_says_and_its_baseline_close_to_straight_lines(
    shipped: ShippedRuns,
) -> None:
    motions = shipped(CLIFF).planned.motions
    plan = motions.motion_plan
    kinds = {task.kind for task in plan.tasks}
    assert len(motions.assembly.steps) == 11
    assert {"support-bottom", "place-up", "handover", "support-top"} <= kinds
    taken = straight = 0.0
    for task, motion in zip(plan.tasks, plan.motions, strict=True):
        seconds = motion.time[-1] - motion.time[0]
        way = np.abs(motion.path[-1] - motion.path[0]).sum()
        taken += seconds
        straight += way if task.kind == TaskKind.TRANSIT else seconds
    assert taken <= 1.1 * straight


def test_a_robot_of_the_cliff_that_never_goes_on_is_not_run_into(
    shipped: ShippedRuns,
) -> None:
    tpg = shipped(CLIFF).planned.tpg
    report = audit_standing_states(tpg)
    assert report.states >= len(tpg.edges)
    assert report.violations == ()


@pytest.mark.nightly
def test_three_arms_of_the_boat_share_seventeen_steps(shipped: ShippedRuns) -> None:
    choices = shipped(BOAT).planned.motions.task_plan.choices
    done = [choice.robot for choice in choices]
    assert len(done) == 17
    assert {name: done.count(name) for name in done} == {
        "stern": pytest.approx(5, abs=1),
        "starboard": pytest.approx(6, abs=1),
        "port": pytest.approx(6, abs=1),
    }


@pytest.mark.nightly
def test_who_does_what_on_the_board_is_by_the_tools(shipped: ShippedRuns) -> None:
    tasks = shipped(BOARD).planned.tpg.tasks
    by_driver = {task.kind for task in tasks if task.robot == "back"}
    worked = {"screw", "tighten", "inspect"}
    assert worked < by_driver
    assert not {"pick", "place-down", TaskKind.HOLD} & by_driver
    assert all(task.robot == "back" for task in tasks if task.kind in worked)
    assert [task.label for task in tasks if task.kind == TaskKind.HOLD] == [
        "hold cover"
    ] * 2
    # A lane has the colour of its text: an approach must not be called as its process is.
    kinds: dict[str, set[str]] = {}
    for task in tasks:
        kinds.setdefault(task.label, set()).add(task.kind)
    assert all(len(found) == 1 for found in kinds.values())


@pytest.mark.nightly
def test_the_order_of_the_board_is_one_in_which_it_can_be_built(
    shipped: ShippedRuns,
) -> None:
    tasks = shipped(BOARD).planned.tpg.tasks
    step = {t.label: t.step for t in tasks if t.object or t.kind == "inspect"}
    assert step["place cover"] < step["screw cover/west"] < step["screw cover/east"]
    assert step["place nut"] < step["tighten nut/top"]
    assert step["inspect board/middle"] == max(step.values()) == 10


@pytest.mark.nightly
def test_the_driver_of_the_gearbox_screws_while_the_gripper_holds(
    shipped: ShippedRuns,
) -> None:
    tasks = shipped(GEARBOX).planned.tpg.tasks
    assert {t.robot for t in tasks if t.kind == "screw"} == {"right"}
    assert {t.robot for t in tasks if t.kind == TaskKind.HOLD} == {"left"}
    assert {t.robot for t in tasks if t.kind == "pick"} == {"left", "right"}
    assert sum(t.kind == "screw" for t in tasks) == 4
    assert sum(t.kind == TaskKind.HOLD for t in tasks) == 2
    # The tool is changed once, after the last part of its arm.
    own = [t for t in tasks if t.robot == "right"]
    kinds = [t.kind for t in own]
    changed = [
        t.object for t in own if t.kind in (TaskKind.LEAVE_TOOL, TaskKind.TAKE_TOOL)
    ]
    assert changed == ["right_gripper", "driver"]
    last = max(k for k, kind in enumerate(kinds) if kind == "place-down")
    changes = kinds.index(TaskKind.LEAVE_TOOL), kinds.index(TaskKind.TAKE_TOOL)
    assert last < changes[0] < changes[1] < kinds.index("screw")
    order = [t.object for t in tasks if t.kind == "place-down"]
    for side in "ab":
        assert order.index(f"pin_{side}") < order.index(f"gear_{side}")


def test_the_cell_of_shapes_is_as_the_file_says(shipped: ShippedRuns) -> None:
    cell = shipped(SHAPES).planned.tpg.cell
    form = {item.name: item.shape.elements[0].form for item in cell.objects}
    assert isinstance(form["housing"], Mesh)
    assert isinstance(form["pin"], Cylinder)
    assert isinstance(form["rod"], Capsule)
    assert len(cell.object("bracket").shape.pieces) == 3
    # The hole of the housing is not filled: the pin stands in it, on the plate.
    housing = cell.object("housing").shape
    assert len(housing.pieces) > 3
    np.testing.assert_allclose(housing.size, [0.08, 0.036, 0.02], atol=1e-6)


def test_a_plan_comes_back_with_its_shapes(
    shipped: ShippedRuns, tmp_path: Path
) -> None:
    run = shipped(SHAPES)
    tpg = run.planned.tpg
    save_plan(tpg, tmp_path)
    loaded = load_plan(tmp_path)
    document = json.loads((tmp_path / "plan.json").read_text())
    assert plan_sha256(loaded) == plan_sha256(tpg)
    built = build_workcell(run.scenario, run.file.parent)
    assert cell_differences(loaded.cell, built) == []
    for mine, other in zip(tpg.cell.objects, loaded.cell.objects, strict=True):
        assert mine.shape.is_box == other.shape.is_box
        for a, b in zip(mine.shape.pieces, other.shape.pieces, strict=True):
            np.testing.assert_array_equal(a.vertices, b.vertices)
            np.testing.assert_array_equal(a.capsules.radius, b.capsules.radius)
    document["cell"]["objects"][0]["shape"][0]["hulls"].append(3)
    (tmp_path / "plan.json").write_text(json.dumps(document))
    with pytest.raises(OutputError, match=r"shape_housing_0_corners is float64"):
        load_plan(tmp_path)
