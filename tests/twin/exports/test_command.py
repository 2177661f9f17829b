"""``twin export``: what it writes where, and what it says when it cannot."""

import json
from io import BytesIO
from pathlib import Path

import networkx as nx
import pytest

from tests.twin.program import invoke
from tests.twin.turning_arms import planned_arms, run_arms
from twin.registry import EXPORTS


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_arms(planned_arms(tmp_path_factory.mktemp("runs")))


TABLES = ("events", "trajectory", "objects")
FILES = {
    "csv": [f"{name}.csv" for name in TABLES],
    "parquet": [f"{name}.parquet" for name in TABLES],
    "perfetto": ["trace.json"],
    "joint-trajectory": ["joint_trajectories.json"],
    "joint-csv": ["joints_left.csv", "joints_right.csv"],
    "mcap": ["run.mcap"],
    "graphml": ["tpg.graphml"],
    "task-graph": ["task_graph.graphml"],
    "open-plan": ["open_plan.json"],
}


def test_models_of_ldraw_are_of_lego(run: Path) -> None:
    result = invoke("export", run, "--format", "ldraw", code=2)
    assert "only a LEGO assembly is a model of LDraw" in result.stderr
    assert sorted([*FILES, "ldraw"]) == sorted(EXPORTS.names())


@pytest.mark.parametrize("name", FILES)
def test_every_format_of_a_real_run(name: str, run: Path) -> None:
    result = invoke("export", run, "--format", name, code=0)
    files = [run / "exports" / file for file in FILES[name]]
    assert result.stdout.splitlines() == [str(file) for file in files]
    assert all(file.stat().st_size > 100 for file in files)


def test_several_formats_go_into_one_folder(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "here"
    two = ("export", run, "-f", "graphml", "-f", "perfetto")
    invoke(*two, "-f", "graphml", "-o", out, code=0)
    assert {p.name for p in out.iterdir()} == {"tpg.graphml", "trace.json"}
    (tmp_path / "taken").write_text("a file")
    assert "this is a file" in invoke(*two, "-o", tmp_path / "taken", code=2).stderr


def test_a_single_file_goes_where_it_is_asked_to(run: Path, tmp_path: Path) -> None:
    file = tmp_path / "deep" / "plan.graphml"
    invoke("export", run, "-f", "graphml", "--out", file, code=0)
    tasks = nx.read_graphml(BytesIO(file.read_bytes()))
    invoke("export", run, "-f", "graphml", "--nodes", "-o", file, code=0)
    nodes = nx.read_graphml(BytesIO(file.read_bytes()))
    assert 0 < tasks.number_of_nodes() < nodes.number_of_nodes()
    invoke("export", run, "-f", "perfetto", "-o", tmp_path, code=0)
    assert json.loads((tmp_path / "trace.json").read_text())["traceEvents"]
    invoke("export", run, "-f", "csv", "-o", tmp_path / "tables", code=0)
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
    result = invoke("export", run, *options, code=2)
    assert words in result.stderr
    assert "open-plan, ldraw)" in result.stderr


def test_an_unknown_run_names_those_beside_it(run: Path) -> None:
    for folder in (run.parent / "frist", run.parent):
        result = invoke("export", folder, "--format", "csv", code=2)
        assert f"(valid: {run})" in result.stderr
    assert "this is no run, it has no manifest.json" in result.stderr


def test_what_a_run_lacks_is_named(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    folder.mkdir()
    for name in ("manifest.json", "events.jsonl"):
        (folder / name).write_bytes((run / name).read_bytes())
    for name, lacks in (("csv", "trajectory.parquet"), ("graphml", "plan.json")):
        result = invoke("export", folder, "--format", name, code=2)
        assert f"this run has no {lacks}" in result.stderr
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
    result = invoke("export", tmp_path, "--format", "graphml", code=2)
    assert "robot 'middle', which plan.json does not have" in result.stderr


def test_help_names_every_format() -> None:
    text = invoke("export", "--help").stdout
    assert all(name in text for name in EXPORTS.names())
