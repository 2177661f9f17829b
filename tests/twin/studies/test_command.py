"""``twin study`` as people use it: run, kill, go on, and what it says to what cannot be."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from scheduling.graph.plan_files import load_plan, save_plan
from tests.twin.program import invoke
from twin.cli import app

ROOT = Path(__file__).parents[3]
SCENARIO = ROOT / "scenarios/multi_arm/rearrangement.yaml"
RUNS = 1000
"""Replications of each cell: two blocks."""

POLICIES = ("--policy", "sequential", "--policy", "asynchronous")
TABLES = (
    *("replications.parquet", "tasks.parquet", "edges.parquet", "summary.json"),
    *("gains.json", "gains.csv"),
)


def _twin(*arguments: str | Path, code: int) -> str:
    return " ".join(invoke(*arguments, code=code).output.split())


def _copy(study: Path, folder: Path, *without: str) -> Path:
    """Copy the study, without some of its files."""
    shutil.copytree(study, folder)
    for name in without:
        (folder / name).unlink()
    return folder


def _assert_same(folder: Path, study: Path, *names: str) -> None:
    for name in names:
        assert (folder / name).read_bytes() == (study / name).read_bytes(), name


def _resumed(folder: Path) -> subprocess.Popen[bytes]:
    """Go on with a study in a process of its own."""
    program = (sys.executable, "-m", "twin.cli", "study")
    options = ("--resume", str(folder), "--workers", "0", "-q")
    return subprocess.Popen([*program, *options], cwd=ROOT)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "whole"
    vary = ("--vary", "skills.pick.scale=1,2", "--deadline", "90")
    _twin(
        *("study", SCENARIO, "-n", str(RUNS), *POLICIES, *vary),
        *("--workers", "0", "--out", folder, "-q"),
        code=0,
    )
    return folder


@pytest.mark.nightly
def test_the_summary_has_what_the_pictures_show(tmp_path: Path) -> None:
    arguments = ("study", SCENARIO, "-n", "30", *POLICIES, "--sobol", "4", "-q")
    for name in ("one", "two"):
        _twin(*arguments, "--workers", "0", "--out", tmp_path / name, code=0)
    folder = tmp_path / "one"
    _assert_same(tmp_path / "two", folder, *TABLES)
    cells = json.loads((folder / "summary.json").read_text())["cells"]
    page = (folder / "report.html").read_text(encoding="utf-8")
    gains = json.loads((folder / "gains.json").read_text())["cells"]
    assert [cell["policy"] for cell in cells if "sobol" in cell] == ["asynchronous"]
    for cell, known in zip(cells, gains, strict=True):
        spans = [
            abs(one["more_s"]["estimate"] - one["less_s"]["estimate"])
            for one in cell["tornado"]
        ]
        assert spans == sorted(spans, reverse=True)
        shares = [one[k] for one in cell.get("sobol", ()) for k in ("first", "total")]
        changes = [one[k] for one in cell["tornado"] for k in ("less_s", "more_s")]
        for found in (*changes, *shares):
            assert found["low"] <= found["estimate"] <= found["high"]
        assert all(one["name"] in page for one in cell["tornado"])
        for many in (False, True):
            best = [gain for gain in known["gains"] if gain["many"] == many][:7]
            assert [gain for gain in cell["gains"] if gain["many"] == many] == best
        assert cell["makespan_p90_s"]["high"] is None
        assert cell["makespan_p90_s"]["replications_needed"] == 36
    assert "36 replications needed for an upper limit" in page


@pytest.mark.nightly
@pytest.mark.usefixtures("no_report")
def test_a_killed_study_goes_on(study: Path, tmp_path: Path) -> None:
    folder = _copy(study, tmp_path / "killed", *TABLES, "report.html")
    shutil.rmtree(folder / "blocks")
    process = _resumed(folder)
    blocks = folder / "blocks"
    deadline = time.monotonic() + 60
    while len(list(blocks.glob("[0-9]*.npz"))) < 2 and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.002)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    done = {path: path.stat().st_mtime_ns for path in blocks.glob("[0-9]*.npz")}
    assert len(done) >= 2
    assert not (folder / "replications.parquet").exists()
    _twin("study", "--resume", folder, "--workers", "0", "-q", code=0)
    _assert_same(folder, study, *TABLES)
    for path, written in done.items():
        assert path.stat().st_mtime_ns == written


def test_the_tables_are_tidy(study: Path) -> None:
    rows = pq.read_table(study / "replications.parquet")
    assert rows.num_rows == 4 * RUNS
    table = rows.to_pydict()
    keys = list(
        zip(
            table["policy"],
            table["skills.pick.scale"],
            table["replication"],
            strict=True,
        )
    )
    assert len(set(keys)) == len(keys)
    tasks = pq.read_table(study / "tasks.parquet").to_pydict()
    assert max(tasks["criticality"]) == 1.0
    assert all(
        low <= mid <= high
        for low, mid, high in zip(
            tasks["end_p10_s"], tasks["end_p50_s"], tasks["end_p90_s"], strict=True
        )
    )
    edges = pq.read_table(study / "edges.parquet").to_pydict()
    assert set(edges["cause"]) <= {"dependency", "conflict", "turn"}


def test_the_summary_says_how_sure_one_can_be(study: Path) -> None:
    summary = json.loads((study / "summary.json").read_text())
    for cell in summary["cells"]:
        mean = cell["makespan_s"]
        assert mean["low"] < mean["estimate"] < mean["high"]
        assert cell["makespan_p50_s"]["estimate"] < cell["makespan_p99_s"]["estimate"]
        assert cell["not_completed"]["estimate"] == 0 < cell["not_completed"]["high"]
    first, second = summary["differences"]
    assert first["makespan_s"]["high"] < 0
    assert second["makespan_s"]["estimate"] < first["makespan_s"]["estimate"]


class _Outside(HTMLParser):
    """Collects what a page would fetch from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.found += [
            value
            for name, value in attrs
            if name in ("src", "href", "xlink:href")
            and value
            and not value.startswith(("#", "data:"))
        ]


