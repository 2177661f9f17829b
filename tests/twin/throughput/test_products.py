"""Products of an order: their places, variants, start-up, chart, and figures of a study."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.patches import Rectangle

import twin
from planning.tasks.task import TaskKind
from tests.twin.simulated import simulate
from tests.twin.studies.study_toys import toy_cell_summary, toy_summary
from tests.twin.throughput.queues import (
    Service,
    line_tpg,
    replicate,
    two_machines,
)
from tests.twin.written import refusal, written
from twin.durations.bounded import Uniform
from twin.engine.execution_model import ExecutionModel
from twin.studies.products import Orders, line_summary
from twin.studies.replications.block_results import read_block, write_block
from twin.studies.replications.experiment import Block
from twin.studies.replications.statistics import Interval
from twin.studies.replications.timing_graph import timing_graph
from twin.studies.replications.workload import Engines, Workload
from twin.studies.report.page_tables import variant_rows, worker_rows
from twin.throughput.product_gantt import products_figure, run_products_figure
from twin.throughput.states import STATES
from twin.throughput.throughput import (
    line_figures,
    mser,
    products_of_variants,
    run_product_times,
    settled_start_up,
)
from twin.throughput.throughput import (
    line_summary as run_line_summary,
)
from twin.uncertainty.skill_durations import SkillDurations

DURATIONS = {
    "drill": Uniform(low_s=1.0, high_s=2.0),
    "work": Uniform(low_s=0.5, high_s=3.0),
    "pick": Uniform(low_s=0.1, high_s=0.2),
}


def test_a_product_has_the_place_of_the_one_that_was_scrapped() -> None:
    """Three are ordered; the second one is scrapped, and so is the first one in its place; one more follows."""
    numbers = (1, 2, 3, 4, 5, 6)
    tpg = line_tpg({"arm": [Service("glue", k, (), None, 1.0) for k in numbers]})
    lost = np.isin(tpg.products, [2, 4])
    tasks = tuple(
        replace(t, kind=TaskKind.FAILED) if t.step == 3 else t for t in tpg.tasks
    )
    tpg = replace(tpg, products=np.where(lost, 0, tpg.products), tasks=tasks)
    run = simulate(tpg)
    times = run_product_times(tpg, run, ordered=3, scrapped=(2, 4))
    assert times is not None
    assert (times.product_end_ns[:, 0] / 1e9).tolist() == [1.0, 5.0, 3.0, 6.0]
    assert times.products_made[:, 0].tolist() == [1, 3, 1, 1]
    assert times.products_passed[:, 0].tolist() == [1, 1, 0, 1]
    due = [2.0, 2.0, 3.0]
    found = run_line_summary(tpg, run, due, 0, ("a", "b", "a"), (2, 4))
    assert found is not None
    assert found["due"]["late"] == 2
    assert found["first_pass_yield"] == pytest.approx(3 / 6)
    assert found["variants"]["b"] == found["variants"]["b"] | {
        "products": 1,
        "service_level": 0.0,
        "lateness_s": 3.0,
        "first_pass_yield": pytest.approx(1 / 3),
    }
    assert found["variants"]["a"]["service_level"] == pytest.approx(2 / 3)
    assert found["workers"]["arm"]["quality"] == pytest.approx(4 / 6)


def test_a_product_that_is_not_complete_is_not_in_time() -> None:
    tpg = line_tpg({"arm": [Service("glue", k, (), None, 1.0) for k in (1, 2, 3)]})
    tpg = replace(tpg, products=np.array([1, 0, 3]))
    times = run_product_times(tpg, simulate(tpg), 3, (2,))
    assert times is not None
    found = line_figures(times, [5.0] * 3)
    assert found.service_level.tolist() == [pytest.approx(2 / 3)]
    assert (found.late.tolist(), found.good.tolist()) == ([0.0], [pytest.approx(2 / 3)])
    assert found.takt_s.tolist() == [2.0]


@settings(max_examples=10, deadline=None)
@given(st.integers(2, 12), st.integers(0, 20), st.integers(0, 4))
def test_variants_add_up_to_the_line(count: int, seed: int, start_up: int) -> None:
    rng = np.random.default_rng(seed)
    found = replicate(line_tpg(two_machines(count, 1, gate=False)), DURATIONS, 2)
    variants = rng.choice(["a", "b", "c"], count).tolist()
    start_up = min(start_up, count - 2)
    due = rng.uniform(0, 3 * count, count).tolist()
    whole = line_figures(found.times, due, start_up)
    parts, weights = [], []
    for own in products_of_variants(variants, count).values():
        parts.append(line_figures(found.times, due, start_up, own))
        weights.append(own.mean())
    for name in ("throughput_per_h", "work_in_progress"):
        assert np.allclose(sum(getattr(p, name) for p in parts), getattr(whole, name))
    for name in ("service_level", "lateness_s", "late"):
        mean = sum(w * getattr(p, name) for w, p in zip(weights, parts, strict=True))
        assert np.allclose(mean, getattr(whole, name))


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, 9), max_size=60))
def test_the_start_up_has_the_least_standard_error(values: list[int]) -> None:
    """Oracle: the definition, with sums (exact for whole numbers)."""
    found = mser(np.array(values, dtype=float))
    batches = [sum(values[5 * k : 5 * k + 5]) for k in range(len(values) // 5)]

    def error(cut: int) -> float:
        rest = batches[cut:]
        mean = sum(rest) / len(rest)
        return sum((z - mean) ** 2 for z in rest) / len(rest) ** 2

    errors = [error(cut) for cut in range(len(batches) // 2 + 1)] if batches else [0.0]
    assert found % 5 == 0
    assert errors[found // 5] == pytest.approx(min(errors), abs=1e-9)


def test_a_line_that_fills_up_is_cut_where_it_is_full() -> None:
    """Twenty products take longer and longer; with the default of a tenth, some of them count."""
    found = replicate(line_tpg(two_machines(120, 20, gate=False)), DURATIONS, 20)
    assert settled_start_up(found.times) == 12
    assert settled_start_up(found.times, 7) == 7
    automatic = settled_start_up(found.times, "auto")
    assert 20 <= automatic <= 60
    cycle = line_figures(found.times, (), automatic).cycle_time_s.mean()
    assert cycle > line_figures(found.times, (), 12).cycle_time_s.mean()


@pytest.mark.parametrize(
    ("value", "words"), [("some", "auto"), ("-1", "0"), ("9", "two must be left")]
)
def test_what_no_start_up_is_names_place_and_choices(
    tmp_path: Path, value: str, words: str
) -> None:
    text = Path("scenarios/assembly/kitting.yaml").read_text()
    text = text.replace("count: 200,", f"count: 10, start_up: {value},")
    said = str(refusal(tmp_path, text))
    assert "products" in said
    assert words in said


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 50))
def test_bars_of_a_lane_do_not_overlap_and_all_products_are_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 60))
    begin = rng.uniform(0, 100, count)
    end = begin + rng.uniform(1, 30, count)
    due, variants = rng.uniform(0, 130, count), rng.choice(["a", "b"], count).tolist()
    figure = products_figure(begin, end, due.tolist(), variants)
    bars: dict[int, set[tuple[float, float]]] = {}
    for axes in figure.axes:
        for patch in axes.patches:
            assert isinstance(patch, Rectangle)
            low, width = patch.get_x(), patch.get_width()
            lane = round(patch.get_y() + 0.5 * patch.get_height())
            bars.setdefault(lane, set()).add((low, low + width))
    assert len(set().union(*bars.values())) == count
    for own in bars.values():
        ordered = sorted(own)
        assert all(
            a[1] <= b[0] + 1e-9 for a, b in zip(ordered, ordered[1:], strict=False)
        )
    inside = [int(np.sum((begin <= t) & (end > t))) for t in begin]
    assert len(bars) == max(inside)
    assert len(figure.axes) == -(-count // 25)


def test_one_product_has_no_chart() -> None:
    tpg = line_tpg({"arm": [Service("glue", 0, (), None, 1.0)]})
    assert run_products_figure(tpg, simulate(tpg)) is None


def test_both_engines_give_a_study_the_same_times(tmp_path: Path) -> None:
    tpg = timing_graph(line_tpg(two_machines(8, 1, gate=False), machines=("first",)))
    load = Workload(tpg, ExecutionModel(SkillDurations(DURATIONS)), 5)
    block = Block(0, 0, 12)
    bulk = Engines(load).compute(block)
    events = Engines(replace(load, reasons=("asked",))).compute(block)
    for name in ("products", "workers"):
        one, other = vars(getattr(bulk, name)), vars(getattr(events, name))
        assert all(np.array_equal(one[key], other[key]) for key in one)
    write_block(tmp_path, bulk)
    assert read_block(tmp_path, block).workers is not None
    orders = Orders((9.0,) * 8, None, ("small", "large") * 4)
    found = line_summary(tmp_path, 0, load, orders, 0.9)
    assert found is not None
    assert found.workers.keys() == {"first", "second"}
    for own in found.workers.values():
        shares = [entry for state in STATES if (entry := own.get(state)) is not None]
        assert sum(entry.estimate for entry in shares) == pytest.approx(1.0)
        assert all(0.0 <= entry.low <= entry.high <= 1.0 for entry in shares)
    made = Interval(10.0, 9.0, 11.0, 12)
    summary = toy_summary([toy_cell_summary("asynchronous", {}, made, line=found)])
    head, rows = variant_rows(summary)
    assert [row[1] for row in rows] == ["small", "large"]
    assert all(len(row) == len(head) for row in rows)
    head, rows = worker_rows(summary)
    assert [row[1] for row in rows] == ["second", "first"]
    assert all(len(row) == len(head) for row in rows)


@pytest.mark.nightly
def test_rework_and_scrap_count_in_studies_with_replanning(tmp_path: Path) -> None:
    """Replications with and without new plans; milling scraps, washing is done again."""
    text = Path("scenarios/assembly/machine_tending.yaml").read_text()
    text = text.replace("{count: 24, ", "{count: 4, spare: 2, ").replace(
        "  machines:\n    mill: {break",
        "  failures:\n    milling: {probability: 0.3, retries: 0, then: scrap}\n"
        "    washing: {probability: 0.3, retries: 0}\n  machines:\n    mill: {break",
    )
    text = re.sub(r"places: {.*?}, ", "", text)
    shutil.copytree("scenarios/assembly/tools", tmp_path / "tools")
    file = written(tmp_path, text)
    how: dict[str, Any] = {"operate": True, "policies": ["asynchronous"]}
    own = twin.study(file, replications=3, out=tmp_path / "study", **how)
    rows = own.replications.to_pylist()
    assert {row["versions"] > 0 for row in rows} == {True, False}
    (cell,) = own.result.summary.cells
    assert cell.line is not None
    assert cell.line.throughput_per_h is not None
    assert cell.line.throughput_per_h.count == 3
    scrapped = sum(len(row["given_up"].split()) // 4 for row in rows)
    passed = cell.line.first_pass_yield
    assert passed is not None
    assert passed.count == 3 * 4 + scrapped
    assert 0 < passed.estimate < 4 / (4 + scrapped / 3)
    quality = cell.line.workers["mill"]["quality"]
    assert quality is not None
    assert quality.estimate < 1
