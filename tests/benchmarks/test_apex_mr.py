"""The report that stands beside the paper: its averages, its files, and what is kept of a run."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.apex_mr import main
from benchmarks.apex_mr_paper import (
    STRUCTURES,
    TABLE_I,
    TABLE_II,
    motions_below_synchronous,
)
from benchmarks.apex_mr_report import DRAWN, REFERENCE, write_report
from benchmarks.apex_mr_tables import JOINTLY, PUBLISHED, Measured
from twin.runs.policies import (
    ASYNCHRONOUS,
    ASYNCHRONOUS_SHORTCUTS,
    SEQUENTIAL,
    SYNCHRONOUS,
    SYNCHRONOUS_SHORTCUTS,
)
from twin.studies.comparison import (
    BASELINES,
    COMPARED,
    Measurement,
    Rows,
    comparison_figures,
)

TASKS = tuple(f"{PUBLISHED}{name}" for name in ("bridge", "cliff", "table"))
"""Published tasks; the paper knows nothing of the last one."""

POLICIES = (SEQUENTIAL, *JOINTLY.values(), *COMPARED[1:])
STAGES = ("assignment", "motion", "synchronous", "tpg", "shortcut")


def comparison(rng: np.random.Generator) -> Rows:
    """Random figures of two seeds."""

    def measurement(policy: str) -> Measurement:
        make, wait = rng.uniform(50, 900, 2)
        return Measurement(
            makespan_s=make,
            wait_s=wait,
            planning_s={stage: rng.uniform(0.1, 9) for stage in STAGES},
            straight_line_s=0.4 * make,
            critical_path_s=0.5 * make,
            straight_line_ratio=1.02
            if policy in (*BASELINES, JOINTLY[SYNCHRONOUS])
            else None,
            nodes=5,
            type2_edges=2,
        )

    return {seed: {p: measurement(p) for p in POLICIES} for seed in (0, 1)}


@pytest.fixture(scope="module")
def compared() -> dict[str, Rows]:
    rng = np.random.default_rng(4)
    return {name: comparison(rng) for name in (*TASKS, *STRUCTURES, *TABLE_I)}


@pytest.fixture(scope="module")
def report(compared: dict[str, Rows], tmp_path_factory: pytest.TempPathFactory) -> Path:
    measured = {
        name: Measured(
            comparison_figures(one),
            2,
            70,
            "2026-01-02",
            ("abc123",),
            ((1.25, 3.0),),
            (50, 36, 50, 5),
        )
        for name, one in compared.items()
    }
    folder = tmp_path_factory.mktemp("report")
    return write_report(folder, measured, {}, "a machine", REFERENCE)


def below(rows: Rows, key: str, policy: str, other: str) -> float:
    def total(name: str) -> float:
        return sum(float(getattr(row[name], key)) for row in rows.values())

    return 100 - 100 * total(policy) / total(other)


def shares(rows: Rows, key: str, policy: str, other: str) -> list[float]:
    """Return a row's figures with slots as in the paper, and with ours."""
    names: tuple[dict[str, str], ...] = (JOINTLY, {})
    return [below(rows, key, n.get(policy, policy), n.get(other, other)) for n in names]


@pytest.mark.parametrize("names", [TASKS, STRUCTURES])
def test_averages_are_over_the_structures_of_their_part_alone(
    compared: dict[str, Rows], report: Path, names: tuple[str, ...]
) -> None:
    first, second = report.read_text().split("# Structures of our own")
    text = first if names is TASKS else second
    for key, paper, policy, other in (
        ("makespan_s", 48, ASYNCHRONOUS_SHORTCUTS, SEQUENTIAL),
        ("wait_s", 85, ASYNCHRONOUS_SHORTCUTS, SEQUENTIAL),
        ("makespan_s", 36, ASYNCHRONOUS_SHORTCUTS, SYNCHRONOUS),
        ("makespan_s", 36, SYNCHRONOUS_SHORTCUTS, SYNCHRONOUS),
        ("wait_s", 77, SYNCHRONOUS_SHORTCUTS, SYNCHRONOUS),
        ("makespan_s", 3, ASYNCHRONOUS_SHORTCUTS, SYNCHRONOUS_SHORTCUTS),
    ):
        both = [shares(compared[name], key, policy, other) for name in names]
        columns = list(zip(*both, strict=True))
        if other == SEQUENTIAL:
            del columns[1:]
        what = f"{policy}: {key.split('_')[0]} below {other}"
        cells = [
            f"**{np.mean(ours):.1f}** | {min(ours):.1f} | {max(ours):.1f}"
            for ours in columns
        ]
        assert f"| {what} | {paper} | {' | '.join(cells)} |" in text


