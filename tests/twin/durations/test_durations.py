from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.packaged_timings import (
    PACKAGED,
    SPREAD_S,
    SPREAD_SHARE,
    write_timings,
)
from planning.errors import ScenarioError
from planning.tasks.task import SKILLS
from tests.twin.drawn_runs import sample
from tests.twin.twin_toys import random_tpg, with_cut_skill
from twin.durations.lifetimes import Retries
from twin.durations.measured import Empirical, MeasuredTimes, Packaged, packaged_timings
from twin.durations.model import to_nanoseconds
from twin.durations.normal import Lognormal
from twin.uncertainty.skill_durations import SkillDurations, nominal_ns

PROBABILITIES = (np.arange(200_000) + 0.5) / 200_000
MEASURED = [3.0, 1.0, 2.0, 2.0, 8.0]


def test_lognormal_keeps_the_two_figures_it_is_given() -> None:
    model = Lognormal(median_s=8.7, p95_s=10.0)
    assert model.ppf(np.array([0.5, 0.95])) == pytest.approx([8.7, 10.0])


def test_empirical_gives_the_values_measured_each_as_often() -> None:
    model = MeasuredTimes(values=tuple(MEASURED))
    values, counts = np.unique(model.ppf(PROBABILITIES), return_counts=True)
    assert values.tolist() == [1.0, 2.0, 3.0, 8.0]
    assert (counts / len(PROBABILITIES)).tolist() == [0.2, 0.4, 0.2, 0.2]
    assert model.mean == pytest.approx(3.2)


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
    assert set(timings) == set(SKILLS)
    seconds, shares = [], []
    for model in timings.values():
        assert isinstance(model, Packaged)
        median = float(np.median(model.values_s))
        deviation = float(np.max(np.abs(model.values_s - median)))
        seconds.append(deviation)
        shares.append(deviation / median)
    assert max(seconds) == pytest.approx(SPREAD_S, abs=1e-3)
    assert max(shares) == pytest.approx(SPREAD_SHARE, abs=2e-3)
    assert np.median(timings["handover"].values_s) == pytest.approx(8.7, abs=0.01)


def test_packaged_timings_come_out_of_their_script(tmp_path: Path) -> None:
    write_timings(tmp_path)
    for skill in SKILLS:
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
        {skill: Lognormal(median_s=7.0, p95_s=9.0) for skill in SKILLS}
    )
    whole = sample(durations, tpg, seed=3)
    node = int(np.flatnonzero(tpg.chains[0].skill)[0])
    parts = sample(durations, with_cut_skill(tpg), seed=3)
    assert parts[0][node] + parts[0][node + 1] == whole[0][node]
    assert parts[0].sum() == whole[0].sum()
    assert np.array_equal(parts[1], whole[1])
