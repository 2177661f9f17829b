"""Layouts: each planned on its own, ranked with the same draws, and told of where none is found."""

import json
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from planning.errors import RequestError, ScenarioError
from planning.transforms import Array
from scheduling.graph.plan_files import plan_sha256
from tests.planned_once import PlannedOnce
from tests.twin.program import invoke
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.statistics import Precision, mean_interval
from twin.studies.summary import rank_layouts, shown_cell

X = "cell.robots.right.base.xyz_m.0"
PICK = "skills.pick.scale"
COUNT = 60
HOW: dict[str, Any] = {
    "replications": COUNT,
    "policies": ["sequential", "asynchronous"],
    "workers": 0,
}


@pytest.fixture(autouse=True)
def _plans_once(planned_once: PlannedOnce, monkeypatch: pytest.MonkeyPatch) -> None:
    planned_once.take_over(monkeypatch)


@pytest.fixture(scope="module")
def study(
    planned_once: PlannedOnce, tmp_path_factory: pytest.TempPathFactory
) -> twin.Study:
    with pytest.MonkeyPatch.context() as patch:
        planned_once.take_over(patch)
        # What the report has of each cell is looked at elsewhere, and takes long to draw.
        report = import_module("twin.studies.report.report")
        patch.setattr(report, "_cell", lambda *_: iter(()))
        vary: dict[str, list[float]] = {X: [0.75, 1.4, 0.65], PICK: [1, 3]}
        out = tmp_path_factory.mktemp("layouts") / "study"
        return twin.study("tray", vary, out=out, **HOW)


def makespans(study: twin.Study, **wanted: object) -> Array:
    rows = study.replications.to_pylist()
    keys = {"policy": "policy", "x": X, "pick": PICK}
    return np.array(
        [
            row["makespan_s"]
            for row in rows
            if all(row[keys[name]] == value for name, value in wanted.items())
        ]
    )


@pytest.mark.nightly
@pytest.mark.usefixtures("no_report")
def test_each_layout_is_what_a_study_of_it_alone_finds(
    study: twin.Study, tmp_path: Path
) -> None:
    case = twin.load("tray").varied({X: 0.65, PICK: 3})
    alone = twin.study(case, out=tmp_path / "alone", **HOW)
    for policy in ("sequential", "asynchronous"):
        found = makespans(study, policy=policy, x=0.65, pick=3)
        assert len(found) == COUNT
        rows = alone.replications.to_pylist()
        expected = [row["makespan_s"] for row in rows if row["policy"] == policy]
        assert found.tolist() == expected


def test_layouts_are_ranked_by_paired_differences(study: twin.Study) -> None:
    rows = study.result.summary.ranking
    assert [(r.policy, r.variant[PICK], r.rank) for r in rows] == [
        (policy, pick, rank)
        for policy in ("sequential", "asynchronous")
        for pick in (1, 3)
        for rank in (1, 2)
    ]
    for first, second in zip(rows[::2], rows[1::2], strict=True):
        samples = [
            makespans(study, policy=r.policy, x=r.variant[X], pick=r.variant[PICK])
            for r in (first, second)
        ]
        assert first.mean_s == pytest.approx(samples[0].mean())
        assert first.mean_s <= second.mean_s
        assert first.behind_s is None
        expected = mean_interval(samples[1] - samples[0]).content()
        assert second.behind_s is not None
        assert second.behind_s.content() == pytest.approx(expected)
    table = study.ranking.to_pylist()
    assert [row["rank"] for row in table] == [row.rank for row in rows]


def test_a_layout_without_a_plan_is_a_row_with_its_reason(study: twin.Study) -> None:
    (row,) = study.refused.to_pylist()
    assert row[X] == 1.4
    assert "no robot reaches motor" in row["reason"]
    assert set(study.replications.column(X).to_pylist()) == {0.75, 0.65}
    page = study.report.read_text()
    assert "Layouts without a plan" in page
    assert "no robot reaches motor" in page
    assert "Which layout" in page
    assert (study.folder / "ranking.png").stat().st_size > 5_000


def test_the_cell_on_the_first_page_is_the_best_layout(study: twin.Study) -> None:
    summary = study.result.summary
    cell, best = (
        summary.cells[shown_cell(summary, study.result.request.experiment.policies)],
        summary.ranking[4],
    )
    assert best.policy == "asynchronous" == cell.policy
    assert best.variant == cell.variant


@pytest.mark.nightly
@pytest.mark.usefixtures("no_report")
def test_an_interrupted_study_of_layouts_goes_on_and_prints_the_ranking(
    study: twin.Study,
) -> None:
    before = (study.folder / "summary.json").read_bytes()
    (study.folder / "summary.json").unlink()
    next(study.folder.glob("blocks/*.npz")).unlink()
    done = invoke("study", "--resume", study.folder, code=0)
    assert (study.folder / "summary.json").read_bytes() == before
    assert json.loads(before)["refused"] == study.summary["refused"]
    text = " ".join(done.stdout.split())
    assert "quickest" in text
    assert f"no plan: {X} = 1.4: no robot reaches motor" in text


