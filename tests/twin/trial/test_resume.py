"""A run that was killed, or found no room, is resumed: its files are those of a run that never was."""

import json
import resource
import shutil
import signal
from pathlib import Path

import pytest
from typer.testing import Result

from planning.errors import OutputError
from tests.twin.program import invoke, python
from tests.twin.turning_arms import QUICK, planned_arms, run_arms, running
from twin.runs.folder import lock_folder
from twin.trial.errors import ResumeError
from twin.trial.resume import resume_run

DISTURBED = """\
  stalls: {rate_per_h: 600, duration: {kind: fixed, value_s: 2}}
  emergency_stops: [{at_s: 1.0, duration_s: 2.0}]
"""

KILLED = """
import os, signal, sys
from twin.recorders.observers import JsonlRecorder
from twin.cli import app

write = JsonlRecorder.record
count = int(sys.argv.pop(1))

def record(self, event):
    global count
    count -= 1
    if count == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    write(self, event)

JsonlRecorder.record = record
app()
"""


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return planned_arms(tmp_path_factory.mktemp("plan"), DISTURBED)


@pytest.fixture(scope="module")
def whole(plan: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was never killed."""
    return run_arms(plan, out=tmp_path_factory.mktemp("whole") / "run")


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}


def cut(whole: Path, to: Path, size: int) -> Path:
    """The folder as a kill leaves it: the log cut off, nothing that comes later."""
    shutil.copytree(whole, to)
    for name in ("trajectory.parquet", "objects.parquet", "gantt.png", "summary.json"):
        (to / name).unlink()
    with (to / "events.jsonl").open("rb+") as file:
        file.truncate(size)
    return to


def test_a_killed_run_is_brought_to_its_end(
    plan: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    command = running(plan, out, *QUICK)
    python(KILLED, 17, *command, code=-signal.SIGKILL)
    assert len((out / "events.jsonl").read_text().splitlines()) == 16
    assert not (out / "summary.json").exists()
    result = invoke("resume", out, code=0)
    assert "16 events of the log happened again" in result.stdout
    assert contents(out) == contents(whole)


@pytest.mark.parametrize("share", [None, 0.0, 0.001, 0.37, 0.9, 1.0])
def test_a_log_may_be_torn_anywhere_or_missing(
    whole: Path, tmp_path: Path, share: float | None
) -> None:
    size = int((share or 0.0) * (whole / "events.jsonl").stat().st_size)
    out = cut(whole, tmp_path / "run", size)
    if share is None:
        (out / "events.jsonl").unlink()
    done = resume_run(out)
    assert contents(out) == contents(whole)
    lines = (whole / "events.jsonl").read_bytes()[:size].count(b"\n")
    assert done.resumed is not None
    assert done.resumed.agreed == lines
    assert sum(done.resumed) == len((whole / "events.jsonl").read_text().splitlines())


def test_a_run_that_the_user_broke_off_is_resumed(whole: Path, tmp_path: Path) -> None:
    size = (whole / "events.jsonl").read_bytes().find(b"\n", 2000) + 1
    out = cut(whole, tmp_path / "run", size)
    with (out / "events.jsonl").open("a") as file:
        for kind, detail in (
            ("stopped", "interrupted by the user"),
            ("finished", "aborted"),
        ):
            file.write(
                f'{{"t_s": 1.000000000, "robot": "", "kind": "{kind}", "task": -1, '
                f'"node": -1, "object": "", "detail": "{detail}"}}\n'
            )
    (out / "summary.json").write_text("{}")
    resume_run(out)
    assert contents(out) == contents(whole)


def test_a_run_that_has_ended_is_left_alone(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    shutil.copytree(whole, out)
    before = contents(out)
    result = invoke("resume", out, code=0)
    assert "come to its end already" in result.stdout
    assert contents(out) == before
    assert json.loads(invoke("resume", out, "--json").stdout)["outcome"] == "completed"


def test_a_log_of_another_run_is_refused_and_left_alone(
    whole: Path, tmp_path: Path
) -> None:
    out = cut(whole, tmp_path / "run", 3000)
    log = (out / "events.jsonl").read_text()
    changed = log.replace('"kind": "started"', '"kind": "stalled"', 2)
    (out / "events.jsonl").write_text(changed)
    number = next(
        k
        for k, pair in enumerate(
            zip(log.splitlines(), changed.splitlines(), strict=True), 1
        )
        if pair[0] != pair[1]
    )
    with pytest.raises(ResumeError, match=rf"events.jsonl:{number}: the log says"):
        resume_run(out)
    assert (out / "events.jsonl").read_text() == changed
    invoke("resume", out, code=1)


def test_folders_without_a_run_are_refused(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="no run to resume"):
        resume_run(tmp_path)
    out = cut(whole, tmp_path / "run", 0)
    content = json.loads((out / "manifest.json").read_text())
    del content["run"]
    (out / "manifest.json").write_text(json.dumps(content))
    with pytest.raises(OutputError, match="does not say how to resume: 'run'"):
        resume_run(out)
    content["scenario"]["seed"] = 5
    (out / "manifest.json").write_text(json.dumps(content))
    with pytest.raises(OutputError, match="scenario_sha256"):
        resume_run(out)
    invoke("resume", out, code=2)


def test_a_run_that_is_alive_is_not_resumed(whole: Path, tmp_path: Path) -> None:
    out = cut(whole, tmp_path / "run", 0)
    with lock_folder(out):
        result = invoke("resume", out, code=2)
    assert "a running process writes its results there" in result.stderr
    assert (out / "events.jsonl").read_bytes() == b""
    resume_run(out)
    assert contents(out) == contents(whole)


def full(limit: int, *arguments: str) -> Result:
    """Run a command where no file can become longer than so many bytes."""
    kept = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, kept[1]))
    try:
        return invoke(*arguments)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, kept)


@pytest.mark.parametrize(
    "limit",
    [
        0,
        700,
        20_000,
        *(pytest.param(k, marks=pytest.mark.nightly) for k in (3000, 9000)),
    ],
)
def test_a_full_disk_is_a_failed_run(
    plan: Path, whole: Path, tmp_path: Path, limit: int
) -> None:
    largest = max(len(content) for content in contents(whole).values())
    assert limit < largest
    out = tmp_path / "run"
    done = full(limit, *running(plan, out, *QUICK))
    assert done.exit_code in (1, 2), done.stderr
    assert isinstance(done.exception, SystemExit)
    assert "Traceback" not in done.stderr
    assert "File too large" in done.stderr
    assert not (out / "summary.json").exists()
    if (out / "manifest.json").exists() and (out / "plan.npz").exists():
        invoke("resume", out, code=0)
        assert contents(out) == contents(whole)


def test_a_recording_that_does_not_fit_is_a_failed_run(
    plan: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    largest = max(len(content) for content in contents(whole).values())
    done = full(largest + 1, *running(plan, out, "--no-audit", "-q"))
    assert done.exit_code == 1, done.stderr
    assert "run.rrd" in done.stderr
    assert not (out / "run.rrd").exists()
    assert not (out / "summary.json").exists()


def test_earlier_results_outlive_a_full_disk(
    plan: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    run_arms(plan, out=out)
    before = contents(out)
    done = full(3000, *running(plan, out, *QUICK))
    assert done.exit_code == 1
    assert contents(out) == before


def test_a_study_on_a_full_disk_has_failed(whole: Path, tmp_path: Path) -> None:
    study = ("study", "--plan", str(whole), "-n", "20", "--workers", "0", "--quiet")
    done = full(2000, *study, "--out", str(tmp_path / "study"))
    assert done.exit_code == 1, done.stderr
    assert "File too large" in done.stderr
    assert isinstance(done.exception, SystemExit)
    assert "Traceback" not in done.stderr
