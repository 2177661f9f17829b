"""What is worth fixing: ranks, intervals and files."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.twin.studies.study_toys import toy_workload
from twin.studies.gains.files import write_gains
from twin.studies.gains.gains import cell_gains, gain_content, study_gains
from twin.studies.gains.paired_quantiles import PairedQuantiles
from twin.studies.gains.replays import Replay
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.statistics import mean_interval
from twin.uncertainty.disturbances import Disturbances, EmergencyStop, Stalls

ONE = Experiment(policies=("asynchronous",), replications=400)


def test_gains_are_differences_of_the_same_replications() -> None:
    load = toy_workload(2)
    cell = cell_gains(ONE, load, 400)
    assert cell.replications == 400
    replay = Replay(load, np.arange(400))
    base = replay.base().makespan_ns / 1e9
    gains = [gain.shorter.mean_s.estimate for gain in cell.gains]
    assert gains == sorted(gains, reverse=True)
    assert {gain.intervention.kind for gain in cell.gains} == {
        *("task", "skill", "robot", "wait")
    }
    for gain in cell.gains:
        for saving, share in ((gain.shorter, 0.2), (gain.gone, 1.0)):
            changed = replay.makespans_ns(gain.intervention, share) / 1e9
            assert saving.mean_s == mean_interval(base - changed)
            p90 = np.sort(base)[359] - np.sort(changed)[359]
            assert saving.p90_s.estimate == pytest.approx(p90, abs=1e-12)
            assert saving.p90_s.low <= saving.p90_s.high


def test_replications_that_are_tried_follow_from_sizes_alone() -> None:
    assert cell_gains(ONE, toy_workload(1), 30).replications == 30
    assert cell_gains(ONE, toy_workload(1), 10**6).replications == 2000
    assert cell_gains(ONE, toy_workload(1), 5000, share=0.0).replications == 100
    stop = EmergencyStop(at_s=5.0, duration_s=20.0)
    load = toy_workload(
        1,
        disturbances=Disturbances(emergency_stops=(stop,)),
        reasons=("emergency_stops",),
    )
    assert cell_gains(ONE, load, 500, share=0.0).replications == 0
    cell = cell_gains(ONE, load, 1000, share=0.0)
    assert (cell.replications, cell.engine) == (8, "events")
    assert "emergency stops" in [gain.intervention.name for gain in cell.gains]


def test_stops_that_no_run_comes_to_change_no_gains() -> None:
    load = toy_workload(2)
    plain = cell_gains(ONE, load, 24)
    last = int(Replay(load, np.arange(24)).base().makespan_ns.max())
    for at_ns, engine in ((last + 1, "paths"), (last, "events")):
        stop = EmergencyStop(at_s=at_ns / 1e9, duration_s=5.0)
        model = replace(
            load.execution, disturbances=Disturbances(emergency_stops=(stop,))
        )
        stopped = replace(load, execution=model, reasons=("stops",))
        found = cell_gains(ONE, replace(stopped, bulk_until_ns=at_ns), 24)
        assert found.engine == engine
        same = plain if engine == "paths" else cell_gains(ONE, stopped, 24)
        assert list(map(gain_content, found.gains)) == list(
            map(gain_content, same.gains)
        )


def test_a_plan_in_which_nothing_varies_has_exact_gains() -> None:
    cell = cell_gains(ONE, toy_workload(1), 1)
    assert cell.replications == 1
    assert cell.gains[0].shorter.mean_s.content()["low"] is None


@pytest.mark.parametrize("antithetic", [False, True])
def test_quantiles_are_resampled_in_pairs(antithetic: bool) -> None:
    """The quick way gives what sorting every resample gives."""
    rng = np.random.default_rng(3)
    base = np.round(rng.gamma(4.0, 2.0, 60), 1)  # with ties
    changed = base - np.round(rng.uniform(0.0, 1.0, 60), 1)
    paired = PairedQuantiles(base, 0.9, confidence=0.9, seed=8, antithetic=antithetic)
    weights = paired._weights.T.astype(int)
    assert np.all(weights.sum(axis=1) == 60)
    if antithetic:
        assert np.array_equal(weights[:, ::2], weights[:, 1::2])
    falls = [
        np.sort(np.repeat(base, own))[53] - np.sort(np.repeat(changed, own))[53]
        for own in weights
    ]
    interval = paired.reduction(changed)
    # Ranks of the 0.9 quantile of 60 values, at most 5 % beyond either.
    shifts = [np.sort(base)[k - 1] - np.sort(changed)[k - 1] for k in range(50, 60)]
    assert stats.binom.cdf(49, 60, 0.9) <= 0.05 < stats.binom.cdf(50, 60, 0.9)
    assert stats.binom.sf(58, 60, 0.9) <= 0.05 < stats.binom.sf(57, 60, 0.9)
    low, high = np.quantile(falls, (0.05, 0.95))
    low, high = min(low, *shifts), max(high, *shifts)
    assert interval.estimate == np.sort(base)[53] - np.sort(changed)[53]
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=1e-12)


def test_small_samples_leave_the_difference_of_quantiles_open() -> None:
    base = np.random.default_rng(4).gamma(4.0, 2.0, 36)
    for count, needed in ((35, 36), (36, None)):
        paired = PairedQuantiles(base[:count], 0.9, confidence=0.95, seed=0)
        found = paired.reduction(base[:count] - 1.0)
        assert found.replications_needed == needed
        assert np.isfinite(found.half_width) == (needed is None)
        assert found.estimate == pytest.approx(1.0)


def test_intervals_of_quantiles_cover() -> None:
    """X and X + Y, both normal: the difference of their P90s is known."""
    rng = np.random.default_rng(1)
    truth = 1.0 + 1.2815515655446004 * (np.sqrt(1.25) - 1.0)
    hits = 0
    for k in range(150):
        changed = rng.normal(size=300)
        base = changed + rng.normal(1.0, 0.5, size=300)
        interval = PairedQuantiles(base, 0.9, confidence=0.95, seed=k).reduction(
            changed
        )
        hits += interval.low <= truth <= interval.high
    assert hits >= 0.88 * 150


def test_files_say_the_same(tmp_path: Path) -> None:
    stalls = Disturbances(stalls=Stalls(rate_per_h=300.0))
    loads = [toy_workload(1), toy_workload(1, disturbances=stalls)]
    experiment = Experiment(
        policies=("asynchronous",),
        variants=({"stalls.rate_per_h": 0}, {"stalls.rate_per_h": 300}),
        replications=50,
    )
    cells = study_gains(experiment, loads, [50, 50])
    write_gains(tmp_path, experiment, cells)
    content = json.loads((tmp_path / "gains.json").read_text())
    with (tmp_path / "gains.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    entries = [
        (cell, rank, gain)
        for cell in content["cells"]
        for rank, gain in enumerate(cell["gains"], start=1)
    ]
    assert len(rows) == len(entries) > 10
    for row, (cell, rank, gain) in zip(rows, entries, strict=True):
        assert row["stalls.rate_per_h"] == str(cell["variant"]["stalls.rate_per_h"])
        assert (row["rank"], row["name"]) == (str(rank), gain["name"])
        low = gain["gone"]["p90_s"]["low"]
        assert float(row["gone_p90_s_low"]) == low
    names = [gain["name"] for gain in content["cells"][1]["gains"]]
    assert "stalls of all robots" in names
    before = (tmp_path / "gains.json").read_bytes()
    write_gains(tmp_path, experiment, study_gains(experiment, loads, [50, 50]))
    assert (tmp_path / "gains.json").read_bytes() == before
