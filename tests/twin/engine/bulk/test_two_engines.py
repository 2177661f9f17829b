"""Both engines on the plans of all bundled scenarios: one truth, to the nanosecond."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.timing_graphs import (
    SCENARIOS,
    contracted_graph,
    load_timing_graph,
)
from scheduling.build_tpg import build_tpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.shipped_runs import ShippedRuns
from tests.twin.simulated import assert_same_ends
from twin.durations.measured import packaged_timings
from twin.engine.execution_model import ExecutionModel
from twin.run.events import Policy
from twin.study.replications.workload import timing_graph
from twin.uncertainty.contraction import contract
from twin.uncertainty.skill_durations import SkillDurations

FOLDER = Path(__file__).parents[2] / "timing_graphs"
GRAPHS = sorted(FOLDER.glob("*.npz"))


def test_every_bundled_scenario_has_its_graph() -> None:
    assert {path.stem for path in GRAPHS} == set(SCENARIOS)


@pytest.mark.parametrize("policy", ["asynchronous", "sequential"])
@pytest.mark.parametrize("path", GRAPHS, ids=lambda path: path.stem)
def test_engines_agree(path: Path, policy: Policy) -> None:
    model = ExecutionModel(SkillDurations(packaged_timings()), policy)
    assert_same_ends(load_timing_graph(path), model, 4, [0, 1, 77])


@pytest.mark.nightly
def test_the_graph_of_the_cliff_is_current(shipped: ShippedRuns) -> None:
    plan = shipped("lego/cliff").planned.motions.motion_plan
    assert_current("cliff", timing_graph(contract(build_tpg(plan)).tpg))


def test_a_graph_that_is_made_anew_is_the_one_that_is_kept() -> None:
    assert_current("rearrangement", contracted_graph(SCENARIOS["rearrangement"]))


def assert_current(name: str, now: TemporalPlanGraph) -> None:
    kept = load_timing_graph(FOLDER / f"{name}.npz")
    assert [task.label for task in kept.tasks] == [task.label for task in now.tasks]
    assert np.array_equal(kept.edges, now.edges)
    for ours, theirs in zip(kept.chains, now.chains, strict=True):
        assert np.array_equal(ours.task, theirs.task)
        assert np.allclose(ours.duration, theirs.duration, atol=1e-6)