def test_the_report_opens_offline(study: Path) -> None:
    parser = _Outside()
    parser.feed((study / "report.html").read_text(encoding="utf-8"))
    assert parser.found == []
    assert parser.tags.count("svg") == 4 + 2 * 4
    names = ["cell", "makespan", "waits", "response-skills-pick-scale"]
    for policy in ("sequential", "asynchronous"):
        for scale in (1, 2):
            cell = f"{policy}-skills.pick.scale-{scale}"
            names += [f"gantt-{cell}", f"tornado-{cell}"]
    for name in names:
        assert (study / f"{name}.png").stat().st_size > 5000


def test_the_report_names_every_cell(study: Path) -> None:
    page = (study / "report.html").read_text(encoding="utf-8")
    for policy in ("sequential", "asynchronous"):
        for scale in (1, 2):
            label = f"{policy}, skills.pick.scale = {scale}"
            assert page.count(f"<h2>What decides: {label}</h2>") == 1
            assert f"{label}: tasks that were on the critical path most often" in page
            for what in ("one thing", "many at once"):
                gained = (
                    f"{label}: {what}, seconds gained with 95\u00a0% intervals, {RUNS}"
                )
                assert gained in page


def test_the_first_page_says_what_it_rests_on(study: Path) -> None:
    page = (study / "report.html").read_text(encoding="utf-8")
    first = page[: page.index("<h2>How long it takes</h2>")]
    assert first.count("<svg") == 1  # the cell
    for words in (
        "What is worth fixing",
        "gains of the model",
        "packaged times of a LEGO tool with force control",
        "execution.skills: these skills take the packaged times",  # a warning: no LEGO
        "(speed_model l1); joints have no limit of acceleration",
        "<th>Disturbances</th><td>none</td>",
        f"{RUNS} of each policy and variant, independent of each other",
        "<th>Varied: skills.pick.scale</th><td>1, 2</td>",
        "assembly-twin",
    ):
        assert words in first, words


def test_the_report_fits_a_narrow_window(study: Path) -> None:
    """No part but pictures, whose text stays legible, has a width of its own: these are scrolled."""
    page = (study / "report.html").read_text(encoding="utf-8")
    style = page[page.index("<style>") : page.index("</style>")]
    assert "figure { margin: .6rem 0; overflow-x: auto; }" in style
    assert "figure svg { display: block; width: 100%; height: auto; }" in style
    assert "table {" in style
    assert "min-width" not in style
    assert style.count("white-space: nowrap") == 2  # numbers, names of assumptions
    assert "white-space: pre-wrap" in style
    for tag in re.findall(r"<svg[^>]*>", page):
        assert "viewBox=" in tag
    for width in re.findall(r'style="width:(\d+)%"', page):
        assert int(width) <= 100


