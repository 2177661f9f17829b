"""The published APEX-MR tasks: imported, planned, executed, audited and proved safe."""

import os
from pathlib import Path

import pytest

from scheduling.verification.verify import verify_plan
from tests.twin.program import invoke
from tests.twin.scenarios.executed import executed
from twin.reading.scenario_file import load_scenario
from twin.trial.planning import plan_scenario

DATA = Path(
    os.environ.get(
        "ASSEMBLY_TWIN_APEX_DATA",
        Path(__file__).parents[4] / "shared" / "data" / "apex-mr",
    )
)
pytestmark = [
    pytest.mark.skipif(not DATA.exists(), reason="the published files are not here"),
    pytest.mark.expensive,
]


@pytest.mark.parametrize(
    ("task", "most"),
    [("cliff", 0.75), pytest.param("faucet", 0.8, marks=pytest.mark.nightly)],
)
def test_a_published_task_runs_clean(task: str, most: float, tmp_path: Path) -> None:
    target = tmp_path / f"{task}.yaml"
    invoke("import", "apex-mr", DATA, "--task", task, "-o", target, code=0)
    scenario = load_scenario(target)
    planned = plan_scenario(scenario, tmp_path)
    assert verify_plan(planned.tpg).problems == ()
    summary = executed(scenario, planned.tpg, tmp_path / "run").summary
    assert summary["outcome"] == "completed"
    assert summary["makespan_s"] <= most * summary["makespan_sequential_s"]
