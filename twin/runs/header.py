"""Entry ``run`` of a manifest: data needed to finish or resume a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from twin.runs.policies import IN_TURNS


@dataclass(frozen=True)
class RunHeader:
    """Entry ``run`` of a manifest: data needed to finish or resume a run.

    Attributes:
        recording: whether to write ``run.rrd``.
        audit: whether to audit the run; a name selects the collision engine.
        planning_s: wall-clock seconds of the planning stages.
        makespan_sequential_s: makespan of the plan in turns, one robot at a time and machines meanwhile [s].
        plan_sha256: hash of the plan.
        plan: which plan it is: a plan of twin.runs.policies.
        turns_sha256: hash of the plan in turns, where it is another one.
        warnings: warnings about the cell and the options.
        checks_off: checks that the scenario switches off, with ``key`` and ``check``.
        fits: how parts fit where they are put, step by step.
        idle: by robot that gets no task: why, and how many steps it can serve.
        makespan_bound_s: lower bound of the makespan over all assignments, where known [s].
        assignment_search: what the search for an assignment gained, where there was one.
        makespan_asynchronous_s: makespan of the sequential plan, released asynchronously, where the
            plan has an improved task order and shortcuts [s].
        operated: whether the run replans after failures.
        answered: whether a person answered questions, so that it cannot be repeated.
        session: of the drivers that moved the robots, None where they are simulated.
    """

    recording: bool = False
    audit: bool | str = False
    planning_s: Mapping[str, float] = field(default_factory=dict)
    makespan_sequential_s: float | None = None
    plan_sha256: str = ""
    plan: str = IN_TURNS
    turns_sha256: str | None = None
    warnings: Sequence[str] = ()
    checks_off: Sequence[Mapping[str, str]] = ()
    fits: Sequence[Mapping[str, Any]] = ()
    idle: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    makespan_bound_s: float | None = None
    assignment_search: Mapping[str, Any] | None = None
    makespan_asynchronous_s: float | None = None
    operated: bool = False
    answered: bool = False
    session: Mapping[str, Any] | None = None

    @property
    def executor(self) -> str:
        """Name of the entry of ``twin.registry.EXECUTORS`` that executes the run."""
        if self.session is not None:
            return "live"
        return "operated" if self.operated else "simulated"
