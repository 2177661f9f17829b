import json
import os
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.errors import OutputError, RequestError
from planning.files import replace_atomically
from scheduling.graph.plan_files import load_plan, save_plan
from tests.twin.program import invoke
from tests.twin.turning_arms import planned_arms, run_arms
from twin.host.atomic_files import write_json
from twin.runs.folder import (
    drop_earlier_results,
    prepare_run_folder,
    recorded_hashes,
    recover_folder,
    require_recorded_hashes,
    run_folder,
    set_aside_results,
)
from twin.trial.plan_result import plan_of_run


def test_a_folder_is_made_below_logs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first, second = prepare_run_folder(None, "cliff"), prepare_run_folder(None, "cliff")
    assert first != second
    for folder in (first, second):
        assert folder.is_dir()
        assert re.fullmatch(r"cliff-\d{8}T\d{6}Z(-\d+)?", folder.name)
        assert folder.parent == Path("logs")


OLD = {
    name: f"old {name}"
    for name in (
        *("in-turns/plan.json", "in-turns/plan.npz", "manifest.json", "plan.npz"),
        *("events.jsonl", "run.rrd", "summary.json"),
    )
}
NEW = {
    name: f"new {name}"
    for name in (
        *("manifest.json", "in-turns/plan.json", "events.jsonl", "gantt.png"),
        "summary.json",
    )
}


class Killed(BaseException):
    """The process ends here; nothing is cleaned up."""


class Mortal:
    """Lets the process die at the k-th change to the file system."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.left = -1
        for owner, name in (
            *(
                (Path, name)
                for name in ("replace", "unlink", "mkdir", "rmdir", "write_text")
            ),
            (os, "unlink"),
            (os, "rmdir"),
        ):
            monkeypatch.setattr(owner, name, self._mortal(getattr(owner, name)))

    def _mortal(self, change: Callable[..., Any]) -> Callable[..., Any]:
        def changed(*args: Any, **kwargs: Any) -> Any:
            if self.left == 0:
                raise Killed
            self.left -= 1
            return change(*args, **kwargs)

        return changed

    def lives(self, changes: int, work: Callable[[], None]) -> bool:
        """Do some work, dying after so many changes; tell whether it was done."""
        self.left = changes
        try:
            work()
        except Killed:
            return False
        finally:
            self.left = -1
        return True


def visible(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_text() for path in files}


def fill(folder: Path, contents: dict[str, str]) -> None:
    (folder / "in-turns").mkdir()
    for name, text in contents.items():
        (folder / name).write_text(text)


def test_old_or_new_results_are_whole_wherever_a_process_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mortal = Mortal(monkeypatch)

    def work(folder: Path) -> None:
        set_aside_results(folder)
        fill(folder, NEW)
        drop_earlier_results(folder)

    outcomes = set()
    for first in range(50):
        for second in range(0, 30, 1 if first % 3 == 0 else 7):
            folder = tmp_path / f"{first}-{second}"
            folder.mkdir()
            fill(folder, OLD)
            done = mortal.lives(first, partial(work, folder))
            # Whoever sweeps up may die as well.
            mortal.lives(second, partial(recover_folder, folder))
            recover_folder(folder)
            there = visible(folder)
            assert there in (OLD, NEW), (first, second)
            assert not done or there == NEW
            outcomes.add(there["summary.json"])
    assert outcomes == {"old summary.json", "new summary.json"}


def test_results_stay_until_the_new_ones_are_whole(tmp_path: Path) -> None:
    out = tmp_path / "run"
    out.mkdir()
    (out / "summary.json").write_text("old")
    (out / ".plan.json.99.part").write_text("half")
    (out / "notes.txt").write_text("mine")
    with pytest.raises(RuntimeError), run_folder(out, "cliff") as folder:  # noqa: PT012
        assert visible(folder) == {"summary.json": "old", "notes.txt": "mine"}
        set_aside_results(folder)
        assert sorted(p.name for p in out.iterdir()) == [".before", "notes.txt"]
        (folder / "events.jsonl").write_text("new")
        raise RuntimeError
    assert visible(out) == {"summary.json": "old", "notes.txt": "mine"}


def test_a_second_process_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("old")
    with (
        run_folder(tmp_path, "cliff"),
        pytest.raises(OutputError, match="a running process writes its results"),
        run_folder(tmp_path, "cliff"),
    ):
        pass
    assert visible(tmp_path) == {"summary.json": "old"}


def test_a_folder_made_for_nothing_goes_again(tmp_path: Path) -> None:
    with pytest.raises(KeyError), run_folder(tmp_path / "a" / "b", "cliff"):
        raise KeyError
    assert not (tmp_path / "a" / "b").exists()


def test_the_folder_of_a_study_is_not_taken(tmp_path: Path) -> None:
    (tmp_path / "blocks").mkdir()
    with (
        pytest.raises(RequestError, match="holds a study"),
        run_folder(tmp_path, "cliff"),
    ):
        pass


@pytest.mark.parametrize("name", ["x" * 300, "a\0b"])
def test_a_name_that_no_file_system_takes_is_an_error(name: str) -> None:
    with pytest.raises(OutputError), run_folder(Path("/tmp") / name, "cliff"):
        pass


def test_a_place_that_cannot_be_written_is_an_error_at_once(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(OutputError, match="file"):
        prepare_run_folder(blocked / "run", "cliff")
    with pytest.raises(OutputError, match="file"):
        prepare_run_folder(blocked, "cliff")


def test_a_file_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "value.json"
    write_json(path, {"a": 1})
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"a": float("nan")})
    with pytest.raises(ZeroDivisionError), replace_atomically(path) as temporary:
        temporary.write_bytes(b"half") / 0
    assert json.loads(path.read_text()) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["value.json"]


def test_a_run_without_a_recording_cannot_be_replayed(tmp_path: Path) -> None:
    for folder, why in (
        (tmp_path, "it has no run.rrd"),
        (tmp_path / "x", "no such file"),
    ):
        said = invoke("replay", folder, code=2).stderr
        assert "nothing to replay" in said
        assert why in said


def test_without_a_display_replay_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run.rrd").write_bytes(b"")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    said = invoke("replay", tmp_path, code=1).stderr
    assert "rerun run.rrd" in said
    assert "--stills" in said


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario, a plan of it, and a run of the plan."""
    folder = planned_arms(tmp_path_factory.mktemp("runs"))
    run_arms(folder)
    return folder


