"""Parts of any shape, from the file to the recording: planned, executed, proved, audited, seen."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from planning.cell.differences import cell_differences
from planning.cell.shape import Capsule, Cylinder, Mesh
from planning.errors import OutputError
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.verification.verify import verify_plan
from twin.planning.build_workcell import build_workcell
from twin.run.folder import prepare_run_folder
from twin.scenario.sections.scenario import Scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult, given_plan
from twin.trial.run_result import RunResult
from twin.trial.trial import try_plan

FILE = Path(__file__).parents[3] / "scenarios" / "assembly" / "shapes.yaml"


@pytest.fixture(scope="module")
def file() -> Path:
    return FILE


@pytest.fixture(scope="module")
def trial(
    scenario: Scenario, planned: PlanResult, tmp_path_factory: pytest.TempPathFactory
) -> RunResult:
    folder = prepare_run_folder(tmp_path_factory.mktemp("shapes") / "run", "shapes")
    return try_plan(
        given_plan(LoadedScenario(scenario, FILE.parent), planned.tpg), folder
    )


def test_the_cell_is_as_the_file_says(planned: PlanResult) -> None:
    cell = planned.tpg.cell
    form = {item.name: item.shape.elements[0].form for item in cell.objects}
    assert isinstance(form["housing"], Mesh)
    assert isinstance(form["pin"], Cylinder)
    assert isinstance(form["rod"], Capsule)
    assert len(cell.object("bracket").shape.pieces) == 3
    # The hole of the housing is not filled: the pin stands in it, on the plate.
    assert len(cell.object("housing").shape.pieces) > 3
    housing = cell.object("housing").shape
    np.testing.assert_allclose(housing.size, [0.08, 0.036, 0.02], atol=1e-6)


def test_it_is_safe_for_any_delays(planned: PlanResult) -> None:
    assert verify_plan(planned.tpg).ok


def test_it_is_executed_and_the_audit_is_clean(trial: RunResult) -> None:
    assert trial.passed
    assert trial.summary["audit"]["configurations"] > 500


def test_meshes_are_in_the_recording(trial: RunResult) -> None:
    from tests.twin.recorders.recorded_toys import static

    recording = trial.folder / "run.rrd"
    corners = static(recording, "/objects/housing", "Mesh3D:vertex_positions")
    assert len(corners) == 3 * 224


def test_the_plan_comes_back_with_its_shapes(
    scenario: Scenario, planned: PlanResult, tmp_path: Path
) -> None:
    save_plan(planned.tpg, tmp_path)
    loaded = load_plan(tmp_path)
    assert plan_sha256(loaded) == plan_sha256(planned.tpg)
    assert cell_differences(loaded.cell, build_workcell(scenario, FILE.parent)) == []
    for mine, other in zip(planned.tpg.cell.objects, loaded.cell.objects, strict=True):
        assert mine.shape.is_box == other.shape.is_box
        for a, b in zip(mine.shape.pieces, other.shape.pieces, strict=True):
            np.testing.assert_array_equal(a.vertices, b.vertices)
            np.testing.assert_array_equal(a.capsules.radius, b.capsules.radius)
    document = json.loads((tmp_path / "plan.json").read_text())
    document["cell"]["objects"][0]["shape"][0]["hulls"].append(3)
    (tmp_path / "plan.json").write_text(json.dumps(document))
    with pytest.raises(OutputError, match=r"shape_housing_0_corners is float64"):
        load_plan(tmp_path)
