"""Colours of Gantt chart lanes, by type of task or by state of a robot at rest."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import cycle

from planning.tasks.task import Actuation, TaskKind
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.activities.activities import FAILED, HOLDING, IDLE, RETRYING, WAITING
from twin.activities.progress import STALLED, STOPPED

LANE_COLOURS: dict[str, str] = {
    TaskKind.TRANSIT: "#97a6ba",
    TaskKind.STRAIGHT: "#7688a2",
    "pick": "#eeaa33",
    "place-down": "#2e8b57",
    "place-up": "#6fbe6e",
    "handover": "#b254a0",
    "support-bottom": "#2f6fb2",
    "support-top": "#69aade",
    TaskKind.HOLD: "#4b8fc8",
    Actuation.CLOSE: "#c27c0e",
    Actuation.OPEN: "#c9b458",
    TaskKind.ARRIVE: "#c9b88f",
    TaskKind.PRESENT: "#a5885a",
    TaskKind.BROUGHT: "#b89a3c",
    TaskKind.LEAVE: "#8f6f9c",
    TaskKind.CHANGEOVER: "#7d6b3d",
    HOLDING: "#b3d3ee",
    WAITING: "#e2e5e9",
    STALLED: "#ce3630",
    STOPPED: "#78161e",
    RETRYING: "#e87648",
    FAILED: "#1c1c20",
    IDLE: "#f2f3f5",
}
"""Colours of the states of a lane that are there in any run, and of skills, #rrggbb."""

_OTHER_COLOURS = (
    "#8c7864",
    "#c0648c",
    "#4c8f96",
    "#a08c2e",
    "#7d6fb8",
    "#b5703f",
    "#5f8a5a",
    "#94596a",
)


def lane_colours(kinds: Iterable[str]) -> dict[str, str]:
    """Return the colours of all states of lanes, those of other kinds of tasks in their order."""
    others = dict.fromkeys(kind for kind in kinds if kind not in LANE_COLOURS)
    return {**LANE_COLOURS, **dict(zip(others, cycle(_OTHER_COLOURS), strict=False))}


def plan_colours(tpg: TemporalPlanGraph) -> dict[str, str]:
    """Return the colours of the states that occur in a plan's lanes."""
    return lane_colours(task.kind for task in tpg.tasks)
