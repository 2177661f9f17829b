"""``twin export``: what it writes where, and what it says when it cannot."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import networkx as nx
import pytest
from typer.testing import CliRunner, Result

from scheduling.build_tpg import build_tpg
from scheduling.graph.plan_files import save_plan
from tests.twin.turning_arms import SCENARIO, turning_plan
from twin.cli import app
from twin.exports.formats import FORMATS
from twin.planning.build_workcell import build_workcell
from twin.scenario.manifest import load_scenario


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    (folder / "two.yaml").write_text(SCENARIO)
    cell = build_workcell(load_scenario(folder / "two.yaml"), folder)
    save_plan(build_tpg(turning_plan(cell)), folder / "plan")
    out = folder / "first"
    options = ["--plan", folder / "plan", "--out", out, "--no-audit", "--no-recording"]
    result = invoke("run", folder / "two.yaml", *options)
    assert result.exit_code == 0, result.output
    return out


TABLES = ("events", "trajectory", "objects")
FILES = {
    "csv": [f"{name}.csv" for name in TABLES],
    "parquet": [f"{name}.parquet" for name in TABLES],
    "perfetto": ["trace.json"],
    "joint-trajectory": ["joint_trajectories.json"],
    "joint-csv": ["joints_left.csv", "joints_right.csv"],
    "mcap": ["run.mcap"],
    "graphml": ["tpg.graphml"],
    "dot": ["tpg.dot"],
    "task-graph": ["task_graph.graphml"],
}


def test_models_of_ldraw_are_of_lego(run: Path) -> None:
    result = invoke("export", run, "--format", "ldraw")
    assert result.exit_code == 2
    assert "only a LEGO assembly is a model of LDraw" in result.stderr
    assert sorted([*FILES, "ldraw"]) == sorted(FORMATS)


@pytest.mark.parametrize("name", FILES)
def test_every_format_of_a_real_run(name: str, run: Path) -> None:
    result = invoke("export", run, "--format", name)
    assert result.exit_code == 0, result.output
    files = [run / "exports" / file for file in FILES[name]]
    assert result.stdout.splitlines() == [str(file) for file in files]
    assert all(file.stat().st_size > 100 for file in files)


def test_several_formats_go_into_one_folder(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "here"
    result = invoke(
        "export", run, "-f", "dot", "-f", "perfetto", "-f", "dot", "-o", out
    )
    assert result.exit_code == 0, result.output
    assert {p.name for p in out.iterdir()} == {"tpg.dot", "trace.json"}
    (tmp_path / "taken").write_text("a file")
    result = invoke(
        "export", run, "-f", "dot", "-f", "perfetto", "-o", tmp_path / "taken"
    )
    assert result.exit_code == 2
    assert "this is a file" in result.stderr


def test_a_single_file_goes_where_it_is_asked_to(run: Path, tmp_path: Path) -> None:
    file = tmp_path / "deep" / "plan.graphml"
    assert invoke("export", run, "-f", "graphml", "--out", file).exit_code == 0
    tasks = nx.read_graphml(BytesIO(file.read_bytes()))
    assert invoke("export", run, "-f", "graphml", "--nodes", "-o", file).exit_code == 0
    nodes = nx.read_graphml(BytesIO(file.read_bytes()))
    assert 0 < tasks.number_of_nodes() < nodes.number_of_nodes()
    assert invoke("export", run, "-f", "perfetto", "-o", tmp_path).exit_code == 0
    assert json.loads((tmp_path / "trace.json").read_text())["traceEvents"]
    result = invoke("export", run, "-f", "csv", "-o", tmp_path / "tables")
    assert result.exit_code == 0
    assert len(list((tmp_path / "tables").iterdir())) == 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--format", "xlsx"], "unknown format 'xlsx' (valid: csv, parquet, perfetto,"),
        ([], "--format is missing (valid: csv, parquet, perfetto,"),
    ],
)
def test_an_unknown_format_names_those_there_are(
    options: list[str], words: str, run: Path
) -> None:
    result = invoke("export", run, *options)
    assert result.exit_code == 2
    assert words in result.stderr
    assert "task-graph, ldraw)" in result.stderr


def test_an_unknown_run_names_those_beside_it(run: Path) -> None:
    for folder in (run.parent / "frist", run.parent):
        result = invoke("export", folder, "--format", "csv")
        assert result.exit_code == 2
        assert f"(valid: {run})" in result.stderr
    assert "this is no run, it has no manifest.json" in result.stderr


def test_what_a_run_lacks_is_named(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    folder.mkdir()
    for name in ("manifest.json", "events.jsonl"):
        (folder / name).write_bytes((run / name).read_bytes())
    result = invoke("export", folder, "--format", "csv")
    assert result.exit_code == 2
    assert "this run has no trajectory.parquet" in result.stderr
    result = invoke("export", folder, "--format", "dot")
    assert "this run has no plan.json" in result.stderr
    with (folder / "events.jsonl").open("a") as log:
        log.write('{"t_s": 1.0, "robot": "left", "kind": "danced"}\n')
    result = invoke("export", folder, "--format", "parquet")
    assert "events.jsonl:" in result.stderr
    assert "unknown kind 'danced' (valid: " in result.stderr
    assert not (folder / "exports").exists()


def test_a_log_of_another_plan_is_refused(run: Path, tmp_path: Path) -> None:
    for name in ("manifest.json", "events.jsonl", "plan.json", "plan.npz"):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    log = tmp_path / "events.jsonl"
    log.write_text(log.read_text().replace('"left"', '"middle"'))
    result = invoke("export", tmp_path, "--format", "dot")
    assert result.exit_code == 2
    assert "robot 'middle', which plan.json does not have" in result.stderr


def test_help_names_every_format() -> None:
    text = invoke("export", "--help").stdout
    assert all(name in text for name in FORMATS)
