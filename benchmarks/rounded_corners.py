"""What rounding the corners of a plan within limits saves of what resting at them costs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import nominal_durations, within_limits
from scheduling.shortcuts.corners import round_corners


def corner_figures(
    rested: TemporalPlanGraph, executed: Callable[[TemporalPlanGraph], list[str]]
) -> dict[str, Any]:
    """Return what corners cost and what rounding them saves, by nominal durations.

    Args:
        rested: a graph within limits whose robots rest at corners.
        executed: executes a graph and returns what is wrong with it.
    """
    begin = time.process_time()
    rounded = within_limits(round_corners(rested))
    spent = time.process_time() - begin
    without, rests = _without_rests(rested)
    corners = [0 if c.corners is None else len(c.corners.bend) for c in rounded.chains]
    return {
        "rests": rests,
        "rounded": sum(corners),
        "rested_s": earliest_times(rested).makespan,
        "rounded_s": earliest_times(rounded).makespan,
        "without_rests_s": earliest_times(without).makespan,
        "rounding_cpu_s": spent,
        "violations": executed(rounded),
    }


def _without_rests(rested: TemporalPlanGraph) -> tuple[TemporalPlanGraph, int]:
    """Return a graph as if corners cost nothing, which no robot could follow, and their number."""
    chains, corners = [], 0
    for k, chain in enumerate(rested.chains):
        drive = chain.drive
        if drive is None:
            chains.append(chain)
            continue
        moves = drive.ramp > 0.0
        goes_on = moves & np.append(moves[1:], False)
        for handling in rested.handlings:
            # What changes hands does so at rest.
            if handling.robot == k:
                goes_on[handling.node - (handling.waypoint == 0)] = False
        corners += int(np.sum(goes_on & drive.rests))
        free = replace(drive, rests=drive.rests & ~goes_on)
        duration = np.where(moves, nominal_durations(free), chain.duration)
        least = np.zeros_like(duration)
        chains.append(replace(chain, duration=duration, least=least, drive=free))
    return replace(rested, chains=tuple(chains)), corners
