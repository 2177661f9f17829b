"""What the manifest says of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from twin.runs.policies import IN_TURNS


@dataclass(frozen=True)
class RunHeader:
    """Entry ``run`` of a manifest: what is known before a run, and needed to conclude or resume it.

    Attributes:
        recording: whether ``run.rrd`` is wanted.
        audit: whether the audit is to check what was executed; the name of an engine says with what.
        planning_s: wall-clock seconds of the planning stages.
        makespan_sequential_s: makespan of the plan in turns, one robot at a time and machines meanwhile [s].
        plan_sha256: hash of the plan.
        plan: which plan it is: a plan of twin.runs.policies.
        turns_sha256: hash of the plan in turns, where it is another one.
        warnings: what is doubtful about the cell and what was asked for.
        checks_off: checks that the scenario switches off, with ``key`` and ``check``.
        fits: how parts fit where they are put, step by step.
        idle: by robot that gets no task: why, and how many steps it can serve.
        load_bound_s: makespan that no choice of who does what can beat, where it is known [s].
        makespan_asynchronous_s: makespan of the plan in turns, each robot going on as soon as it is safe, where the
            plan is what became of it by a better order of tasks and shortcuts [s].
        operated: whether what fails is planned anew.
        answered: whether somebody answered what a person was asked, so that it cannot be executed again.
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
    load_bound_s: float | None = None
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
