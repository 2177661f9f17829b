"""How long skills take: drawn from what was measured, or as long as their reference paths."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.packaged_timings import PACKAGED, SPREAD_S, SPREAD_SHARE, write_timings
from planning.errors import ScenarioError
from planning.tasks.task import TaskKind
from scheduling.build_nodes import build_nodes
from tests.twin.drawn_runs import sample
from tests.twin.program import invoke
from tests.twin.twin_toys import random_tpg, with_cut_skill
from tests.twin.written import loaded, written
from twin.durations.composed import Retries
from twin.durations.lognormal import Lognormal
from twin.durations.measured import Empirical, MeasuredTimes, Packaged, packaged_timings
from twin.durations.nanoseconds import to_nanoseconds
from twin.host.progress import StageWatch
from twin.planning.pipeline import plan_motions
from twin.reading.scenario_file import load_scenario
from twin.studies.compare import follow_references
from twin.trial.simulation import skill_durations
from twin.uncertainty.skill_durations import SkillDurations, nominal_ns


def test_models_of_one_file_are_equal_after_draws_too(tmp_path: Path) -> None:
    (tmp_path / "times.csv").write_text("duration_s\n3\n1\n2\n")
    times = Empirical(csv="times.csv")
    for section in (times, Retries(attempt=times, probability=0.5)):
        one, two = (section.located(tmp_path) for _ in range(2))
        assert one.mean == two.mean
        assert one == two
        assert {one: "known"}[two] == "known"
        assert one != two.scaled(2.0)


@given(
    st.lists(st.floats(0, 100), min_size=1, max_size=30),
    st.floats(1e-9, 1 - 1e-9),
)
def test_empirical_quantiles_invert_the_distribution(
    values: list[float], u: float
) -> None:
    quantile = float(MeasuredTimes(values=tuple(values)).ppf(np.array([u]))[0])
    below = np.mean(np.array(values) < quantile)
    assert below <= u <= np.mean(np.array(values) <= quantile) + 1e-12


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("duration_s\n1.0\nsoon\n", ":3: duration_s is 'soon'"),
        ("duration_s\n1.0\n-2\n", ":3: duration_s is '-2'"),
        ("duration_s\n1.0\nnan\n", ":3: duration_s is 'nan'"),
        ("trial,duration_s\n1,2.0\n2,\n", ":3: duration_s is ''"),
        ("duration_s\n", "has no rows"),
        ("", "no column 'duration_s'"),
        ("time,robot\n1.0,left\n", "no column 'duration_s' (valid: time, robot)"),
        (None, "no such file"),
    ],
)
def test_errors_in_timing_files_name_file_and_line(
    tmp_path: Path, text: str | None, says: str
) -> None:
    path = tmp_path / "pick.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ScenarioError) as caught:
        Empirical(csv="pick.csv").located(tmp_path)
    assert f"{path}" in str(caught.value)
    assert says in str(caught.value)


def test_timings_are_read_from_the_column_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "pick.csv"
    path.write_text("trial,seconds\n1,2.5\n2,1.5\n")
    model = Empirical(csv="pick.csv", column="seconds")
    assert model.located(tmp_path).values_s.tolist() == [1.5, 2.5]


def test_packaged_timings_keep_the_two_facts_of_the_paper() -> None:
    timings = packaged_timings()
    assert set(timings) == set(TaskKind.SKILLS)
    seconds, shares = [], []
    for model in timings.values():
        assert isinstance(model, Packaged)
        median = float(np.median(model.values_s))
        deviation = float(np.max(np.abs(model.values_s - median)))
        seconds.append(deviation)
        shares.append(deviation / median)
    assert max(seconds) == pytest.approx(SPREAD_S, abs=1e-3)
    assert max(shares) == pytest.approx(SPREAD_SHARE, abs=2e-3)
    handover = timings["handover"]
    assert isinstance(handover, Packaged)
    assert np.median(handover.values_s) == pytest.approx(8.7, abs=0.01)


def test_packaged_timings_come_out_of_their_script(tmp_path: Path) -> None:
    write_timings(tmp_path)
    for skill in TaskKind.SKILLS:
        name = f"{skill}.csv"
        assert (tmp_path / name).read_text() == (PACKAGED / name).read_text()


def test_motions_keep_their_nominal_time_and_skills_vary() -> None:
    tpg = random_tpg(5, tasks=12)
    durations = sample(SkillDurations(packaged_timings()), tpg, seed=1)
    for chain, drawn, nominal in zip(
        tpg.chains, durations, nominal_ns(tpg), strict=True
    ):
        assert np.array_equal(drawn[~chain.skill], nominal[~chain.skill])
        for node in np.flatnonzero(chain.skill):
            model = packaged_timings()[tpg.tasks[chain.task[node]].kind]
            assert isinstance(model, Packaged)
            assert drawn[node] in to_nanoseconds(model.values_s)


def test_seed_and_replication_change_the_draws() -> None:
    tpg = random_tpg(5, tasks=12)
    durations = SkillDurations(packaged_timings())
    draws = [
        np.concatenate(sample(durations, tpg, seed=seed, replication=replication))
        for seed, replication in ((1, 0), (1, 0), (2, 0), (1, 1))
    ]
    assert np.array_equal(draws[0], draws[1])
    assert not np.array_equal(draws[0], draws[2])
    assert not np.array_equal(draws[0], draws[3])


def test_a_task_cut_into_more_nodes_takes_as_long_in_all() -> None:
    tpg = random_tpg(5, tasks=12)
    durations = SkillDurations(
        {skill: Lognormal(median_s=7.0, p95_s=9.0) for skill in TaskKind.SKILLS}
    )
    whole = sample(durations, tpg, seed=3)
    node = int(np.flatnonzero(tpg.chains[0].skill)[0])
    parts = sample(durations, with_cut_skill(tpg), seed=3)
    assert parts[0][node] + parts[0][node + 1] == whole[0][node]
    assert parts[0].sum() == whole[0].sum()
    assert np.array_equal(parts[1], whole[1])


ROOT = Path(__file__).parents[3]
CLIFF = ROOT / "scenarios" / "lego" / "cliff.yaml"
TOWER = ROOT / "scenarios" / "construction" / "tower.yaml"


def test_they_move_at_the_speed_of_transits_and_never_vary() -> None:
    scenario = follow_references(load_scenario(CLIFF))
    assert scenario.execution.skill_models() == {}
    turns = plan_motions(scenario, CLIFF.parent, StageWatch())
    speed = scenario.planning.l1_rad_s
    seen = set()
    for task, motion in zip(
        turns.motion_plan.tasks, turns.motion_plan.motions, strict=True
    ):
        if task.kind == TaskKind.TRANSIT:
            continue
        seen.add(task.kind)
        travel = np.abs(np.diff(motion.path, axis=0)).sum(axis=1)
        np.testing.assert_allclose(np.diff(motion.time), travel / speed, atol=1e-9)
    assert {"pick", "place-down", "place-up", "handover"} <= seen
    tpg = build_nodes(turns.motion_plan)
    durations = skill_durations(scenario)
    first, other = (sample(durations, tpg, seed=seed) for seed in (1, 2))
    for a, b, planned in zip(
        first, other, sample(SkillDurations({}), tpg, seed=0), strict=True
    ):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, planned)


def test_exceptions_go_with_the_durations(tmp_path: Path) -> None:
    text = CLIFF.read_text() + (
        "\nexecution:\n  skill_overrides:\n"
        "    - {skill: pick, robot: left, duration: {kind: fixed, value_s: 90}}\n"
    )
    scenario = loaded(tmp_path, text)
    assert skill_durations(scenario).model_of("pick", "left", None) is not None
    assert skill_durations(follow_references(scenario)).overrides == ()


def test_the_planner_takes_the_means_of_exceptions(tmp_path: Path) -> None:
    text = CLIFF.read_text() + (
        "\nexecution:\n  skills:\n    place-down: {kind: reference}\n  skill_overrides:\n"
        "    - {skill: pick, robot: left, duration: {kind: uniform, low_s: 80, high_s: 100}}\n"
        "    - {skill: pick, object: 2x4, duration: {kind: fixed, value_s: 50}}\n"
    )
    scenario = loaded(tmp_path, text)
    plan = plan_motions(scenario, tmp_path, StageWatch()).motion_plan
    kinds = {item.name: item.kind for item in plan.cell.objects}
    packaged = packaged_timings()["pick"].mean
    seen = set()
    for task, motion in zip(plan.tasks, plan.motions, strict=True):
        if task.kind != "pick":
            continue
        assert task.object is not None
        case = (task.robot, kinds[task.object] == "2x4")
        expected = 90 if case[0] == "left" else 50 if case[1] else packaged
        assert motion.time[-1] - motion.time[0] == pytest.approx(expected)
        seen.add(case)
    assert {robot for robot, _ in seen} == {"left", "right"}
    assert ("right", True) in seen or ("right", False) in seen


@pytest.mark.parametrize(
    ("model", "says"),
    [
        ("{kind: referense}", "did you mean 'reference'?"),
        ("{kind: reference, scale: 2}", "scale"),
        ("{kind: shifted, offset_s: 1, model: {kind: reference}}", "'reference'"),
    ],
)
def test_what_a_reference_cannot_be(tmp_path: Path, model: str, says: str) -> None:
    text = f"\nexecution:\n  skills:\n    pick: {model}\n"
    file = written(tmp_path, CLIFF.read_text() + text)
    result = invoke("validate", file, code=2)
    assert says in result.output


def test_a_construction_needs_durations_to_plan_with() -> None:
    scenario = follow_references(load_scenario(TOWER))
    with pytest.raises(ScenarioError, match="pick: a construction"):
        plan_motions(scenario, TOWER.parent, StageWatch())


def test_the_comparison_takes_them_in_place_of_the_durations(tmp_path: Path) -> None:
    text = "\nexecution:\n  skills:\n    pick: {kind: fixed, value_s: 1000}\n"
    file = written(tmp_path, CLIFF.read_text() + text)
    out = tmp_path / "out"
    arguments = ["compare", str(file), "--reference-skills", "--json"]
    arguments += ["--seeds", "1", "--shortcuts", "0", "--out", str(out)]
    result = invoke(*arguments, code=0)
    assert json.loads(result.stdout)["sequential"]["makespan_s"]["mean"] < 400
    about = json.loads((out / "manifest.json").read_text())
    assert about["scenario"]["execution"]["skills"]["pick"] == {"kind": "reference"}
