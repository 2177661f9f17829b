"""Time parameterization of a plan: node times within the limits of its robots.

Corners of paths are rounded first if the scenario requests it.
"""

from __future__ import annotations

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import assign_node_times
from twin.host.progress import StageWatch
from twin.registry import HOOKS
from twin.scenario.sections.scenario import Scenario

CORNERS = "corners"
"""Name of the stage for progress displays, and of the hook that rounds corners."""


def time_parameterize(
    tpg: TemporalPlanGraph, scenario: Scenario, watch: StageWatch
) -> TemporalPlanGraph:
    """Return a graph with node times within the robots' limits; the stage is tpg.

    Corners are rounded first, where the scenario says so. A graph without edges, or executed slot by
    slot, is returned unchanged.
    """
    limited = scenario.speed_model == "limits" and scenario.planning.corners == "smooth"
    ordered = len(tpg.edges) > 0 or len(tpg.chains) < 2
    if limited and ordered and not len(tpg.slots):
        round_corners = HOOKS.require(CORNERS, "corners: smooth")
        with watch.stage("tpg", CORNERS):
            tpg = round_corners(tpg, progress=watch.reporter(CORNERS))
    return assign_node_times(tpg)
