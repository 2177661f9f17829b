"""One scenario under every policy, on the command line and against single runs; bounds of a makespan."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.motion.speed import JointSpeed, L1Speed, SpeedModel
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.shortcuts.shortcutting import shorten_tpg
from tests.twin.program import invoke
from tests.twin.simulated import simulate
from tests.twin.twin_toys import random_tpg, two_robot_tpg
from twin.durations.nanoseconds import NANOSECONDS
from twin.host.progress import StageWatch
from twin.planning.pipeline import motion_settings, plan_motions
from twin.reading.scenario_file import load_scenario
from twin.runs.execution_record import ExecutionRecord
from twin.runs.policies import (
    ASYNCHRONOUS,
    ASYNCHRONOUS_SHORTCUTS,
    SEQUENTIAL,
    SYNCHRONOUS,
    SYNCHRONOUS_SHORTCUTS,
    SYNCHRONOUS_TPG,
)
from twin.runs.summary import lower_bound_s
from twin.studies.comparison import (
    BASELINES,
    COMPARED,
    Measurement,
    measure_policies,
    straight_line_ratio,
    straight_line_s,
)
from twin.trial.planning import plan_scenario
from twin.trial.simulation import execute

CLIFF = Path(__file__).parents[3] / "scenarios" / "lego" / "cliff.yaml"

GOALS = """\
version: 1
name: rounds
seed: 5
cell:
  robots:
    - {name: near, model: gp4, base: {xyz_m: [0, 0, 0]}}
    - {name: far, model: gp4, base: {xyz_m: [3, 0, 0]}}
assembly:
  kind: goals
  moves:
    - {robot: near, to_deg: [40, 0, -40, 0, -60, 0]}
    - {robot: far, to_deg: [-40, 0, -40, 0, -60, 0]}
    - {robot: near, to_deg: [-40, 0, -40, 0, -60, 0]}
    - {robot: near, to_deg: [40, 10, -40, 0, -60, 0]}
    - {robot: far, to_deg: [-40, 20, -40, 0, -60, 0]}
