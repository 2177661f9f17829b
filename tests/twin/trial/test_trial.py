"""A plan goes through twin, recorders and audit, and every promised file is there."""

import json
import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.twin.program import invoke
from tests.twin.turning_arms import QUICK, SCENARIO, planned_arms, run_arms, running
from tests.twin.written import written
from twin.runs.summary import summary_rows

FILES = {
    "manifest.json",
    "plan.json",
    "plan.npz",
    "events.jsonl",
    "trajectory.parquet",
    "objects.parquet",
    "gantt.png",
    "run.rrd",
    "summary.json",
}


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return planned_arms(tmp_path_factory.mktemp("plan"))


@pytest.fixture(scope="module")
def ran(plan: Path) -> tuple[Path, str]:
    """A run that is audited and recorded, and what was printed."""
    out = plan / "run"
    return out, invoke(*running(plan, out), code=0).stdout


def test_run_leaves_every_promised_file_and_prints_the_figures(
    ran: tuple[Path, str],
) -> None:
    out, printed = ran
    assert {p.name for p in out.iterdir()} == FILES
    summary = json.loads((out / "summary.json").read_text())
    assert summary["outcome"] == "completed"
    assert summary["audit"]["violations"] == []
    assert summary["audit"]["configurations"] > 10
    # Both arms work at once: the longer one decides, and nobody waits.
    assert summary["makespan_s"] < 0.75 * summary["makespan_sequential_s"]
    assert set(summary["wait_s"].values()) == {0.0}
    for word in ("makespan", "below", "wait of left", "nodes", "clean", "twin replay"):
        assert word in printed
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["scenario"]["name"] == "two"
    assert [r["name"] for r in manifest["robots"]] == ["left", "right"]


def test_every_file_key_and_column_is_documented(ran: tuple[Path, str]) -> None:
    out, _ = ran
    page = Path(__file__).parents[3] / "docs" / "reference" / "formats.md"
    words = set(re.findall(r"`([\w.]+)`", page.read_text()))
    names = {p.name for p in out.iterdir()}
    for table in ("trajectory", "objects"):
        names |= set(pq.read_schema(out / f"{table}.parquet").names)
    names |= set(json.loads((out / "events.jsonl").read_text().splitlines()[0]))
    summary = json.loads((out / "summary.json").read_text())
    names |= set(summary) | set(summary["audit"])
    names |= set(json.loads((out / "manifest.json").read_text()))
    names |= set(json.loads((out / "plan.json").read_text()))
    assert names - words - {f"q_{k}" for k in range(2, 9)} == set()


