"""Payload of each robot over time: its tool and the parts it carries."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from planning.cell.workcell import CellObject, PlacedRobot, RackTool
from planning.transforms import Transform
from scheduling.conflicts.object_spans import Moment, ObjectSpan, trace_objects
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import planned_ranks


@dataclass(frozen=True, eq=False)
class HandLoad:
    """Tool and parts in the hand of a robot.

    Attributes:
        tool: the tool on its flange, of a robot that changes its tools; None for none, and for a
            robot that keeps its own.
        parts: held parts, each with its pose in the flange frame.
    """

    tool: RackTool | None = None
    parts: tuple[tuple[CellObject, Transform], ...] = ()


class HandLoads:
    """Tool and parts in the hand of one robot over time.

    Args:
        tpg: the graph.
        robot: of the cell.
        spans: in which it carries something.
    """

    def __init__(
        self, tpg: TemporalPlanGraph, robot: PlacedRobot, spans: Sequence[ObjectSpan]
    ) -> None:
        tools = {tool.name: tool for tool in robot.tools}
        objects = {item.name: item for item in tpg.cell.objects}
        begins = sorted(spans, key=lambda span: span.start, reverse=True)
        self._moments: list[Moment] = sorted(
            {moment for span in spans for moment in (span.start, span.end)}
        )
        self._loads: list[HandLoad] = []
        held: list[ObjectSpan] = []
        for moment in self._moments:
            while begins and begins[-1].start <= moment:
                held.append(begins.pop())
            held = [span for span in held if span.end > moment]
            mounted = [tools[span.object] for span in held if span.object in tools]
            parts = [
                (objects[span.object], span.pose)
                for span in held
                if span.object not in tools
            ]
            self._loads.append(HandLoad(mounted[0] if mounted else None, tuple(parts)))

    def after(self, node: int, waypoint: int) -> HandLoad:
        """Return the payload of the robot from a waypoint of a node to the next one.

        Args:
            node: of its chain.
            waypoint: 0 = when the node starts, k = at the node's k-th waypoint.
        """
        k = bisect_right(self._moments, (node, waypoint)) - 1
        return self._loads[k] if k >= 0 else HandLoad()

    def runs(self, node: int, waypoints: int) -> list[tuple[int, int, HandLoad]]:
        """Return the intervals of a node with a constant payload.

        Args:
            node: of the chain.
            waypoints: how many the path of the node has, with the one that it starts from.

        Returns:
            First and last waypoint of each, and the load.
        """
        low = bisect_right(self._moments, (node, 0))
        high = bisect_left(self._moments, (node, waypoints - 1))
        borders = [waypoint for _, waypoint in self._moments[low:high]]
        edges = [0, *borders, max(waypoints - 1, 0)]
        return [(begin, end, self.after(node, begin)) for begin, end in pairwise(edges)]


def hand_loads(tpg: TemporalPlanGraph) -> tuple[HandLoads, ...]:
    """Return the payloads of the robots, one entry per chain; machines hold nothing."""
    spans: list[list[ObjectSpan]] = [[] for _ in tpg.chains]
    for span in trace_objects(tpg, planned_ranks(tpg.chains)).spans:
        if span.carried:
            spans[span.robot].append(span)
    return tuple(
        HandLoads(tpg, tpg.cell.robot(chain.robot), own)
        for chain, own in zip(tpg.chains, spans, strict=True)
    )
