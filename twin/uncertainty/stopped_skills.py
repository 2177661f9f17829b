"""Motion of skills that are interrupted by stops: robots brake along their paths within their limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from planning.timing.braking import StoppedPath, stop_along_path
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import skill_motion
from twin.durations.nanoseconds import NANOSECONDS
from twin.uncertainty.stop_times import NEVER

NextStop = Callable[[int], tuple[int, int]]
"""Function that returns the begin and end of the first stop that ends after a given time [ns]."""


def stops_of(intervals: Sequence[tuple[int, int]]) -> NextStop:
    """Return the begin and end times of stops, in order [ns]."""

    def after(t_ns: int) -> tuple[int, int]:
        later = (span for span in intervals if span[1] > t_ns)
        return next(later, (NEVER, NEVER))

    return after


def stopped_skill(
    tpg: TemporalPlanGraph,
    node: tuple[int, int],
    duration_ns: int,
    begin_ns: int,
    stops: NextStop,
) -> StoppedPath | None:
    """Return the motion of a skill interrupted by stops; None without any.

    Args:
        tpg: the executed plan.
        node: the chain of a robot with limits, and a node of it.
        duration_ns: how long the motion takes without stops [ns].
        begin_ns: when it begins [ns].
        stops: of the robot.
    """
    chain = tpg.chains[node[0]]
    limits = tpg.cell.robot(chain.robot).limits
    if limits is None or not chain.skill[node[1]]:
        return None
    if stops(begin_ns)[0] > begin_ns + duration_ns:
        return None
    motion = skill_motion(tpg, *node, limits)
    if motion.seconds <= 0.0:
        return None

    def in_seconds(t: float) -> tuple[float, float]:
        begin, end = stops(round(t * NANOSECONDS))
        return begin / NANOSECONDS, end / NANOSECONDS

    slower = duration_ns / NANOSECONDS / motion.seconds
    return stop_along_path(limits, motion, slower, begin_ns / NANOSECONDS, in_seconds)
