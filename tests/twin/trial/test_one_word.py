"""Run, its plan executed again, and studies of it agree on names, plans and baselines."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

import twin
from planning.errors import ScenarioError
from tests.twin.planning.test_pipeline import SCENARIO
from tests.twin.program import invoke
from tests.twin.turning_arms import QUICK
from tests.twin.written import written

SHORTCUTS = "asynchronous + shortcuts"
FEW = ("-n", "20", "--workers", "0", "-q")


done = partial(invoke, code=0)
refused = partial(invoke, code=2)


def summary(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return found


def makespans(folder: Path) -> dict[str, list[float]]:
    out: dict[str, list[float]] = {}
    for row in pq.read_table(folder / "replications.parquet").to_pylist():
        out.setdefault(row["policy"], []).append(row["makespan_s"])
    return out


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("words"), SCENARIO, name="three.yaml")


@pytest.fixture(scope="module")
def run(file: Path) -> Path:
    done("run", file, "--out", file.parent / "run", *QUICK)
    return file.parent / "run"


def test_a_plan_that_is_executed_again_keeps_its_baseline(
    file: Path, run: Path, tmp_path: Path
) -> None:
    first = summary(run)
    assert (first["policy"], first["plan"]) == (SHORTCUTS, "shortened")
    done("run", file, "--plan", run, "--out", tmp_path / "a", *QUICK)
    done("run", file, "--plan", tmp_path / "a", "--out", tmp_path / "b", *QUICK)
    for name in ("a", "b"):
        again = summary(tmp_path / name)
        # What planning took and could choose from is said of planning alone.
        keys = "planning_s", "makespan_bound_s", "assignment_search"
        of_planning = {key: first[key] for key in keys if key in first}
        assert again | of_planning == first
    # The plan in turns has a longer way: shortcuts are left out of the baseline.
    done("run", file, "--plan", run / "in-turns", "--out", tmp_path / "c", *QUICK)
    turns = summary(tmp_path / "c")
    assert (turns["policy"], turns["plan"]) == ("asynchronous", "in turns")
    assert turns["makespan_sequential_s"] == first["makespan_sequential_s"]
    # The same motions without shortcuts are what shortcuts are held against.
    assert turns["makespan_s"] == first["makespan_asynchronous_s"]
    assert turns["makespan_asynchronous_s"] is None
    assert not (tmp_path / "c" / "in-turns").exists()


def test_a_plan_in_turns_that_was_changed_is_refused(file: Path, run: Path) -> None:
    turns = (run / "in-turns" / "plan.npz").read_bytes()
    other = (run / "plan.npz").read_bytes()
    document = (run / "in-turns" / "plan.json").read_text()
    try:
        (run / "in-turns" / "plan.npz").write_bytes(other)
        (run / "in-turns" / "plan.json").write_text((run / "plan.json").read_text())
        out = file.parent / "x"
        result = refused("run", file, "--plan", run, "--out", out, *QUICK)
        assert "not the plan in turns of the manifest" in result.stderr
    finally:
        (run / "in-turns" / "plan.npz").write_bytes(turns)
        (run / "in-turns" / "plan.json").write_text(document)


@pytest.mark.nightly
def test_a_study_of_the_plan_is_the_study_of_the_scenario(
    file: Path, run: Path, tmp_path: Path
) -> None:
    policies = ("sequential", "asynchronous", SHORTCUTS)
    options = [word for policy in policies for word in ("--policy", policy)]
    # Written as it used to be.
    planned = [word.replace(" + shortcuts", "+shortcut") for word in options]
    done("study", file, *planned, *FEW, "--out", tmp_path / "planned")
    done("study", "--plan", run, *options, *FEW, "--out", tmp_path / "given")
    found = makespans(tmp_path / "given")
    assert tuple(found) == policies
    assert found == makespans(tmp_path / "planned")
    # The first replication draws what the run drew.
    first = summary(run)
    assert found["sequential"][0] == first["makespan_sequential_s"]
    assert found[SHORTCUTS][0] == first["makespan_s"]
    cells = [cell["policy"] for cell in summary(tmp_path / "given")["cells"]]
    assert tuple(cells) == policies
    assert (tmp_path / "given" / "plans" / "in-turns" / "plan.json").exists()
    done("study", "--resume", tmp_path / "given", "--workers", "0", "-q")
    assert makespans(tmp_path / "given") == found


def test_a_given_plan_is_studied_under_its_own_policy(
    file: Path, run: Path, tmp_path: Path
) -> None:
    done("study", file, "--plan", run, *FEW, "--out", tmp_path / "given")
    policies = ("sequential", "asynchronous", SHORTCUTS)
    assert tuple(makespans(tmp_path / "given")) == policies


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            ("--policy", "synchronous"),
            "policy 'synchronous' needs the plan in slots, the given one is shortened"
            f" (valid: sequential, asynchronous, {SHORTCUTS}, open-loop)",
        ),
        (("--policy", "greedy"), "no policy 'greedy'"),
        (("--shortcuts", "5"), "shortcuts are for planning"),
    ],
)
def test_what_a_given_plan_cannot_be_studied_under(
    run: Path, tmp_path: Path, options: tuple[str, ...], says: str
) -> None:
    result = refused("study", "--plan", run, *options, *FEW, "--out", tmp_path / "no")
    assert says in " ".join(result.stderr.split())


def test_run_says_how_a_policy_with_another_plan_is_had(file: Path) -> None:
    result = refused("run", file, "--policy", "asynchronous+shortcut", *QUICK)
    assert (
        f"policy '{SHORTCUTS}' is asynchronous of the plan shortened" in result.stderr
    )


STILL = """
version: 1
name: still
cell:
  robots:
    - {name: left, model: panda, base: {xyz_m: [-0.6, 0, 0]}}
assembly:
  kind: goals
  moves: [{robot: left, to_deg: [0, -45, 0, -135, 0, 90, 45]}]
"""


def test_where_nobody_moves_there_is_nothing_to_plan(tmp_path: Path) -> None:
    (tmp_path / "still.yaml").write_text(STILL)
    with pytest.raises(ScenarioError, match="every robot stands where it is to be"):
        twin.plan(tmp_path / "still.yaml")