def seconds(rows: Rows, policy: str, *stages: str) -> float:
    return sum(float(r[policy].planning_s[s]) for r in rows.values() for s in stages)


def test_planning_of_the_papers_slots_is_counted_without_sequential_motions(
    compared: dict[str, Rows], report: Path
) -> None:
    text = report.read_text().split("# Structures of our own")[0]
    for stages, theirs, words in (
        (["assignment"], 26, f"planning below {SYNCHRONOUS} (without its TPG)"),
        ([], 25, f"motions and TPG below motions of {SYNCHRONOUS}"),
    ):
        saved = [
            100
            - 100
            * seconds(compared[name], ASYNCHRONOUS, *stages, "motion", "tpg")
            / seconds(compared[name], JOINTLY[SYNCHRONOUS], *stages, "synchronous")
            for name in TASKS
        ]
        row = f"| {ASYNCHRONOUS}: {words} | {theirs} | **{np.mean(saved):.1f}**"
        assert row in text
    assert motions_below_synchronous() == pytest.approx(
        np.mean(
            [
                100 - 100 * (t.motion + t.tpg) / t.synchronous_motion
                for t in TABLE_II.values()
            ]
        )
    )


def test_the_report_says_where_its_figures_are_from(report: Path) -> None:
    text = report.read_text()
    for words in ("2026-01-02", "a machine", "Seeds 0, 1", "70 shortcut candidates"):
        assert words in text
    for words in ("abc123", "load of the machine 1.2 to 3.0", "--published ROOT"):
        assert words in text
    assert text.index("# The published tasks") < text.index("# Structures of our own")
    assert "3 of 9 published tasks" in text
    assert "36 of 50 |" in text
    assert "39.2" in text
    assert report.with_name("apex-mr.png").exists()
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert all(len(re.findall(r"(?<!\\)\|", row)) >= 4 for row in rows)
    for name in (*STRUCTURES, *TABLE_I):
        assert any(row.startswith(f"| {name}") for row in rows)


def test_the_json_file_holds_tasks_structures_and_policies_and_nothing_else(
    compared: dict[str, Rows], report: Path
) -> None:
    content = json.loads(report.with_name("apex-mr.json").read_text())
    assert tuple(content) == (*TASKS, *STRUCTURES)
    for name, policies in content.items():
        assert tuple(policies) == POLICIES
        for policy, row in policies.items():
            seeds = [m[policy].makespan_s for m in compared[name].values()]
            assert row["makespan_s"]["per_seed"] == seeds
            assert {"wait_s", "planning_s", "seeds", "date", "machine"} <= set(row)


def test_columns_of_the_paper_add_up_to_its_totals() -> None:
    printed = (21.6, 25.3, 25.7, 98.2, 73.5, 575.2, 51.6, 39.2, 139.3)
    totals = [TABLE_II[name].total for name in STRUCTURES]
    assert totals == pytest.approx(printed, abs=0.15)
    saved = [
        1 - t.total / (t.synchronous_task + t.synchronous_motion)
        for t in TABLE_II.values()
    ]
    assert np.mean(saved) == pytest.approx(0.26, abs=0.005)


def test_what_cannot_be_planned_is_named_and_left_out(
    compared: dict[str, Rows], tmp_path: Path
) -> None:
    rest = {name: compared[name] for name in ("cliff", "fish")}
    measured = {
        name: Measured(comparison_figures(one), 2, 70, "2026-01-02")
        for name, one in rest.items()
    }
    failures = {"chair, seed 1": "no way"}
    text = write_report(tmp_path, measured, failures, "a machine", DRAWN).read_text()
    assert "- chair, seed 1: no way" in text
    assert "2 of 9 structures of our own" in text
    assert "published" not in text
    assert "random times" in text
    assert (tmp_path / "apex-mr-drawn.json").exists()
    assert not (tmp_path / "apex-mr.json").exists()


def test_an_unknown_structure_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--only", "sofa"])
    assert "chair" in capsys.readouterr().err


def test_a_folder_without_published_tasks_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["--published", str(tmp_path)])
    assert str(tmp_path) in capsys.readouterr().err


def test_what_was_never_measured_is_not_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.apex_mr.KEPT", tmp_path / "kept")
    options = ["--only", "cliff", "--stored", "--out", str(tmp_path), "--quiet"]
    assert main(options) == 0
    assert "cliff" not in (tmp_path / "apex-mr.md").read_text()
