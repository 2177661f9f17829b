"""Both engines agree where machines bring parts and take products away, to the nanosecond."""

import numpy as np
import pytest

from scheduling.build_tpg import build_tpg
from scheduling.graph.task_edges import machine_chains
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.repeat import repeat_graph
from tests.scheduling.line_world import line_plan
from tests.twin.simulated import assert_same_ends
from twin.durations.bounded import Fixed, Uniform
from twin.durations.lifetimes import SkillOverride
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.recorders.observers import MemoryRecorder
from twin.run.events import Policy
from twin.uncertainty.disturbances import Disturbances, EmergencyStop, Stalls
from twin.uncertainty.skill_durations import SkillDurations

DURATIONS = SkillDurations(
    {"pick": Uniform(low_s=1.0, high_s=4.0), "place-down": Fixed(value_s=2.0)},
    (
        SkillOverride.model_construct(
            skill="arrive",
            robot="belt",
            object=None,
            duration=Uniform(low_s=2.0, high_s=30.0),
        ),
    ),
)


@pytest.fixture(scope="module")
def line() -> TemporalPlanGraph:
    plan, pattern = line_plan(every_s=16.0, leave_s=1.5, products=9, buffer=2)
    return repeat_graph(build_tpg(plan), pattern)


@pytest.mark.parametrize("policy", ["asynchronous", "sequential", "open-loop"])
@pytest.mark.parametrize(
    "disturbances",
    [Disturbances(), Disturbances(stalls=Stalls(count_per_robot=3))],
    ids=["calm", "stalls"],
)
def test_engines_agree(
    line: TemporalPlanGraph, policy: Policy, disturbances: Disturbances
) -> None:
    model = ExecutionModel(DURATIONS, policy, disturbances=disturbances)
    found = assert_same_ends(line, model, 3, range(8))
    for r in range(8):
        watched = Simulator(line, model).run(
            seed=3, replication=r, recorders=[MemoryRecorder()]
        )
        assert watched.makespan_ns == found.makespan_ns[r]


def test_one_robot_works_at_a_time_and_machines_beside_it(
    line: TemporalPlanGraph,
) -> None:
    run = Simulator(line, ExecutionModel(DURATIONS, "sequential")).run(seed=0)
    machines = machine_chains(line)
    robots = [k for k in range(len(line.chains)) if k not in machines]
    spans = np.concatenate(
        [np.stack([run.start_ns[k], run.end_ns[k]], axis=1) for k in robots]
    )
    spans = spans[np.argsort(spans[:, 0], kind="stable")]
    assert np.all(spans[1:, 0] >= spans[:-1, 1])
    (belt,) = (k for k, c in enumerate(line.chains) if c.robot == "belt")
    # The belt goes on while a robot works, until what may wait on it is full.
    assert run.start_ns[belt][1] == run.end_ns[belt][0]


def test_nothing_disturbs_a_machine(line: TemporalPlanGraph) -> None:
    stops = (EmergencyStop(at_s=5.0, duration_s=100.0),)
    stalls = Stalls(rate_per_h=3600.0)
    model = ExecutionModel(
        DURATIONS, disturbances=Disturbances(emergency_stops=stops, stalls=stalls)
    )
    run = Simulator(line, model).run(seed=1)
    for k in machine_chains(line):
        assert run.stopped_ns(k, run.makespan_ns) == 0
        assert not np.any(run.stood_ns[k])


def test_machines_take_messages_too(line: TemporalPlanGraph) -> None:
    slow = Messages.of_seconds(report_s=0.1, release_s=0.1)
    model = ExecutionModel(DURATIONS, messages=slow)
    late = Simulator(line, model).run(seed=1).makespan_ns
    assert late > Simulator(line, ExecutionModel(DURATIONS)).run(seed=1).makespan_ns
