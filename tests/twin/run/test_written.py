from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from planning.errors import OutputError
from scheduling.build_tpg import build_tpg
from scheduling.graph.plan_files import load_plan, save_plan
from tests.twin.turning_arms import SCENARIO, turning_plan
from twin.cli import app
from twin.planning.build_workcell import build_workcell
from twin.run.written import hashes_as_written, require_as_written
from twin.scenario.file import load_scenario
from twin.trial.plan_result import plan_of_run


def invoke(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    return result.exit_code, result.output


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario, a plan of it, and a run of the plan."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "two.yaml").write_text(SCENARIO)
    cell = build_workcell(load_scenario(folder / "two.yaml"), folder)
    save_plan(build_tpg(turning_plan(cell)), folder / "plan")
    options = ["--plan", folder / "plan", "--no-audit", "--no-recording"]
    for out, more in (("run", []), ("stalled", ["--stalls", 100])):
        code, said = invoke(
            "run", folder / "two.yaml", *options, *more, "--out", folder / out
        )
        assert code == 0, said
    return folder


@pytest.fixture
def run(place: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(place / "run", tmp_path / "run"))


def test_a_run_names_what_it_wrote(run: Path) -> None:
    files = json.loads((run / "summary.json").read_text())["files"]
    assert files == hashes_as_written(run)
    assert set(files) == {
        *("plan.json", "plan.npz", "events.jsonl"),
        *("trajectory.parquet", "objects.parquet"),
    }
    require_as_written(run, files)


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("export", "-f", "csv"), "events.jsonl"),
        (("export", "-f", "csv"), "trajectory.parquet"),
        (("export", "-f", "csv"), "objects.parquet"),
        (("export", "-f", "dot"), "plan.json"),
        (("verify",), "plan.npz"),
        (("resume",), "events.jsonl"),
        (("follow", "--once"), "plan.json"),
    ],
)
def test_files_that_are_not_as_written_are_refused(
    run: Path, command: tuple[str, ...], name: str
) -> None:
    content = (run / name).read_bytes()
    later = content.replace(b'"t_s": 0.000000000', b'"t_s": 0.000000001', 1)
    (run / name).write_bytes(later if later != content else content + b"\n")
    first, *options = command
    events = [run / "events.jsonl"] if first == "follow" else []
    code, said = invoke(first, run, *events, *options)
    assert code == 2, said
    assert f"{run / name} is not as the run wrote it" in said.replace("\n", "")


def test_a_plan_of_another_run_is_refused_even_without_a_summary(
    place: Path, run: Path
) -> None:
    (run / "summary.json").unlink()
    assert len(plan_of_run(run).chains) == 2
    tpg = load_plan(run)
    for chain in tpg.chains:
        chain.duration.setflags(write=True)
        np.multiply(chain.duration, 2.0, out=chain.duration)
    save_plan(tpg, run)
    with pytest.raises(OutputError, match=r"is not the one of manifest\.json beside"):
        plan_of_run(run)
    code, said = invoke("verify", run)
    assert code == 2
    assert "is not the one of manifest.json beside it" in said.replace("\n", " ")
    (run / "manifest.json").unlink()
    assert len(plan_of_run(run).chains) == 2  # a plan alone stands for itself


def test_a_damaged_summary_is_no_reason_to_believe_the_rest(run: Path) -> None:
    (run / "summary.json").write_text("[]")
    with pytest.raises(OutputError, match="no summary of a run"):
        require_as_written(run, ("plan.json",))


def test_paths_in_a_manifest_are_seen_from_its_folder(place: Path) -> None:
    manifest = json.loads((place / "run" / "manifest.json").read_text())
    assert manifest["base"] == ".."
    assert str(place) not in (place / "run" / "manifest.json").read_text()
    assert str(place) not in (place / "run" / "plan.json").read_text()


def test_more_stalls_than_nodes_are_told_of(place: Path) -> None:
    warnings = json.loads((place / "stalled" / "summary.json").read_text())["warnings"]
    told = [text for text in warnings if "stalls.count_per_robot is 100" in text]
    assert len(told) == 2
    assert "robot 'left' has" in told[0]
