"""Figures of runs, and of lines, against what is reckoned by hand."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.drawn_runs import TPGS, VARIED
from tests.twin.simulated import simulate
from tests.twin.twin_toys import two_robot_tpg
from twin.durations.nanoseconds import Nanoseconds
from twin.planning.assignment_gain import AssignmentGain
from twin.runs.header import RunHeader
from twin.runs.summary import summarize_run, summary_rows
from twin.throughput.throughput import (
    ProductTimes,
    line_figures,
    start_up_of,
    takts_s,
)


def test_figures_of_a_small_run() -> None:
    tpg = two_robot_tpg([(0, 1, 1, 0)])
    run = simulate(tpg, seed=4)
    about = RunHeader(planning_s={"motion": 0.5})
    summary = summarize_run(tpg, run, "toy", about)
    assert summary == {
        "scenario": "toy",
        "seed": 4,
        "policy": "asynchronous",
        "plan": "in turns",
        "outcome": "completed",
        "makespan_s": 5.0,
        "makespan_sequential_s": 6.0,
        "lower_bound_s": 3.0,
        "wait_s": {"robot_0": 0.0, "robot_1": 2.0},
        "stall_s": {"robot_0": 0.0, "robot_1": 0.0},
        "stopped_s": {"robot_0": 0.0, "robot_1": 0.0},
        "failure": None,
        "raised_skills": 0,
        "nodes": 6,
        "type2_edges": 1,
        "planning_s": {"motion": 0.5},
        "audit": None,
        "warnings": [],
        "checks_off": [
            {"key": "--no-audit", "check": "Whether what was executed is audited."}
        ],
        "makespan_asynchronous_s": None,
        "makespan_bound_s": None,
    }
    assert json.loads(json.dumps(summary)) == summary


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        ((100.0, 90.0, 110.0, 104.5, True), "10.0 % below integer program; with motions 5.0 % below it: taken"),
        ((100.0, 100.0, None, None, False), "0.0 % below integer program; not taken"),
    ],
)  # fmt: skip
def test_a_summary_says_what_a_searched_assignment_gains(
    gain: tuple[Any, ...], words: str
) -> None:
    tpg = two_robot_tpg([(0, 1, 1, 0)])
    found = AssignmentGain(700, *gain)
    header = RunHeader(assignment_search=found.content())
    summary = summarize_run(tpg, simulate(tpg), "toy", header)
    assert AssignmentGain(**summary["assignment_search"]) == found
    rows = {label: rest for label, *rest in summary_rows(summary)}
    assert rows["predicted, searched assignment"] == [f"{gain[1]:.2f} s", words]


def test_the_lower_bound_keeps_task_dependencies() -> None:
    tpg = two_robot_tpg([(0, 2, 1, 0)])
    needed = replace(tpg, dependencies=np.array([[0, 1]]))
    run = simulate(needed)
    assert summarize_run(needed, run, scenario="toy")["lower_bound_s"] == 6.0


@settings(max_examples=30, deadline=None)
@given(TPGS, st.integers(0, 100))
def test_the_makespan_lies_between_its_bounds(
    tpg: TemporalPlanGraph, seed: int
) -> None:
    summary = summarize_run(tpg, simulate(tpg, VARIED, seed=seed), scenario="toy")
    makespan = summary["makespan_s"]
    assert summary["lower_bound_s"] <= makespan + 1e-9
    assert makespan <= summary["makespan_sequential_s"] + 1e-9
    sequential = simulate(tpg, VARIED, seed=seed, policy="sequential")
    assert sequential.makespan_s == pytest.approx(summary["makespan_sequential_s"])


SECOND = 1_000_000_000


def made(begin: Nanoseconds, end: Nanoseconds) -> ProductTimes:
    """Return products that are all complete and had no failure."""
    return ProductTimes(begin, end, np.ones_like(end), np.ones_like(end))


def test_a_regular_line_is_known_by_hand() -> None:
    begin = np.arange(10)[:, None] * 5 * SECOND
    end = begin + 12 * SECOND
    found = line_figures(made(begin, end), [20.0 + 5 * k for k in range(10)], 2)
    assert found.takt_s == pytest.approx([5.0])
    assert found.cycle_time_s == pytest.approx([12.0])
    assert found.throughput_per_h == pytest.approx([720.0])
    assert found.late == pytest.approx([0.0])
    assert found.lateness_s == pytest.approx([-8.0])
    # From 22 s to 57 s; what would begin after the tenth product never does.
    steps = np.arange(22, 57)
    inside = [np.sum((begin <= t * SECOND) & (end > t * SECOND)) for t in steps]
    assert found.work_in_progress == pytest.approx([np.mean(inside)])


def test_products_overtake_and_are_late() -> None:
    begin = np.zeros((4, 2), dtype=np.int64)
    end = np.array([[4, 1], [2, 2], [6, 3], [8, 4]]) * SECOND
    assert takts_s(end, 0).T.tolist() == [[2.0, 2.0, 2.0], [1.0, 1.0, 1.0]]
    found = line_figures(made(begin, end), [3.0] * 4, 0)
    assert found.late.tolist() == [0.75, 0.25]
    assert found.lateness_s.tolist() == [2.0, -0.5]


@pytest.mark.parametrize(
    ("products", "asked", "skipped"),
    [(1, None, 0), (2, None, 0), (200, None, 20), (5, 9, 3)],
)
def test_two_products_are_left_after_the_start_up(
    products: int, asked: int | None, skipped: int
) -> None:
    assert start_up_of(products, asked) == skipped
