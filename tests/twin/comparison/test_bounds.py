"""Bounds of a makespan, against ones added up task by task."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.motion.speed import JointSpeed, L1Speed, SpeedModel
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.simulated import simulate
from tests.twin.twin_toys import random_tpg, two_robot_tpg
from twin.comparison.comparison import straight_line_ratio, straight_line_s
from twin.durations.model import NANOSECONDS
from twin.run.events import ExecutionRecord
from twin.run.summary import lower_bound_s
from twin.uncertainty.skill_durations import SkillDurations


def slow_straight_line_s(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    speeds: dict[str, SpeedModel],
    past_home: bool,
) -> float:
    """Walk each chain node by node, and close a stretch where one has to end."""
    best = 0.0
    for k, chain in enumerate(tpg.chains):
        total, at, begin = 0.0, chain.start, chain.start
        for node in range(len(chain)):
            end = chain.waypoints[chain.first[node + 1] - 1]
            if chain.skill[node]:
                total += speeds[chain.robot].duration(begin, at)
                total += run.duration_ns[k][node] / NANOSECONDS
                begin = end
            at = end
            last = node + 1 == len(chain)
            task = next(t for t in tpg.tasks if t.index == chain.task[node])
            if last or (
                chain.task[node + 1] != chain.task[node]
                and (not past_home or task.goal)
            ):
                total += speeds[chain.robot].duration(begin, at)
                begin = at
        best = max(best, total)
    return best


def sequential(tpg: TemporalPlanGraph, seed: int = 0) -> ExecutionRecord:
    return simulate(tpg, SkillDurations({}), seed=seed, policy="sequential")


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.booleans(), st.integers(0, 3))
def test_straight_lines_are_those_added_up_one_by_one(
    seed: int, past_home: bool, kind: int
) -> None:
    tpg = random_tpg(seed, dofs=(2, 3, 2), tasks=9)
    rng = np.random.default_rng(seed)
    # Goals anywhere, and skills made transits so that several of these follow each other.
    tasks = [replace(task, goal=bool(rng.random() < 0.3)) for task in tpg.tasks]
    chains = [
        replace(chain, skill=chain.skill & (rng.random(len(chain)) < 0.5))
        for chain in tpg.chains
    ]
    tpg = replace(tpg, tasks=tuple(tasks), chains=tuple(chains), handlings=())
    run = sequential(tpg)
    speeds: dict[str, SpeedModel] = {
        chain.robot: JointSpeed(np.full(chain.waypoints.shape[1], 0.7))
        if kind == 0
        else L1Speed(kind)
        for chain in tpg.chains
    }
    expected = slow_straight_line_s(tpg, run, speeds, past_home)
    found = straight_line_s(tpg, run, speeds, past_home=past_home)
    assert found == pytest.approx(expected, abs=1e-9)
    assert straight_line_s(tpg, run, speeds, past_home=True) <= found + 1e-9


def test_no_policy_beats_the_bounds_of_straight_motions() -> None:
    # Three straight pose nodes of 0.1 rad each at 0.1 rad/s, twice.
    tpg = two_robot_tpg([(0, 1, 1, 0)])
    speeds = {f"robot_{k}": L1Speed(0.1) for k in range(2)}
    run = simulate(tpg, SkillDurations({}), seed=0)
    assert straight_line_s(tpg, run, speeds) == pytest.approx(3.0)
    assert lower_bound_s(tpg, run) == pytest.approx(3.0)
    assert run.makespan_s == pytest.approx(5.0)


def test_a_detour_shows_in_the_ratio_of_a_baseline() -> None:
    tpg = two_robot_tpg([])
    speeds = {f"robot_{k}": L1Speed(0.1) for k in range(2)}
    assert straight_line_ratio(tpg, sequential(tpg), speeds) == pytest.approx(1.0)
    # The first robot swings out to 0.4 rad on its way to 0.3: 0.5 rad at 0.1 rad/s.
    first = tpg.chains[0]
    detour = replace(
        first,
        waypoints=np.array([[0.1], [0.4], [0.3]]),
        duration=np.array([1.0, 3.0, 1.0]),
    )
    tpg = replace(tpg, chains=(detour, tpg.chains[1]))
    assert straight_line_ratio(tpg, sequential(tpg), speeds) == pytest.approx(8 / 6)
    # In one slot the longer of the two counts, straight or not.
    slotted = replace(tpg, slots=np.array([0, 0]))
    run = simulate(slotted, SkillDurations({}), seed=0, policy="synchronous")
    assert straight_line_ratio(slotted, run, speeds) == pytest.approx(5 / 3)
    slotted = replace(tpg, slots=np.array([0, 1]))
    run = simulate(slotted, SkillDurations({}), seed=0, policy="synchronous")
    assert straight_line_ratio(slotted, run, speeds) == pytest.approx(8 / 6)