"""


@pytest.fixture(scope="module")
def goals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("goals") / "goals.yaml"
    file.write_text(GOALS)
    return file


@pytest.fixture(scope="module")
def cliff() -> Mapping[str, Measurement]:
    scenario = load_scenario(CLIFF).model_copy(update={"seed": 3})
    turns = plan_motions(scenario, CLIFF.parent, watch := StageWatch())
    return measure_policies(turns, scenario, watch, candidates=400, base=CLIFF.parent)


def test_waiting_less_takes_less_time(cliff: Mapping[str, Measurement]) -> None:
    assert tuple(cliff) == COMPARED
    time = {name: cliff[name].makespan_s for name in COMPARED}
    assert time[SEQUENTIAL] > time[SYNCHRONOUS] > time[SYNCHRONOUS_TPG]
    assert time[SYNCHRONOUS_TPG] > time[SYNCHRONOUS_SHORTCUTS]
    assert time[SEQUENTIAL] > time[ASYNCHRONOUS] > time[ASYNCHRONOUS_SHORTCUTS]
    assert cliff[SEQUENTIAL].wait_s > cliff[SYNCHRONOUS].wait_s
    assert cliff[SYNCHRONOUS].wait_s > cliff[SYNCHRONOUS_TPG].wait_s


def test_nobody_beats_the_bounds(cliff: Mapping[str, Measurement]) -> None:
    for row in cliff.values():
        assert row.makespan_s >= row.critical_path_s - 1e-6
        assert row.critical_path_s >= row.straight_line_s - 1e-6
    for name in COMPARED:
        ratio = cliff[name].straight_line_ratio
        if name in BASELINES:
            assert ratio is not None
            assert 1 - 1e-9 <= ratio <= 1.1
        else:
            assert ratio is None


def test_every_policy_pays_for_the_stages_it_needs(
    cliff: Mapping[str, Measurement],
) -> None:
    turns, slots = {"assignment", "motion"}, {"assignment", "motion", "synchronous"}
    assert {name: set(cliff[name].planning_s) for name in COMPARED} == {
        SEQUENTIAL: turns,
        SYNCHRONOUS: slots,
        SYNCHRONOUS_TPG: slots | {"tpg"},
        SYNCHRONOUS_SHORTCUTS: slots | {"tpg", "shortcut"},
        ASYNCHRONOUS: turns | {"tpg"},
        ASYNCHRONOUS_SHORTCUTS: turns | {"tpg", "shortcut"},
    }
    shared = {row.planning_s["motion"] for row in cliff.values()}
    assert len(shared) == 1
    assert min(shared) > 0


@pytest.mark.parametrize("coordination", ["sequential", "synchronous"])
def test_figures_are_those_of_a_single_run(
    cliff: Mapping[str, Measurement], coordination: str
) -> None:
    scenario = load_scenario(CLIFF)
    planning = {"coordination": coordination, "shortcut_candidates": 0}
    scenario = scenario.model_copy(
        update={
            "seed": 3,
            "planning": scenario.planning.model_copy(update=planning),
        }
    )
    planned = plan_scenario(scenario, CLIFF.parent)
    alone = coordination == "sequential"
    run = execute(scenario, planned.tpg, CLIFF.parent, "asynchronous")
    row = cliff[ASYNCHRONOUS if alone else SYNCHRONOUS_TPG]
    assert run.makespan_s == row.makespan_s
    waits = sum(run.wait_ns(k) for k in range(2)) / 1e9
    assert waits == pytest.approx(row.wait_s)
    assert row.type2_edges == len(planned.tpg.edges)
    turns = planned.turns or planned.tpg
    run = execute(scenario, turns, CLIFF.parent, "sequential")
    # One task after another: everyone's work, and nobody's wait.
    busy = sum(int(d.sum()) for d in run.duration_ns) / 1e9
    assert cliff[SEQUENTIAL].makespan_s == run.makespan_s == pytest.approx(busy)


def test_the_command_writes_and_prints_what_it_found(
    goals: Path, tmp_path: Path
) -> None:
    arguments = ("compare", goals, "--seeds", 2, "--shortcuts", 40)
    result = invoke(*arguments, "--out", tmp_path / "a", code=0)
    names = {path.name for path in (tmp_path / "a").iterdir()}
    assert names == {"compare.json", "compare.png", "manifest.json"}
    picture = (tmp_path / "a" / "compare.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    figures = json.loads((tmp_path / "a" / "compare.json").read_text())
    assert tuple(figures) == COMPARED
    for name, row in figures.items():
        assert name in result.stdout
        assert f"{row['makespan_s']['mean']:.1f}" in result.stdout
        assert f"{row['critical_path_s']['mean']:.1f}" in result.stdout
    about = json.loads((tmp_path / "a" / "manifest.json").read_text())
    assert (about["seeds"], about["shortcut_candidates"]) == ([5, 6], 40)

    again = invoke(*arguments, "--out", tmp_path / "b", "--json", code=0)
    content = json.loads(again.stdout)
    for row in (*figures.values(), *content.values()):
        row.pop("planning_s")
    assert content == figures
    quiet = invoke("compare", goals, "--seeds", 1, "--out", tmp_path / "c", "--quiet")
    assert (quiet.exit_code, quiet.output) == (0, "")


def test_spread_and_shares_are_over_seeds(goals: Path, tmp_path: Path) -> None:
    result = invoke("compare", goals, "--seeds", 3, "--out", tmp_path / "run", "--json")
    figures: dict[str, Any] = json.loads(result.stdout)
    base = figures[SEQUENTIAL]
    for row in figures.values():
        assert row["seeds"] == [5, 6, 7]
        for key, share in (
            ("makespan_s", "relative_makespan"),
            ("wait_s", "relative_wait"),
        ):
            values = np.array(row[key]["per_seed"])
            assert row[key]["mean"] == pytest.approx(values.mean())
            assert row[key]["std"] == pytest.approx(values.std(ddof=1))
            assert row[share]["per_seed"] == pytest.approx(
                values / np.array(base[key]["per_seed"])
            )
        stages = {k: v for k, v in row["planning_s"].items() if k != "total"}
        assert row["planning_s"]["total"]["mean"] == pytest.approx(
            sum(stage["mean"] for stage in stages.values())
        )
    # Robots out of each other's reach: only their own work is left.
    assert figures[ASYNCHRONOUS]["wait_s"]["mean"] == 0.0


def test_a_scenario_that_cannot_be_planned_leaves_no_folder(tmp_path: Path) -> None:
    file = tmp_path / "high.yaml"
    file.write_text(
        GOALS.replace("to_deg: [40, 0, -40, 0, -60, 0]", "to: {xyz_m: [9, 0, 0]}")
    )
    result = invoke("compare", file, "--out", tmp_path / "run", code=2)
    assert "out of reach" in result.output
    assert not (tmp_path / "run").exists()


def test_every_key_is_documented(goals: Path, tmp_path: Path) -> None:
    result = invoke("compare", goals, "--seeds", 1, "--out", tmp_path / "run", "--json")
    page = Path(__file__).parents[3] / "docs" / "reference" / "formats.md"
    text = page.read_text()
    row = json.loads(result.stdout)[SYNCHRONOUS_SHORTCUTS]
    keys = {*row, *row["makespan_s"], *row["planning_s"]}
    missing = {key for key in keys if f"`{key}`" not in text}
    assert missing == set()
    assert all(f"`{name}`" in text for name in COMPARED)


def test_shortcuts_pass_by_no_goal(goals: Path) -> None:
    scenario = load_scenario(goals)
    planned = plan_scenario(scenario, goals.parent)
    settings = motion_settings(scenario, planned.motions.cell, goals.parent)
    tpg = shorten_tpg(
        planned.tpg, settings.speeds, step=settings.step, candidates=60, seed=1
    )
    for move in GOALS.split("to_deg: ")[1:]:
        goal = np.deg2rad(json.loads(move.split("}")[0]))
        rows = np.vstack([chain.waypoints for chain in tpg.chains])
        assert np.abs(rows - goal).sum(axis=1).min() < 1e-9


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
    return simulate(tpg, seed=seed, policy="sequential")


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
    run = simulate(tpg, seed=0)
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
    run = simulate(slotted, seed=0, policy="synchronous")
    assert straight_line_ratio(slotted, run, speeds) == pytest.approx(5 / 3)
    slotted = replace(tpg, slots=np.array([0, 1]))
    run = simulate(slotted, seed=0, policy="synchronous")
    assert straight_line_ratio(slotted, run, speeds) == pytest.approx(8 / 6)