@pytest.fixture
def run(place: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(place / "run", tmp_path / "run"))


def test_a_run_names_what_it_wrote(run: Path) -> None:
    files = json.loads((run / "summary.json").read_text())["files"]
    assert files == recorded_hashes(run)
    assert set(files) == {
        *("plan.json", "plan.npz", "events.jsonl"),
        *("trajectory.parquet", "objects.parquet"),
    }
    require_recorded_hashes(run, files)


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("export", "-f", "csv"), "events.jsonl"),
        (("export", "-f", "csv"), "trajectory.parquet"),
        (("export", "-f", "csv"), "objects.parquet"),
        (("export", "-f", "graphml"), "plan.json"),
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
    said = invoke(first, run, *events, *options, code=2).output
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
    said = invoke("verify", run, code=2).output
    assert "is not the one of manifest.json beside it" in said.replace("\n", " ")
    (run / "manifest.json").unlink()
    assert len(plan_of_run(run).chains) == 2  # a plan alone stands for itself


def test_a_damaged_summary_is_no_reason_to_believe_the_rest(run: Path) -> None:
    (run / "summary.json").write_text("[]")
    with pytest.raises(OutputError, match="no summary of a run"):
        require_recorded_hashes(run, ("plan.json",))


def test_paths_in_a_manifest_are_seen_from_its_folder(place: Path) -> None:
    manifest = json.loads((place / "run" / "manifest.json").read_text())
    assert manifest["base"] == ".."
    assert str(place) not in (place / "run" / "manifest.json").read_text()
    assert str(place) not in (place / "run" / "plan.json").read_text()


def test_more_stalls_than_nodes_are_told_of(tmp_path: Path) -> None:
    stalled = run_arms(planned_arms(tmp_path), "--stalls", 100)
    warnings = json.loads((stalled / "summary.json").read_text())["warnings"]
    told = [text for text in warnings if "stalls.count_per_robot is 100" in text]
    assert len(told) == 2
    assert "robot 'left' has" in told[0]
