"""What runs are drawn from: graphs, durations, and whatever disturbs them."""

from __future__ import annotations

from hypothesis import strategies as st

from tests.twin.twin_toys import random_tpg
from twin.durations import Fixed, Uniform, packaged_timings
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    RandomStalls,
    SkillFailure,
    StallRate,
)
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
        st.sampled_from([None, "robot_0", "robot_1"]),
        st.floats(0.0, 40.0),
        st.floats(0.001, 15.0),
    ),
    max_size=4,
)
ANYTHING = st.builds(
    Disturbances,
    jitter=st.sampled_from([None, Uniform(0.0, 0.1)]),
    stalls=st.sampled_from([None, RandomStalls(1)]),
    stall_rate=st.sampled_from([None, StallRate(200.0, Fixed(1.0))]),
    breakdowns=st.sampled_from(
        [None, Breakdowns(30.0, 5.0), Breakdowns(20.0, 5.0, "run")]
    ),
    failures=st.sampled_from([{}, {"pick": SkillFailure(0.5, 1)}]),
    emergency_stops=STOPS.map(tuple),
)
