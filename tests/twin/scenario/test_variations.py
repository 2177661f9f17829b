"""Inputs that are varied: how they are written, and what they do to a scenario."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planning.errors import ScenarioError
from tests.planted import rows
from twin.durations.bounded import Uniform
from twin.planning.build_workcell import build_workcell
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.execution import ReferenceDuration
from twin.scenario.sections.scenario import Scenario
from twin.scenario.variations import (
    Variation,
    apply_variation,
)
from twin.studies.api import combine_variations
from twin.trial.loaded_scenario import load

CLIFF = Path(__file__).parents[3] / "scenarios/lego/cliff.yaml"


@pytest.fixture(scope="module")
def cliff() -> Scenario:
    return load_scenario(CLIFF)


def test_values_are_json_or_plain_words() -> None:
    assert Variation.parse("stalls.count_per_robot=0, 2,10") == Variation(
        "stalls.count_per_robot", (0, 2, 10)
    )
    assert Variation.parse("execution.latency_s=0.5").key == "latency_s"
    assert Variation.parse("stalls.duration_s=[1,2],[5,9]").values == ([1, 2], [5, 9])
    assert Variation.parse('skills.pick={"kind":"fixed","value_s":3}').values == (
        {"kind": "fixed", "value_s": 3},
    )
    assert Variation.parse("policy=sequential").values == ("sequential",)


@pytest.mark.parametrize("text", ["latency_s", "=1,2", "latency_s=", "latency_s=1,1"])
def test_what_names_no_values_is_refused(text: str) -> None:
    with pytest.raises(ScenarioError, match="cannot vary"):
        Variation.parse(text)


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 60_000, '{"a":' * 60_000, "NaN"])
def test_values_that_no_json_has_are_refused(value: str) -> None:
    with pytest.raises(ScenarioError, match="cannot read"):
        Variation.parse(f"scenario.seed={value},1")


def test_every_combination_is_a_variant() -> None:
    found = combine_variations(
        [Variation("a", (1, 2)), Variation("b", ("x", "y", "z"))]
    )
    assert len(found) == 6
    assert found[1] == {"a": 1, "b": "y"}
    assert combine_variations([]) == ({},)
    with pytest.raises(ScenarioError, match="varied twice"):
        combine_variations([Variation("a", (1,)), Variation("a", (2,))])


def test_a_variant_changes_its_keys_and_nothing_else(cliff: Scenario) -> None:
    other = apply_variation(
        cliff, {"stalls.count_per_robot": 3, "stalls.duration_s.1": 7}
    )
    assert other.execution.stalls.count_per_robot == 3
    assert other.execution.stalls.duration_s == (1.0, 7.0)
    assert other.cell == cliff.cell
    assert apply_variation(cliff, {}) is cliff


def test_skills_without_a_section_can_be_varied(cliff: Scenario) -> None:
    other = apply_variation(
        cliff, {"skills.pick.scale": 2, "failures.pick.probability": 0.1}
    )
    own = other.execution.skills["pick"]
    assert not isinstance(own, ReferenceDuration)
    assert own.scale == 2
    assert other.execution.failures["pick"].probability == 0.1


@pytest.mark.parametrize("file", ["assembly/magazine", "multi_arm/tray"])
def test_skills_that_the_scenario_says_nothing_of_can_fail(file: str) -> None:
    case = load(CLIFF.parents[1] / f"{file}.yaml").varied(
        {"failures.handover.probability": 0.1}
    )
    assert case.sections.execution.failures["handover"].probability == 0.1


UNIFORM = {"kind": "uniform", "low_s": 1.0, "high_s": 2.0}


@pytest.mark.parametrize(
    "key",
    [
        "skills.pick",
        "jitter",
        "stalls.duration",
        "failures.pick.retry",
        "machines.mill.stalls.duration",
    ],
)
def test_a_distribution_is_given_as_a_whole_or_key_by_key(
    cliff: Scenario, key: str
) -> None:
    """In whatever order, and whatever kind there was before."""
    beside = {"stalls.rate_per_h": 1, "failures.pick.probability": 0.1}
    (whole,) = Variation.parse(key + "={kind: uniform, low_s: 1, high_s: 2}").values
    wanted = apply_variation(cliff, {**beside, key: whole}).execution
    assert repr(Uniform(low_s=1.0, high_s=2.0)) in repr(wanted)
    for names in (("kind", "low_s", "high_s"), ("high_s", "low_s", "kind")):
        single = {f"{key}.{name}": UNIFORM[name] for name in names}
        assert apply_variation(cliff, {**single, **beside}).execution == wanted


def test_a_distribution_within_one_is_given_key_by_key(cliff: Scenario) -> None:
    keys = {"kind": "shifted", "offset_s": 3.0}
    keys |= {f"model.{name}": value for name, value in UNIFORM.items()}
    whole = {"kind": "shifted", "offset_s": 3.0, "model": UNIFORM}
    found = apply_variation(
        cliff, {f"skills.pick.{name}": v for name, v in keys.items()}
    )
    assert found == apply_variation(cliff, {"skills.pick": whole})


def test_what_says_a_kind_again_keeps_the_rest(cliff: Scenario) -> None:
    slow = apply_variation(cliff, {"skills.pick.scale": 2.0})
    again = apply_variation(slow, {"skills.pick.kind": "packaged"})
    own = again.execution.skills["pick"]
    assert not isinstance(own, ReferenceDuration)
    assert own.scale == 2.0
    other = apply_variation(
        slow, {f"skills.pick.{name}": v for name, v in UNIFORM.items()}
    )
    assert other.execution.skills["pick"] == Uniform(low_s=1.0, high_s=2.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("jitter={kind: fixed, value_s: 1", "cannot read '{kind: .*not valid YAML"),
        ("jitter={kind: fixed, kind: pert}", "'kind' is already given"),
    ],
)
def test_brackets_that_cannot_be_read_are_refused(text: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        Variation.parse(text)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    rows(r"""
key                            | value    | says
latencys                       | 1        | execution has no 'latencys' .*latency_s
stalls.count                   | 1        | execution.stalls has no 'count' .*count_per_robot
latency_s.mean                 | 1        | execution.latency_s is a plain value
stalls.duration_s.7            | 1        | no entry '7' \(valid: 0, 1\)
latency_s                      | -1       | execution.latency_s: must be at least 0, not -1
skills.pik                     | {kind: fixed, value_s: 1} | pik
cell.robots.middle.tool        | slim     | no entry 'middle' .*left, right
cell.robot.left.tool           | slim     | cell has no 'robot' .*robots
cell.robots.left.base.xyz_m.0  | 1.0e+9   | cell.robots\[0\].base.xyz_m\[0\]: must be at most
cell.robots.left.base.xyz_m.3  | 0        | xyz_m has no entry '3' .*0, 1, 2
planning.speed_model           | quick    | unknown value 'quick'.*joint
robots                         | two      | no number of robots: 'two'
cell.robots.left.parked.at_m.0 | 1        | leaves cell.robots.left.parked out
cell.robots.left.home_deg.0    | 1        | leaves cell.robots.left.home_deg out; give it as a whole
cel.robots.left.tool           | slim     | execution has no 'cel' .*valid: speed, .*cell, .*robots
"""),
)
def test_paths_and_values_that_do_not_fit_are_refused_by_place(
    cliff: Scenario, key: str, value: str, message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        apply_variation(cliff, {key: yaml.safe_load(value)})


def test_limits_of_the_tools_speed_reach_the_robots_that_they_are_given_for(
    cliff: Scenario,
) -> None:
    """They are kept to in plans within limits only."""
    first, second = (f"cell.robots.{robot.name}.limits" for robot in cliff.cell.robots)
    limits = {
        f"{first}.tool_speed_m_s": 0.5,
        f"{second}.loaded_tool_speed_m_s": 0.25,
    }
    limited = apply_variation(cliff, {"planning.speed_model": "limits", **limits})
    found = [robot.limits for robot in build_workcell(limited, CLIFF.parent).robots]
    speeds = [(own.tool_speed, own.loaded_tool_speed) for own in found if own]
    assert speeds == [(0.5, np.inf), (np.inf, 0.25)]
    with pytest.raises(ScenarioError, match=r"speed_model: limits.*'l1'"):
        load(CLIFF).varied(limits)


def test_keys_of_a_section_that_is_left_out_make_it(cliff: Scenario) -> None:
    found = apply_variation(
        cliff, {"breakdowns.mtbf_s": 60.0, "breakdowns.mttr_s": 5.0}
    )
    assert found.execution.breakdowns is not None
    assert found.execution.breakdowns.mttr_s == 5.0
    with pytest.raises(ScenarioError, match="give mttr_s"):
        apply_variation(cliff, {"breakdowns.mtbf_s": 60.0})
    with pytest.raises(ScenarioError, match="'mtbx'"):
        apply_variation(cliff, {"breakdowns.mtbx": 60.0})


def test_keys_of_the_whole_scenario_are_paths_by_position_or_name(
    cliff: Scenario,
) -> None:
    other = apply_variation(
        cliff,
        {
            "cell.robots.right.base.xyz_m.1": 0.25,
            "cell.robots.0.tool": "slim",
            "planning.speed_rad_s": 2,
            "seed": 7,
        },
    )
    before, after = cliff.cell.robots, other.cell.robots
    assert after[1].base.xyz_m == (
        before[1].base.xyz_m[0],
        0.25,
        before[1].base.xyz_m[2],
    )
    assert after[0].tool == "slim"
    assert after[0].base == before[0].base
    assert other.planning.speed_rad_s == 2.0
    assert other.seed == 7
    assert other.assembly == cliff.assembly


def test_values_of_numpy_are_plain_ones(cliff: Scenario) -> None:
    found = Variation.of("seed", np.arange(2))
    assert found == Variation("seed", (0, 1))
    assert all(type(value) is int for value in found.values)
    moved = apply_variation(
        cliff, {"cell.robots.0.base.xyz_m": np.array([1.0, 2.0, 3.0])}
    )
    assert moved.cell.robots[0].base.xyz_m == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [("l1", "a list of values"), (3, "a list of values"), ([], "no values")],
)
def test_what_is_no_list_of_values_is_refused(values: Any, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        Variation.of("planning.speed_model", values)


def test_names_with_dots_are_names(cliff: Scenario) -> None:
    named = apply_variation(cliff, {"cell.robots.0.name": "arm.1"})
    other = apply_variation(named, {"cell.robots.arm.1.base.xyz_m.0": 0.5})
    assert other.cell.robots[0].base.xyz_m[0] == 0.5


def test_the_number_of_robots_is_varied_with_and_without_a_team(
    cliff: Scenario,
) -> None:
    alone = {"robots": 1, "cell.robots.right.base.xyz_m.0": 0.9}
    assert [robot.name for robot in apply_variation(cliff, alone).cell.robots] == [
        "left"
    ]
    wall = load_scenario(CLIFF.parents[1] / "construction/wall.yaml")
    for key in ("robots", "cell.team.count"):
        team = apply_variation(wall, {key: 4}).cell.robots
        assert [robot.name for robot in team] == [f"robot{k}" for k in range(1, 5)]
    with pytest.raises(ScenarioError, match="the cell has 2 robots and no team"):
        apply_variation(cliff, {"robots": 3})


@pytest.mark.parametrize(
    ("key", "value", "message"),
    rows(r"""
key                 | value                                        | says
failures.place-down | {probability: 0.1, loses: 1, wrong: 0.2}     | no wrong part is found in place-down
failures.pick       | {probability: 0.1, beside: 0.5, wrong: 0.7}  | with wrong it is more than all
outages             | [{robot: middle, at_s: 3}]                   | robot 'middle' .valid: left, right
skills.pick         | {kind: empirical, csv: no.csv}               | no\.csv
"""),
)
def test_what_no_file_may_say_of_the_execution_is_refused(
    key: str, value: str, message: str
) -> None:
    with pytest.raises(ScenarioError, match=f"^cannot vary {key}: .*{message}"):
        load("tray").varied({key: yaml.safe_load(value)})
