"""States of robots in charts and recordings, their colours, and causes of edges in words."""

from __future__ import annotations

from planning.tasks.task import TRANSIT
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TASK_DEPENDENCY

WAITING = "waiting"
STALLED = "stalled"
STOPPED = "stopped"
RETRYING = "retrying"
FAILED = "failed"
IDLE = "idle"

LANE_COLOURS: dict[str, tuple[int, int, int]] = {
    TRANSIT: (151, 166, 186),
    "pick": (238, 170, 51),
    "place-down": (46, 139, 87),
    "place-up": (111, 190, 110),
    "handover": (178, 84, 160),
    "support-bottom": (47, 111, 178),
    "support-top": (105, 170, 222),
    WAITING: (226, 229, 233),
    STALLED: (206, 54, 48),
    STOPPED: (120, 22, 30),
    RETRYING: (232, 118, 72),
    FAILED: (28, 28, 32),
    IDLE: (242, 243, 245),
}
"""Colour (r, g, b), 0 to 255, of every state of a lane."""

CAUSES = {TASK_DEPENDENCY: "task dependency", MOTION_CONFLICT: "motion conflict"}
"""Causes of type-2 edges in words."""

OTHER_COLOUR = (140, 120, 100)
"""Colour of a task kind without one of its own."""
