"""Disturbances in a scenario file: what they become, and what is wrong with them."""

import json
from pathlib import Path

import pytest

from tests.planted import rows
from tests.twin.turning_arms import SCENARIO
from tests.twin.written import loaded, refusal
from twin.durations.bounded import Fixed, Uniform
from twin.durations.lognormal import Lognormal
from twin.scenario.sections.execution import ExecutionSection
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    LognormalFactor,
    SkillFailure,
    Speed,
    Stalls,
    UniformFactor,
)

ROBOTS = ("left", "right")
EVERYTHING = """\
  queue_depth: 3
  latency_s: 0.1
  report_latency_s: 0.02
  speed:
    factor: {kind: uniform, low: 0.7, high: 1.0}
    robots:
      left: {kind: lognormal, median: 0.9, p95: 1.2}
  jitter: {kind: uniform, low_s: 0, high_s: 0.01}
  stalls:
    count_per_robot: 2
    rate_per_h: 60
    duration: {kind: fixed, value_s: 3}
  breakdowns: {mtbf_s: 120, mttr_s: 20, robots: [right]}
  failures:
    pick: {probability: 0.2, retries: 3, retry: {kind: fixed, value_s: 4}}
    handover: {probability: 0.1}
  emergency_stops:
    - {at_s: 40, duration_s: 10}
    - {robot: left, at_s: 100.5, duration_s: 30}
"""


def execution(text: str) -> ExecutionSection:
    return ExecutionSection.model_validate_json(text)


def test_a_scenario_says_all_that_may_go_wrong(tmp_path: Path) -> None:
    scenario = loaded(tmp_path, SCENARIO + EVERYTHING)
    found = scenario.execution.disturbances(ROBOTS, tmp_path)
    three = Fixed(value_s=3.0)
    assert found.speed.model_of("left") == Lognormal(median_s=0.9, p95_s=1.2)
    assert found.speed.model_of("right") == Uniform(low_s=0.7, high_s=1.0)
    assert found == Disturbances(
        speed=Speed(
            factor=UniformFactor(kind="uniform", low=0.7, high=1.0),
            robots={"left": LognormalFactor(kind="lognormal", median=0.9, p95=1.2)},
        ),
        jitter=Uniform(low_s=0.0, high_s=0.01),
        stalls=Stalls(count_per_robot=2, rate_per_h=60.0, duration=three),
        breakdowns=Breakdowns(
            mtbf_s=120.0, mttr_s=20.0, clock="busy", robots=("right",)
        ),
        failures={
            "pick": SkillFailure(probability=0.2, retries=3, retry=Fixed(value_s=4.0)),
            "handover": SkillFailure(probability=0.1, retries=2, retry=None),
        },
        emergency_stops=(
            EmergencyStop(robot=None, at_s=40.0, duration_s=10.0),
            EmergencyStop(robot="left", at_s=100.5, duration_s=30.0),
        ),
    )


def test_a_scenario_without_a_word_is_undisturbed() -> None:
    assert execution("{}").disturbances(ROBOTS) == Disturbances()


def test_stalls_at_a_rate_take_the_interval_when_they_have_no_distribution() -> None:
    section = execution('{"stalls": {"rate_per_h": 5, "duration_s": [2, 4]}}')
    found = section.disturbances(ROBOTS)
    assert found.stalls.count_per_robot == 0
    assert found.stalls.model == Uniform(low_s=2.0, high_s=4.0)


@pytest.mark.parametrize(
    ("content", "reasons"),
    [
        ({}, 0),
        ({"queue_depth": 9, "jitter": {"kind": "fixed", "value_s": 1}}, 0),
        ({"breakdowns": {"mtbf_s": 1, "mttr_s": 1}}, 0),
        ({"failures": {"pick": {"probability": 1}}}, 0),
        ({"latency_s": 0.1}, 1),
        ({"latency_s": 0.1, "report_latency_s": 0, "release_latency_s": 0}, 0),
        ({"report_latency_s": 0.1, "release_latency_s": 0.2}, 2),
        ({"breakdowns": {"mtbf_s": 1, "mttr_s": 1, "clock": "run"}}, 1),
        ({"emergency_stops": [{"at_s": 1, "duration_s": 1}], "latency_s": 1}, 2),
    ],
)
def test_what_only_the_event_engine_can_do(
    content: dict[str, object], reasons: int
) -> None:
    found = execution(json.dumps(content)).needs_event_engine()
    assert len(found) == reasons
    assert all(
        reason.split()[0] in str(ExecutionSection.model_fields) for reason in found
    )


@pytest.mark.parametrize(
    ("text", "place", "words"),
    rows(r"""
entry                                        | at    | says
"  breakdowns: {mtbf_s: 9, mttr_s: 1, robots: [rigth]}\n" | 18:47 | unknown robot 'rigth'; did you mean 'right'? (valid: left, right)
"  emergency_stops: [{robot: north, at_s: 1, duration_s: 1}]\n" | 18:29 | unknown robot 'north'
"  speed: {robots: {lefty: {kind: fixed, value: 1}}}\n" | 18:27 | unknown robot 'lefty'; did you mean 'left'?
"  speed: {factor: {kind: fixed, value: 0}}\n" | 18:40 | 0.001
"  speed: {factor: {kind: uniform, low: 2, high: 1}}\n" | 18:19 | low
"  failures: {pick: {probability: 1.5}}\n"   | 18:34 | 1
"  failures: {pikc: {probability: 0.5}}\n"   | 18:14 | did you mean 'pick'
"  breakdowns: {mtbf_s: 0, mttr_s: 1}\n"     | 18:24 | 0
"  breakdowns: {mtbf_s: 5}\n"                | 18:15 | mttr_s
"  emergency_stops: [{at_s: 1, duration_s: 0}]\n" | 18:43 | 0
"  stalls: {rate_per_hour: 3}\n"             | 18:12 | rate_per_h
"  policy: openloop\n"                       | 18:11 | open-loop
"  report_latency_s: -1\n"                   | 18:21 | 0
"""),
)
def test_what_cannot_be_is_named_with_its_place(
    tmp_path: Path, text: str, place: str, words: str
) -> None:
    report = refusal(tmp_path, SCENARIO + text).report()
    assert f"own.yaml:{place}: " in report
    assert words in report
