"""Types of the entries of ``summary.json`` that are printed; see docs/reference/formats.md."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NotRequired

from pydantic import TypeAdapter, ValidationError
from typing_extensions import TypedDict

from planning.errors import OutputError


class _Violation(TypedDict):
    kind: str
    first: str
    second: str
    t_start: float
    t_end: float
    depth_m: float
    detail: str


class _Audit(TypedDict):
    violations: list[_Violation]
    min_distance_m: float | None
    configurations: int
    engine: NotRequired[str]
    helpers: NotRequired[list[str]]


class _Fit(TypedDict):
    step: int
    words: str


class _CheckOff(TypedDict):
    key: str
    check: str


class _Machine(TypedDict):
    busy_s: float
    down_s: float
    utilisation: float


class _ActuationTimes(TypedDict):
    times: int
    within_skills: int
    s: float


class _KeptWindow(TypedDict):
    window: str
    at_least_s: float
    within_s: float | None
    passed_s: float | None
    slack_s: float | None
    broken: bool | None


class _Moves(TypedDict):
    stretches: int
    skills: int


class _SlowedBy(_Moves):
    task: int
    label: str
    longest: float


class _Slowed(_Moves):
    by: dict[str, _SlowedBy]


class _Tracking(TypedDict):
    joint: float
    tool_m: float


class _Takt(TypedDict):
    mean: float
    least: float
    greatest: float


class _CycleTime(TypedDict):
    mean: float
    greatest: float


class _Due(TypedDict):
    late: int
    greatest_lateness_s: float


class _Variant(TypedDict):
    products: int
    service_level: float | None
    first_pass_yield: float | None


class _Line(TypedDict):
    products: int
    start_up: int
    throughput_per_h: float | None
    takt_s: _Takt | None
    cycle_time_s: _CycleTime
    work_in_progress: float | None
    due: _Due | None
    workers: NotRequired[dict[str, dict[str, float | None]]]
    variants: NotRequired[dict[str, _Variant]]


class _Version(TypedDict):
    cause: str


class _StepWindow(TypedDict):
    steps: int
    least: int


class _Operation(TypedDict):
    versions: list[_Version]
    window: NotRequired[_StepWindow]
    scrapped: NotRequired[list[int]]
    given_up: NotRequired[dict[str, str]]
    dropped: NotRequired[dict[str, str]]


class _AssignmentSearch(TypedDict):
    moves: int
    predicted_start_s: float
    predicted_s: float
    rated_start_s: float | None
    rated_s: float | None
    taken: bool


class RunSummary(TypedDict):
    """Figures of a run that are printed."""

    scenario: str
    seed: int
    policy: str
    outcome: str
    makespan_s: float
    makespan_sequential_s: float
    makespan_asynchronous_s: NotRequired[float | None]
    lower_bound_s: float
    makespan_bound_s: NotRequired[float | None]
    assignment_search: NotRequired[_AssignmentSearch]
    wait_s: dict[str, float]
    failure: NotRequired[str | None]
    raised_skills: NotRequired[int]
    nodes: int
    type2_edges: int
    planning_s: dict[str, float]
    audit: _Audit | None
    warnings: NotRequired[list[str]]
    checks_off: NotRequired[list[_CheckOff]]
    fits: NotRequired[list[_Fit]]
    actuations: NotRequired[dict[str, _ActuationTimes]]
    machines: NotRequired[dict[str, _Machine]]
    slowed: NotRequired[dict[str, _Slowed]]
    tracking: NotRequired[dict[str, _Tracking]]
    windows: NotRequired[list[_KeptWindow]]
    line: NotRequired[_Line]
    operation: NotRequired[_Operation]


def require_figures(summary: Mapping[str, Any], path: Path) -> None:
    """Refuse a file that lacks a figure that is printed, or has one of another type.

    Raises:
        OutputError: it does.
    """
    try:
        TypeAdapter(RunSummary).validate_python(summary, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise OutputError(
            f"{path}: no summary of a run: {key}: {first['msg']}"
        ) from error
