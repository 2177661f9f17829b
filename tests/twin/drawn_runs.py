"""What runs are drawn from: graphs, durations, and whatever disturbs them."""

from hypothesis import strategies as st

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Fixed, Uniform
from twin.durations.measured import packaged_timings
from twin.durations.nanoseconds import Nanoseconds
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    SkillFailure,
    Stalls,
)
from twin.uncertainty.draws import uniforms
from twin.uncertainty.node_times import NodeTimes, NodeTimeSampler
from twin.uncertainty.skill_durations import SkillDurations

VARIED = SkillDurations(packaged_timings())
TPGS = st.builds(
    random_tpg,
    st.integers(0, 10**6),
    dofs=st.sampled_from([(2, 3), (1, 2, 3), (2,)]),
    tasks=st.integers(1, 10),
    nodes_per_transit=st.integers(1, 5),
    edges=st.integers(0, 15),
)
STOPS = st.lists(
    st.builds(
        EmergencyStop,
        robot=st.sampled_from([None, "robot_0", "robot_1"]),
        at_s=st.floats(0.0, 40.0),
        duration_s=st.floats(0.001, 15.0),
    ),
    max_size=4,
)
ANYTHING = st.builds(
    Disturbances,
    jitter=st.sampled_from([None, Uniform(low_s=0.0, high_s=0.1)]),
    stalls=st.builds(
        Stalls,
        count_per_robot=st.sampled_from([0, 1]),
        rate_per_h=st.sampled_from([0.0, 200.0]),
        duration=st.sampled_from([None, Fixed(value_s=1.0)]),
    ),
    breakdowns=st.sampled_from(
        [
            None,
            Breakdowns(mtbf_s=30.0, mttr_s=5.0),
            Breakdowns(mtbf_s=20.0, mttr_s=5.0, clock="run"),
        ]
    ),
    failures=st.sampled_from([{}, {"pick": SkillFailure(probability=0.5, retries=1)}]),
    emergency_stops=STOPS.map(tuple),
)


def uniform(
    seed: int,
    replication: int,
    robot: str,
    task: int,
    kind: str,
    purpose: str,
    index: int = 0,
) -> float:
    """The uniform in (0, 1) of one named draw."""
    return float(
        uniforms(seed, [replication], [robot], task, [kind], purpose, index)[0, 0]
    )


def sample(
    durations: SkillDurations,
    tpg: TemporalPlanGraph,
    *,
    seed: int,
    replication: int = 0,
) -> tuple[Nanoseconds, ...]:
    """Durations of one replication per chain, each of shape (nodes,) [ns]."""
    draws = durations.bind(tpg)
    totals = draws.totals(seed=seed, replications=[replication])
    return tuple(draws.durations(k, totals)[:, 0] for k in range(len(tpg.chains)))


def sample_node_times(
    tpg: TemporalPlanGraph,
    durations: SkillDurations,
    disturbances: Disturbances | None = None,
    *,
    seed: int,
    replication: int = 0,
) -> NodeTimes:
    """What every node of a graph takes in one replication."""
    sampler = NodeTimeSampler(tpg, durations, disturbances or Disturbances())
    return sampler.sample(seed=seed, replication=replication)