@pytest.mark.usefixtures("no_report")
def test_robots_and_seeds_are_varied_with_the_same_draws(tmp_path: Path) -> None:
    how = HOW | {"replications": 20, "policies": ["sequential"]}
    found = twin.study("tray", {"seed": [0, 1]}, out=tmp_path / "seeds", **how)
    first, second = (
        np.array(
            [r["makespan_s"] for r in found.replications.to_pylist() if r["seed"] == s]
        )
        for s in (0, 1)
    )
    # One task at a time: the draws of the skills are the same, only paths may differ.
    assert np.ptp(first - second) < 1e-6 < np.ptp(first)


LOST = [{"probability": 0.1, "wrong": share, "beside": 0.3} for share in (0.5, 1.0)]


@pytest.mark.parametrize(
    ("vary", "error", "words"),
    [
        ({X: [0.7, "far"]}, ScenarioError, r"robots\[1\].base.xyz_m\[0\]: a number"),
        ({"cell.robots.middle.tool": ["a"]}, ScenarioError, "no entry 'middle'"),
        ({"failures.pick": LOST, X: [0.6]}, ScenarioError, "more than all that are"),
        ({X: [1.4, 1.5]}, RequestError, r"1\.4.*no robot reaches.*1\.5"),
        ({"robots": [1], X: [0.6]}, RequestError, r"robots = 1, .*: no robot reaches"),
    ],
)
def test_values_that_do_not_fit_or_have_no_plan_are_refused(
    vary: dict[str, list[object]], error: type[Exception], words: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=words):
        twin.study("tray", vary, out=tmp_path / "no")
    assert not (tmp_path / "no").exists()


def test_a_plan_that_is_there_has_one_layout(tmp_path: Path) -> None:
    plan = twin.plan("tray")
    with pytest.raises(RequestError, match="a plan that is there cannot be varied"):
        twin.study(plan, {X: [0.6, 0.7]}, out=tmp_path / "no")


def test_ranks_of_samples() -> None:
    experiment = Experiment(
        ("sequential",),
        tuple({"planning.speed_rad_s": v} for v in (1, 2, 3, 4)),
        precision=Precision(confidence=0.9),
    )
    rng = np.random.default_rng(0)
    common = rng.normal(100, 10, 400)
    samples = [
        common + 1 + rng.normal(0, 0.1, 400),
        common,
        common + rng.normal(0.0, 5, 400) + 0.1,
        np.full(400, np.nan),
    ]
    samples[1][7] = np.nan
    rows = list(rank_layouts(experiment, samples))
    # What never completes has no rank; the common noise does not blur the differences.
    assert [row.cell for row in rows][-1] == 0
    assert len(rows) == 3
    behind = {row.cell: row.behind_s for row in rows}
    assert behind[0] is not None
    assert behind[0].low > 0.0
    assert behind[2] is None or behind[2].low < 0.0 < behind[2].high
    reference = rows[0].cell
    both = np.isfinite(samples[0]) & np.isfinite(samples[reference])
    wide = mean_interval((samples[0] - samples[reference])[both], confidence=0.95)
    assert behind[0].content() == pytest.approx(wide.content())
    assert behind[0].count == both.sum()
    content = [row.content() for row in rows]
    assert json.loads(json.dumps(content)) == content
    assert not list(rank_layouts(Experiment(("sequential",)), samples[:1]))


@pytest.mark.nightly
@pytest.mark.parametrize(
    "values",
    [
        {},
        {"planning.shortcut_candidates": 0},
        {"planning.coordination": "synchronous"},
        # Whom the clock stops in a skill brakes along its path.
        {
            "planning.speed_model": "limits",
            "emergency_stops": [{"at_s": 6.0, "duration_s": 4.0}],
        },
    ],
    ids=str,
)
@pytest.mark.usefixtures("no_report")
def test_a_study_is_of_the_plan_that_is_run(
    values: dict[str, object], tmp_path: Path
) -> None:
    scenario = twin.load("tray").varied(values)
    plan = twin.plan(scenario)
    found = twin.study(scenario, replications=3, out=tmp_path / "study")
    own = found.summary["cells"][-1]["policy"]
    assert own == twin.simulate(plan).policy
    study = json.loads((tmp_path / "study/manifest.json").read_text())["study"]
    assert study["plans_sha256"][plan.name] == plan_sha256(plan.tpg)
    rows = found.replications.to_pylist()
    (first,) = (r for r in rows if r["policy"] == own and r["replication"] == 0)
    assert first["makespan_s"] == twin.simulate(plan).makespan_s


@pytest.mark.nightly
def test_lists_words_and_nothing_are_values_too(tmp_path: Path) -> None:
    vary = {
        "cell.robots.right.base.xyz_m": [[0.6, 0, 0], [0.7, 0, 0]],
        "planning.speed_model": ["l1", "joint"],
        "cell.robots.left.home_deg": [None],
        "assembly.parts.cover.start.rpy_deg": [[0.0, 0.0, 0.0]],
    }
    arguments = [f"--vary={key}={json.dumps(v)[1:-1]}" for key, v in vary.items()]
    study = ("study", "tray", "-n", 5, "--policy", "asynchronous", "--workers", 0)
    done = invoke(*study, "--out", tmp_path / "study", *arguments, code=0)
    table = done.stdout.partition("worth fixing")[0]
    assert "home_deg" not in table  # one value is not worth a column
    summary = json.loads((tmp_path / "study/summary.json").read_text())
    rows = [row["variant"]["planning.speed_model"] for row in summary["ranking"]]
    assert rows == ["joint", "joint", "l1", "l1"]
    names = [path.name for path in (tmp_path / "study").iterdir()]
    assert max(map(len, names)) < 200
