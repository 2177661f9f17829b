"""What inputs do to the makespan: bars of a tornado, and Sobol indices of a plan that adds up."""

from dataclasses import replace

import numpy as np
import pytest

from planning.errors import RequestError
from tests.twin.driven_toys import driven_tpg
from tests.twin.study.study_toys import toy_workload
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Fixed, Uniform
from twin.engine.execution_model import ExecutionModel
from twin.study.folder import check_points
from twin.study.gains.gains import cell_gains
from twin.study.replications.statistics import Block, Experiment
from twin.study.replications.workload import Workload, timing_graph
from twin.study.sensitivity import influences, inputs_of, makespans_s, sobol_indices
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
    found = {one.name: one for one in influences(load)}
    assert set(found) == {"duration of pick", "motions of robot_0"}
    picks, motions = found["duration of pick"], found["motions of robot_0"]
    assert (picks.less_s, picks.more_s) == pytest.approx((-0.2 * skills, 0.2 * skills))
    assert (motions.less_s, motions.more_s) == pytest.approx(
        (-0.2 * moves, 0.2 * moves), abs=1e-6
    )


def test_motions_within_limits_count_as_they_do_in_what_is_worth_fixing() -> None:
    tpg = timing_graph(driven_tpg(3, dofs=(2,), tasks=8, edges=0))
    load = Workload(tpg, ExecutionModel(SkillDurations({})), 0)
    (motions,) = (one for one in influences(load) if one.name.startswith("motions"))
    gains = cell_gains(Experiment(("asynchronous",), replications=1), load, 1).gains
    (every,) = (one for one in gains if one.lever.name == "every motion")
    assert motions.less_s < -0.1
    assert motions.less_s == pytest.approx(-every.shorter.mean_s.estimate, abs=1e-6)
    assert motions.more_s == pytest.approx(-motions.less_s, rel=0.2)


def test_sobol_indices_of_a_sum_are_shares_of_variance() -> None:
    load = _sum_of_two()
    skills = 4 * 2.0
    moves = float(makespans_s(load, Block(0, 0, 1))[0]) - skills
    calls: list[int] = []
    found = sobol_indices(
        load, 64, progress=lambda stage, done, total: calls.append(done)
    )
    assert calls == list(range(1, 64 * 4 + 1))
    shares = {"duration of pick": skills**2, "motions of robot_0": moves**2}
    for one in found:
        expected = shares[one.name] / sum(shares.values())
        assert one.first == pytest.approx(expected, abs=0.1)
        assert one.total == pytest.approx(expected, abs=0.1)


def test_points_are_a_power_of_two() -> None:
    with pytest.raises(RequestError, match="power of 2"):
        check_points(48)


def test_inputs_are_what_the_plan_has() -> None:
    stalls = Stalls(rate_per_h=30.0, duration=Uniform(low_s=1.0, high_s=2.0))
    load = toy_workload(disturbances=Disturbances(stalls=stalls))
    inputs = inputs_of(load)
    assert "rate of stalls" in inputs
    assert "duration of support-bottom" not in inputs
    block = Block(0, 0, 30)
    base = makespans_s(load, block)
    for scaled in inputs.values():
        same = makespans_s(scaled(load, 1.0), block)
        assert np.allclose(same, base, atol=1e-6)
        assert np.all(makespans_s(scaled(load, 1.5), block) >= base - 1e-6)
