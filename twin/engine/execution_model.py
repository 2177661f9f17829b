"""Execution model of a plan: policy, durations, messages and disturbances."""

from __future__ import annotations

from dataclasses import dataclass, field

from twin.engine.messages import Messages
from twin.run.run_record import Policy
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.skill_durations import SkillDurations


@dataclass(frozen=True)
class ExecutionModel:
    """Execution model: policy, durations, messages and disturbances.

    Attributes:
        durations: of skills.
        policy: how nodes are released; see Simulator.
        messages: between robots and dispatcher.
        disturbances: what may go wrong.
    """

    durations: SkillDurations
    policy: Policy = "asynchronous"
    messages: Messages = field(default_factory=Messages)
    disturbances: Disturbances = field(default_factory=Disturbances)