def test_json_output_is_the_summary_and_nothing_else(
    plan: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    result = invoke(*running(plan, out, "--json", *QUICK[:2]), code=0)
    assert result.stderr == ""
    content = json.loads(result.stdout)
    assert content["folder"] == str(out)
    assert content["audit"] is None
    assert {p.name for p in out.iterdir()} == FILES - {"run.rrd"}


def test_quiet_prints_nothing(plan: Path, tmp_path: Path) -> None:
    options = ("--quiet", *QUICK[:2])
    assert invoke(*running(plan, tmp_path / "run", *options), code=0).output == ""


def test_options_reach_the_run_and_the_manifest(plan: Path, tmp_path: Path) -> None:
    results = {}
    for stalls in (0, 3):
        out = tmp_path / f"run_{stalls}"
        options = ("--seed", 7, "--policy", "sequential", "--stalls", stalls)
        result = invoke(*running(plan, out, *options, "--json", *QUICK[:2]))
        results[stalls] = json.loads(result.stdout)
        manifest = json.loads((out / "manifest.json").read_text())
        assert manifest["seed"] == manifest["scenario"]["seed"] == 7
        assert manifest["scenario"]["execution"]["policy"] == "sequential"
    assert results[3]["makespan_s"] > results[0]["makespan_s"] + 6.0
    assert results[0]["makespan_s"] == results[0]["makespan_sequential_s"]


def test_the_same_seed_gives_the_same_tables(
    plan: Path, ran: tuple[Path, str], tmp_path: Path
) -> None:
    again = run_arms(plan, out=tmp_path / "again")
    tables = [
        (
            pq.read_table(out / "trajectory.parquet").to_pydict(),
            (out / "events.jsonl").read_text(),
        )
        for out in (ran[0], again)
    ]
    assert tables[0] == tables[1]


def test_a_plan_for_another_cell_is_refused(plan: Path, tmp_path: Path) -> None:
    other = written(tmp_path, SCENARIO, ("name: right", "name: east"))
    out = tmp_path / "run"
    result = invoke("run", other, "--plan", plan, "--out", out, code=2)
    assert "robot 'right' of the plan is not in the cell" in result.stderr
    assert not out.exists()


def test_violations_end_with_code_1_and_are_listed(
    plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from twin.audits import audit, run_auditor
    from twin.audits.case import Violation

    found = Violation(1.0, 2.0, "left/arm", "right/arm", 0.004, "link_3 - link_4")
    report = audit.AuditReport(100, -0.004, -0.004, (found,), "coal")
    monkeypatch.setattr(run_auditor, "audit_run", lambda *_, **__: report)
    result = invoke(*running(plan, tmp_path / "run", "--no-recording"), code=1)
    assert "1 violations (1 contact)" in " ".join(result.stdout.split())
    assert "contact: left/arm - right/arm: 4.00 mm deep" in result.stdout


def test_the_audit_holds_a_run_to_its_scenario_not_to_its_plan(
    plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same plan under a scenario whose part belongs 8 mm further on."""
    from dataclasses import replace

    from planning.transforms import translation
    from twin.audits.expectations import Expectations
    from twin.kinds.parts import expected
    from twin.kinds.parts.kind import PartKind
    from twin.scenario.sections.cell import CellSection

    told = expected.expectations_of

    def further(kind: PartKind, cell: CellSection) -> Expectations:
        wanted = told(kind, cell)
        places = wanted.places
        aside = translation(0.008, 0.0, 0.0)
        return replace(
            wanted,
            places=tuple(replace(place, pose=aside @ place.pose) for place in places),
        )

    monkeypatch.setattr(expected, "expectations_of", further)
    out = tmp_path / "run"
    result = invoke(*running(plan, out, "--no-recording"), code=1)
    audit = json.loads((out / "summary.json").read_text())["audit"]
    assert {v["kind"] for v in audit["violations"]} == {"place"}
    assert "up to 8.00 mm off" in result.stdout


def test_an_interrupt_in_the_twin_leaves_a_readable_log_and_code_130(
    plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from twin.recorders import observers

    def interrupt(self: object, event: object) -> None:
        counter.append(event)
        if len(counter) == 5:
            raise KeyboardInterrupt

    counter: list[object] = []
    monkeypatch.setattr(observers.MemoryRecorder, "record", interrupt)
    out = tmp_path / "run"
    result = invoke(*running(plan, out), code=130)
    assert "interrupted" in result.stderr
    rows = [json.loads(s) for s in (out / "events.jsonl").read_text().splitlines()]
    assert len(rows) >= 5
    assert json.loads((out / "summary.json").read_text())["outcome"] == "aborted"


def test_verify_proves_a_saved_plan(plan: Path) -> None:
    result = invoke("verify", plan, code=0)
    assert "safe for any delays" in result.stdout
    report = json.loads(invoke("verify", plan, "--json").stdout)
    assert report["ok"]
    assert report["min_distance_robots_m"] is None or (
        report["min_distance_robots_m"] > 0.001
    )


@pytest.mark.nightly
def test_verify_tells_what_is_survived_of_base_errors(plan: Path) -> None:
    large = invoke(
        "verify", plan, "--no-adversary", "--base-error", "40cm,1deg", code=1
    )
    assert "between robots: base errors up to" in large.stdout
    assert "safe for any delays, but not for these errors of bases" in large.stdout
    told = invoke("verify", plan, "--no-adversary", "--base-error", "40cm", "--json")
    survived = json.loads(told.stdout)["base_error"]
    assert not survived["ok"]
    assert (survived["m"], survived["rad"]) == (0.4, 0.0)
    for side in ("robots", "rest"):
        assert survived[side]["largest"]["m"] == pytest.approx(
            0.4 * survived[side]["share"]
        )
    least = min(survived[side]["share"] for side in ("robots", "rest"))
    part = f"{380 * least}mm"
    invoke("verify", plan, "--no-adversary", "--base-error", part, code=0)


@pytest.mark.parametrize(
    "text", ["1", "1mm,2mm", "0mm", "-1mm", "1inch", "1mm,,1deg", "1.2.3mm"]
)
def test_an_error_of_bases_that_is_none_is_refused(plan: Path, text: str) -> None:
    result = invoke("verify", plan, f"--base-error={text}", code=2)
    assert "--base-error" in result.stderr
    assert "1mm,0.1deg" in result.stderr


def test_verify_of_no_plan_says_so(tmp_path: Path) -> None:
    result = invoke("verify", tmp_path, code=2)
    assert "cannot read the plan" in result.stderr


def test_the_table_can_show_a_run_without_time() -> None:
    summary = {
        "outcome": "completed",
        "seed": 0,
        "policy": "asynchronous",
        "makespan_s": 0.0,
        "makespan_sequential_s": 0.0,
        "lower_bound_s": 0.0,
        "wait_s": {"left": 0.0},
        "nodes": 0,
        "type2_edges": 0,
        "planning_s": {"motion": 1.0},
        "audit": {"configurations": 1, "min_distance_m": None, "violations": []},
    }
    rows = {row[0]: row[1:] for row in summary_rows(summary)}
    assert rows["makespan, asynchronous"] == ("0.00 s", "0.0 % below sequential")
    assert rows["audit"] == ("clean", "1 configurations")
