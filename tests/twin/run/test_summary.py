from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.drawn_runs import TPGS, VARIED
from tests.twin.simulated import simulate
from tests.twin.twin_toys import two_robot_tpg
from twin.run.summary import summarise
from twin.uncertainty.skill_durations import SkillDurations

NOMINAL = SkillDurations({})


def test_figures_of_a_small_run() -> None:
    tpg = two_robot_tpg([(0, 1, 1, 0)])
    run = simulate(tpg, NOMINAL, seed=4)
    summary = summarise(tpg, run, scenario="toy", planning_s={"motion": 0.5})
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
    }
    assert json.loads(json.dumps(summary)) == summary


def test_the_lower_bound_keeps_task_dependencies() -> None:
    tpg = two_robot_tpg([(0, 2, 1, 0)])
    needed = replace(tpg, dependencies=np.array([[0, 1]]))
    run = simulate(needed, NOMINAL, seed=0)
    assert summarise(needed, run, scenario="toy")["lower_bound_s"] == 6.0


@settings(max_examples=30, deadline=None)
@given(TPGS, st.integers(0, 100))
def test_the_makespan_lies_between_its_bounds(
    tpg: TemporalPlanGraph, seed: int
) -> None:
    summary = summarise(tpg, simulate(tpg, VARIED, seed=seed), scenario="toy")
    makespan = summary["makespan_s"]
    assert summary["lower_bound_s"] <= makespan + 1e-9
    assert makespan <= summary["makespan_sequential_s"] + 1e-9
    sequential = simulate(tpg, VARIED, seed=seed, policy="sequential")
    assert sequential.makespan_s == pytest.approx(summary["makespan_sequential_s"])
