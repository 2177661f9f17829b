"""What inputs do to the makespan: bars of a tornado, and Sobol indices of a plan that adds up."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import stats

from planning.errors import RequestError
from tests.twin.driven_toys import driven_tpg
from tests.twin.studies.study_toys import toy_workload
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Fixed, Uniform
from twin.engine.execution_model import ExecutionModel
from twin.studies.folder import check_points
from twin.studies.gains.gains import cell_gains
from twin.studies.replications.experiment import Block, Experiment
from twin.studies.replications.timing_graph import timing_graph
from twin.studies.replications.workload import Workload
from twin.studies.sensitivity import (
    input_influences,
    makespans_s,
    sobol_indices,
    study_inputs,
)
from twin.uncertainty.disturbances import Disturbances, Stalls
from twin.uncertainty.skill_durations import SkillDurations


def _sum_of_two() -> Workload:
    """One robot: the makespan is the sum of its picks and its other motions."""
    tpg = timing_graph(random_tpg(3, dofs=(2,), tasks=8, edges=0))
    tasks = tuple(
        replace(task, kind="pick") if task.kind != "transit" else task
        for task in tpg.tasks
    )
    return Workload(
        replace(tpg, tasks=tasks),
        ExecutionModel(SkillDurations({"pick": Fixed(value_s=2.0)})),
        0,
    )


def test_a_sum_answers_as_a_sum_does() -> None:
    load = _sum_of_two()
    skills = 4 * 2.0
    moves = float(makespans_s(load, Block(0, 0, 1))[0]) - skills
    found = {one.name: one for one in input_influences(load)}
    assert set(found) == {"duration of pick", "motions of robot_0"}
    picks, motions = found["duration of pick"], found["motions of robot_0"]
    for one, whole in ((picks, skills), (motions, moves)):
        for change, sign in ((one.less_s, -0.2), (one.more_s, 0.2)):
            bounds = change.low, change.estimate, change.high
            assert bounds == pytest.approx((sign * whole,) * 3, abs=1e-6)


def test_motions_within_limits_count_as_they_do_in_what_is_worth_fixing() -> None:
    tpg = timing_graph(driven_tpg(3, dofs=(2,), tasks=8, edges=0))
    load = Workload(tpg, ExecutionModel(SkillDurations({})), 0)
    (motions,) = (
        one for one in input_influences(load) if one.name.startswith("motions")
    )
    gains = cell_gains(Experiment(("asynchronous",), replications=1), load, 1).gains
    (every,) = (one for one in gains if one.intervention.name == "every motion")
    assert motions.less_s.estimate < -0.1
    assert motions.less_s.estimate == pytest.approx(
        -every.shorter.mean_s.estimate, abs=1e-6
    )
    more = motions.more_s.estimate
    assert more == pytest.approx(-motions.less_s.estimate, rel=0.2)


def test_sobol_indices_of_a_sum_are_shares_of_variance() -> None:
    load = _sum_of_two()
    skills = 4 * 2.0
    moves = float(makespans_s(load, Block(0, 0, 1))[0]) - skills
    calls: list[float] = []
    found = sobol_indices(
        load, 64, progress=lambda stage, done, total: calls.append(done)
    )
    assert calls == list(range(1, 64 * 4 + 1))
    shares = {"duration of pick": skills**2, "motions of robot_0": moves**2}
    for one in found:
        expected = shares[one.name] / sum(shares.values())
        for index in (one.first, one.total):
            assert index.estimate == pytest.approx(expected, abs=0.1)
            assert index.low < expected < index.high
    few = sobol_indices(load, 4)
    assert few == sobol_indices(load, 4)
    assert few != sobol_indices(load, 4, seed=1)


def test_sobol_indices_are_those_of_scipy() -> None:
    load = toy_workload()
    names = list(study_inputs(load))

    def means(factors: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        found = []
        for point in factors.T.tolist():
            changed = load
            for scaled, factor in zip(study_inputs(load).values(), point, strict=True):
                changed = scaled(changed, factor)
            found.append(float(np.mean(makespans_s(changed, Block(0, 0, 50)))))
        return np.array(found)

    spread: Any = stats.uniform(loc=0.8, scale=0.4)
    oracle = stats.sobol_indices(func=means, n=8, dists=[spread] * len(names), rng=3)
    found = {one.name: one for one in sobol_indices(load, 8, seed=3)}
    for k, name in enumerate(names):
        own = found[name].first.estimate, found[name].total.estimate
        expected = oracle.first_order[k], oracle.total_order[k]
        assert own == pytest.approx(expected, abs=1e-6)


def test_what_varies_has_an_interval_that_more_replications_narrow() -> None:
    load = toy_workload()
    for one in input_influences(load):
        for change in (one.less_s, one.more_s):
            assert change.low <= change.estimate <= change.high
    widths = [
        sum(one.more_s.half_width for one in input_influences(load, confidence=level))
        for level in (0.5, 0.95)
    ]
    assert 0 < widths[0] < widths[1]


def test_points_are_a_power_of_two() -> None:
    with pytest.raises(RequestError, match="power of 2"):
        check_points(48)


def test_inputs_are_what_the_plan_has() -> None:
    stalls = Stalls(rate_per_h=30.0, duration=Uniform(low_s=1.0, high_s=2.0))
    load = toy_workload(disturbances=Disturbances(stalls=stalls))
    inputs = study_inputs(load)
    assert "rate of stalls" in inputs
    assert "duration of support-bottom" not in inputs
    block = Block(0, 0, 30)
    base = makespans_s(load, block)
    for scaled in inputs.values():
        same = makespans_s(scaled(load, 1.0), block)
        assert np.allclose(same, base, atol=1e-6)
        assert np.all(makespans_s(scaled(load, 1.5), block) >= base - 1e-6)
