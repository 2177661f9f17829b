"""How a plan is executed: the ``execution`` section of a scenario file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from twin.scenario_base import Section
from twin.scenario_disturbances import (
    BreakdownsSection,
    EmergencyStopSection,
    FailureSection,
    SpeedSection,
    StallsSection,
)
from twin.scenario_durations import DurationSection

Skill = Literal[
    "pick",
    "place-down",
    "place-up",
    "handover",
    "support-bottom",
    "support-top",
]

Latency = Annotated[float, Field(ge=0, le=3600)]


class ExecutionSection(Section):
    """How the plan is executed.

    Attributes:
        policy: ``asynchronous`` releases a node as soon as what it waits for is complete;
            ``sequential`` runs one task at a time; ``synchronous`` runs a plan made in slots
            slot by slot; in ``open-loop`` every robot follows the planned clock and nobody waits.
        queue_depth: nodes that a robot may have been given ahead.
        latency_s: time that a message takes between a robot and the dispatcher [s].
        report_latency_s: the same from robot to dispatcher only [s].
        release_latency_s: the same from dispatcher to robot only [s].
        skills: duration models by skill; the packaged synthetic timings where not given.
        speed: speed factors of the robots' controllers.
        jitter: distribution of what every node takes longer.
        stalls: random standstills.
        breakdowns: of robots.
        failures: of attempts at a skill, by skill.
        emergency_stops: at given times.
    """

    policy: Literal["asynchronous", "sequential", "synchronous", "open-loop"] = (
        "asynchronous"
    )
    queue_depth: Annotated[int, Field(ge=1, le=100_000)] = 1
    latency_s: Latency = 0.0
    report_latency_s: Latency | None = None
    release_latency_s: Latency | None = None
    skills: dict[Skill, DurationSection] = Field(default_factory=dict)
    speed: SpeedSection = SpeedSection()
    jitter: DurationSection | None = None
    stalls: StallsSection = StallsSection()
    breakdowns: BreakdownsSection | None = None
    failures: dict[Skill, FailureSection] = Field(default_factory=dict)
    emergency_stops: tuple[EmergencyStopSection, ...] = ()