@pytest.mark.nightly
def test_the_same_study_gives_the_same_bytes(study: Path, tmp_path: Path) -> None:
    drawn = (*(path.name for path in study.glob("*.png")), "report.html")
    folder = _copy(study, tmp_path / "again", *drawn)
    assert _resumed(folder).wait() == 0
    _assert_same(folder, study, *drawn, *TABLES)
    assert "<dc:date" not in (study / "report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("no_report")
def test_the_terminal_says_what_is_worth_fixing(study: Path) -> None:
    arguments = ["study", "--resume", str(study), "--workers", "0"]
    found = CliRunner().invoke(app, arguments, env={"COLUMNS": "200"})
    assert found.exit_code == 0
    output = found.output
    assert "worth fixing (asynchronous, skills.pick.scale = 1)" in output
    cell = json.loads((study / "gains.json").read_text())["cells"][1]
    assert cell["policy"] == "asynchronous"
    for many, most in ((True, 2), (False, 3)):
        names = [gain["name"] for gain in cell["gains"] if gain["many"] == many]
        for name in names[:most]:
            assert f" {name} " in output
        assert f" {names[most]} " not in output


def test_a_folder_of_another_scenario_is_refused(study: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(SCENARIO.read_text().replace("name: ", "name: my-", 1))
    for arguments in (("--resume", study), ("--out", study)):
        output = _twin("study", other, *arguments, code=2)
        assert "holds a study of scenario" in output
    output = _twin("study", SCENARIO, "--out", study, code=2)
    assert "--resume" in output
    output = _twin("study", "--resume", tmp_path, code=2)
    assert "no folder of a study" in output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--policy", "asynchron"), "no policy 'asynchron'"),
        (("--vary", "skills.pik.scale=1,2"), "pik"),
        (("--vary", "stalls.count=1,2"), "execution.stalls has no 'count'"),
        (("--least", "30", "--most", "20"), "least <= most"),
        (("--deadline", "-3"), "must be more than 0 s"),
        pytest.param(
            ("--scheduler", "tcp://127.0.0.1:1"),
            "no scheduler answered",
            marks=pytest.mark.nightly,
        ),
    ],
)
def test_what_cannot_be_is_said_at_once(
    arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    started = time.monotonic()
    output = _twin("study", SCENARIO, *arguments, "--out", tmp_path / "study", code=2)
    assert message in output
    assert time.monotonic() - started < 15
    assert not (tmp_path / "study").exists()


def test_a_deadline_that_nothing_can_meet_is_refused(
    study: Path, tmp_path: Path
) -> None:
    folder = _copy(study, tmp_path / "study")
    about = json.loads((folder / "manifest.json").read_text())
    about["study"]["deadline_s"] = 5.0
    (folder / "manifest.json").write_text(json.dumps(about))
    output = _twin("study", "--resume", folder, "--workers", "0", code=2)
    assert "a deadline of 5 s is impossible" in output


@pytest.mark.usefixtures("no_report")
def test_damaged_and_stray_blocks_are_set_aside_and_computed_anew(
    study: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = _copy(study, tmp_path / "damaged", *TABLES, "report.html")
    blocks = sorted((folder / "blocks").glob("*.npz"))
    content = [path.read_bytes() for path in blocks]
    blocks[0].write_bytes(content[0][: len(content[0]) // 2])  # torn
    blocks[1].write_bytes(content[2])  # another block's
    middle = len(content[3]) // 2
    flipped = bytes(255 - byte for byte in content[3][middle : middle + 40])
    blocks[3].write_bytes(content[3][:middle] + flipped + content[3][middle + 40 :])
    stray = folder / "blocks" / "0-3000-500.npz"
    stray.write_bytes(content[0])
    _twin("study", "--resume", folder, "--workers", "0", "-q", code=0)
    said = caplog.text
    for path in (blocks[0], blocks[1], blocks[3]):
        assert f"{path}: is no block of a study" in said
    assert "is no block of this study and counts for nothing" in said
    assert not stray.exists()
    assert len(list((folder / "blocks" / "set-aside").iterdir())) == 4
    _assert_same(folder, study, *TABLES)


def test_a_study_of_something_else_is_not_gone_on_with(
    study: Path, tmp_path: Path
) -> None:
    folder = _copy(study, tmp_path / "other")
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    path.write_text(json.dumps({**manifest, "versions": {"numpy": "0.1"}}))
    said = _twin("study", "--resume", folder, "-q", code=2)
    assert "numpy was 0.1 and is" in said
    path.write_text(json.dumps(manifest))
    (plan,) = (folder / "plans").iterdir()
    tpg = load_plan(plan)
    tpg.chains[0].duration.setflags(write=True)
    np.multiply(tpg.chains[0].duration, 2.0, out=tpg.chains[0].duration)
    save_plan(tpg, plan)
    said = _twin("study", "--resume", folder, "-q", code=2)
    assert "is not the one that the study began with" in said
    changed = json.loads(json.dumps(manifest))
    changed["scenario"]["execution"]["stalls"]["rate_per_h"] = 10.0
    path.write_text(json.dumps(changed))
    said = _twin("study", "--resume", folder, "-q", code=2)
    assert "is not the one of scenario_sha256" in said
