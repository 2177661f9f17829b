"""What is asserted of runs of robots that keep to limits, and what they are drawn with."""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from scheduling.graph.dispatcher import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.simulated import simulate
from twin.durations.bounded import Fixed, Uniform
from twin.durations.model import NANOSECONDS
from twin.engine.bulk.bulk_engine import BulkEngine
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.run.events import ExecutionRecord
from twin.run.trajectory import Trajectory, robot_trajectories
from twin.uncertainty.disturbances import Disturbances, Stalls

MESSAGES = st.builds(
    Messages.of_seconds,
    st.sampled_from([None, 1, 3]),
    st.sampled_from([0.0, 0.05, 0.5]),
    st.sampled_from([0.0, 0.05]),
)
QUIET = st.builds(
    Disturbances,
    jitter=st.sampled_from([None, Uniform(low_s=0.0, high_s=0.1)]),
    stalls=st.builds(
        Stalls,
        count_per_robot=st.sampled_from([0, 2]),
        rate_per_h=st.sampled_from([0.0, 400.0]),
        duration=st.sampled_from([None, Fixed(value_s=0.3)]),
    ),
)


def travelled(motion: Trajectory, t_ns: np.ndarray) -> np.ndarray:
    """Return how far along its path a robot is at some times: every row in between is looked at."""
    times = np.unique(np.concatenate([motion.t_ns, t_ns]))
    q = motion.at(times)
    way = np.linalg.norm(np.diff(q, axis=0), axis=1)
    return np.interp(t_ns, times, np.concatenate([[0.0], np.cumsum(way)]))


def path_borders(tpg: TemporalPlanGraph, k: int) -> np.ndarray:
    """Return how far along the path of a chain each node begins, and the end."""
    chain = tpg.chains[k]
    points = np.vstack([chain.start[None], chain.waypoints])
    way = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(way)])[chain.first]


def assert_within_limits(tpg: TemporalPlanGraph, run: ExecutionRecord) -> None:
    """Check speeds, accelerations and jerks of all motions, and that rows say what positions do."""
    for motion in robot_trajectories(tpg, run):
        limits = tpg.cell.robot(motion.robot).limits
        assert limits is not None
        assert motion.v is not None
        assert motion.a is not None
        span = np.diff(motion.t_ns)[:, None] / NANOSECONDS
        assert np.all(span > 0.0)
        assert np.max(np.abs(motion.v) / limits.velocity) <= 1.0 + 1e-6
        assert np.max(np.abs(motion.a) / limits.acceleration) <= 1.0 + 1e-6
        rise = np.abs(np.diff(motion.a, axis=0))
        assert np.all(rise <= limits.jerk * span * (1.0 + 1e-6) + 1e-7)
        gained = span * (motion.a[:-1] + motion.a[1:]) / 2
        assert np.allclose(np.diff(motion.v, axis=0), gained, atol=1e-6)
        moved = span * motion.v[:-1] + span**2 * (2 * motion.a[:-1] + motion.a[1:]) / 6
        assert np.allclose(np.diff(motion.q, axis=0), moved, atol=1e-6)


def assert_inside_cleared_nodes(
    tpg: TemporalPlanGraph, run: ExecutionRecord, late_ns: int = 0
) -> None:
    """Check of every edge that the first is left, and known to be, before the second is entered."""
    motions = {motion.robot: motion for motion in robot_trajectories(tpg, run)}
    for r, u, s, v in tpg.edges.tolist():
        done = int(run.end_ns[r][u])
        if done < 0:
            continue
        first = motions[tpg.chains[r].robot]
        left = travelled(first, np.array([done]))[0]
        # Gentle corners of skills are cut by less than this.
        assert left >= path_borders(tpg, r)[u + 1] - 1e-3
        then = motions[tpg.chains[s].robot]
        here = travelled(then, np.array([min(done + late_ns, run.makespan_ns)]))[0]
        assert here <= path_borders(tpg, s)[v] + 1e-3


def assert_engines_agree(
    tpg: TemporalPlanGraph, model: ExecutionModel, seed: int
) -> None:
    """Check that both engines start and end every node in the same nanosecond."""
    engine = BulkEngine(tpg, model)
    found = engine.execute(engine.sample(seed=seed, replications=range(4)))
    simulator = Simulator(tpg, model)
    for k in range(4):
        run = simulator.run(seed=seed, replication=k)
        assert np.concatenate(run.start_ns).tolist() == found.start_ns[:, k].tolist()
        assert np.concatenate(run.end_ns).tolist() == found.end_ns[:, k].tolist()


def assert_takes_as_planned(
    tpg: TemporalPlanGraph, seed: int, *, within_s: float
) -> None:
    """Check that robots which need not wait for others end every node when the plan does."""
    free = replace(
        tpg, edges=tpg.edges[:0], cause=tpg.cause[:0], dependencies=tpg.dependencies[:0]
    )
    run = simulate(free, seed=seed)
    planned = earliest_times(free)
    for end, nominal in zip(run.end_ns, planned.end, strict=True):
        assert np.allclose(end / NANOSECONDS, nominal, atol=within_s)
