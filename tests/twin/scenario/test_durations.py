"""Durations in a scenario file: what each section means, and where a wrong one is reported."""

import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from planning.errors import ScenarioError
from planning.tasks.task import TaskKind
from tests.planted import planted
from tests.twin.scenarios.cells import ONE_BRICK
from tests.twin.twin_toys import random_tpg
from tests.twin.written import Change, loaded, refusal
from twin.durations.bounded import Fixed, Pert, Triangular, Uniform
from twin.durations.composed import AnyDuration, Retries, Shifted, SkillOverride
from twin.durations.lifetimes import Exponential, Gamma, Weibull
from twin.durations.measured import Packaged, packaged_timings
from twin.durations.model import DurationModel, PackagedSkill
from twin.durations.normal import Lognormal, TruncatedNormal
from twin.scenario.sections.scenario import Scenario, resolve_scenario
from twin.trial.simulation import skill_durations
from twin.uncertainty.skill_durations import SkillDurations

SECTION: TypeAdapter[DurationModel] = TypeAdapter(AnyDuration)

LAST = "    pick: {kind: fixed, value_s: 2}\n"
SECOND = "    - {name: b2, brick: 1x2, at: [4, 30, 1]}\n"
SMALL = ONE_BRICK.replace("  steps:\n", f"{SECOND}  steps:\n")
SMALL += f"execution:\n  skills:\n{LAST}"


def section(content: dict[str, object]) -> DurationModel:
    return SECTION.validate_json(json.dumps(content))


def problem(folder: Path, text: str, *changes: Change) -> tuple[str, str]:
    """Return the text at the place of the only problem, and what is said about it."""
    found = refusal(folder, text, *changes)
    (one,) = found.problems
    return found.lines[one.mark.line - 1][one.mark.column - 1 :], one.message


MEANT = [
    (model, yaml.safe_load(content))
    for model, content in (
        (Fixed, "{kind: fixed, value_s: 2}"),
        (Uniform, "{kind: uniform, low_s: 2, high_s: 3}"),
        (Triangular, "{kind: triangular, low_s: 2, mode_s: 3, high_s: 5}"),
        (Pert, "{kind: pert, low_s: 2, mode_s: 3, high_s: 5}"),
        (TruncatedNormal, "{kind: normal, mean_s: 5, sd_s: 1}"),
        (TruncatedNormal, "{kind: normal, mean_s: 5, sd_s: 1, low_s: 4, high_s: 7}"),
        (Lognormal, "{kind: lognormal, median_s: 5, p95_s: 7}"),
        (Lognormal, "{kind: lognormal, mean_s: 5, cv: 0.2}"),
        (Exponential, "{kind: exponential, mean_s: 5}"),
        (Gamma, "{kind: gamma, shape: 5, scale_s: 2}"),
        (Gamma, "{kind: gamma, mean_s: 5, cv: 0.2}"),
        (Weibull, "{kind: weibull, shape: 5, scale_s: 2}"),
        (
            Shifted,
            "{kind: shifted, offset_s: 3, model: {kind: gamma, shape: 5, scale_s: 2, scale: 2}}",
        ),
        (
            Retries,
            "{kind: retries, attempt: {kind: fixed, value_s: 5}, probability: 0.2}",
        ),
        (
            Retries,
            "{kind: retries, attempt: {kind: fixed, value_s: 5}, probability: 0.2,"
            " retries: 1, retry: {kind: fixed, value_s: 3}, scale: 1.5}",
        ),
    )
]
"""Models, and the sections that say them."""


@pytest.mark.parametrize(("model", "content"), MEANT, ids=str)
def test_each_section_is_its_model(
    model: type[DurationModel], content: dict[str, object]
) -> None:
    found = section(content)
    assert type(found) is model
    assert found.model_dump(exclude_unset=True) == content
    assert getattr(found, "retries", 2) == content.get("retries", 2)


def test_every_kind_is_tried() -> None:
    kinds = set(SECTION.json_schema()["discriminator"]["mapping"])
    assert kinds == {c["kind"] for _, c in MEANT} | {"empirical", "packaged"}


def test_measured_and_packaged_times(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("s\n2\n1\n")
    own = section({"kind": "empirical", "csv": "t.csv", "column": "s", "scale": 3})
    assert own.located(tmp_path).ppf(np.array([0.1, 0.9])).tolist() == [3, 6]
    packaged = section({"kind": "packaged", "skill": "pick"}).located(tmp_path)
    assert packaged == packaged_timings()["pick"]


WRONG = planted(r"""
mistake                                   | entry                                        | at             | says
negative                                  | {kind: fixed, value_s: -2}                   | -2}            | must be at least 0
mode outside                              | {kind: pert, low_s: 2, mode_s: 7, high_s: 5} | {kind: pert    | low_s <= mode_s <= high_s expected
no width                                  | {kind: triangular, low_s: 2, mode_s: 2, high_s: 2} | {kind: tri     | low_s below high_s
half a pair                               | {kind: lognormal, median_s: 2}               | {kind: log     | give median_s and p95_s, or mean_s and cv
two pairs                                 | {kind: gamma, shape: 2, scale_s: 2, mean_s: 2, cv: 1} | {kind: gamma   | give shape and scale_s, or mean_s and cv
no scale                                  | {kind: fixed, value_s: 2, scale: 0}          | 0}             | must be at least 0.001, not 0
unit                                      | {kind: weibull, shape: 2, scale_ms: 2}       | scale_ms       | this quantity is in seconds, as 'scale_s'
kind                                      | {kind: erlang}                               | erlang         | unknown kind 'erlang'
cut off                                   | {kind: normal, mean_s: 2, sd_s: 1, low_s: 9} | {kind: normal  | less than 1 % of mean 2.0
shifted below 0                           | {kind: shifted, offset_s: -3, model: {kind: uniform, low_s: 2, high_s: 4}} | {kind: shifted | makes durations negative: the shortest of the model is 2 s
inner kind                                | {kind: shifted, offset_s: 3, model: {kind: unifrom, low_s: 2, high_s: 4}} | unifrom, low_s | did you mean 'uniform'?
inner value                               | {kind: retries, probability: 0.1, attempt: {kind: fixed, value_s: -4}} | -4}}           | must be at least 0, not -4
inner file                                | {kind: retries, probability: 0.1, attempt: {kind: empirical, csv: no.csv}} | no.csv}}       | no such file
inner sum                                 | {kind: retries, probability: 0.1, attempt: {kind: shifted, offset_s: -3, model: {kind: fixed, value_s: 1}}} | {kind: shifted | makes durations negative
certain failure                           | {kind: retries, probability: 1, attempt: {kind: fixed, value_s: 4}} | 1, attempt     | must be less than 1, not 1
unknown key beside one called as the kind | {kind: retries, retries: 2, retre: {kind: fixed, value_s: 4}, probability: 0.1, attempt: {kind: fixed, value_s: 4}} | retre          | unknown key 'retre'; did you mean 'retry'?
unknown skill                             | {kind: packaged, skill: pik}                 | pik}           | did you mean 'pick'?
""")


@pytest.mark.parametrize(("entry", "at", "says"), WRONG.values(), ids=WRONG.keys())
def test_a_wrong_duration_is_reported_at_its_place(
    tmp_path: Path, entry: str, at: str, says: str
) -> None:
    found, message = problem(tmp_path, SMALL, (LAST, f"    pick: {entry}\n"))
    assert found.startswith(at)
    assert says in message


def test_durations_of_disturbances_are_checked_too(tmp_path: Path) -> None:
    text = SMALL + "  jitter: {kind: empirical, csv: no.csv}\n"
    assert problem(tmp_path, text) == (
        "no.csv}",
        f"no such file: {tmp_path / 'no.csv'}",
    )


OVERRIDES = """\
  skill_overrides:
    - {skill: pick, robot: left, duration: {kind: fixed, value_s: 3}}
    - {skill: pick, object: 1x2, duration: {kind: fixed, value_s: 4}}
    - {skill: pick, robot: right, object: 1x2, duration: {kind: fixed, value_s: 5}}
"""

WRONG_OVERRIDES = planted(r"""
mistake | old                      | new                     | at                                           | says
robot   | robot: left              | robot: lefd             | lefd                                         | did you mean 'left'?
object  | object: 1x2, d           | object: 2x2, d          | 2x2                                          | unknown type of object
nobody  | "robot: left, "          | ""                      | {skill: pick, duration                       | name a robot, an object or both
twice   | robot: left              | object: 1x2             | {skill: pick, object: 1x2, duration: {kind: fixed, value_s: 4 | the same exception as entry 1
skill   | skill: pick, robot: left | skill: pik, robot: left | pik                                          | 'pick'
""")


@pytest.mark.parametrize(
    ("old", "new", "at", "says"), WRONG_OVERRIDES.values(), ids=WRONG_OVERRIDES.keys()
)
def test_a_wrong_exception_is_reported_at_its_place(
    tmp_path: Path, old: str, new: str, at: str, says: str
) -> None:
    found, message = problem(tmp_path, SMALL + OVERRIDES.replace(old, new, 1))
    assert found.startswith(at)
    assert says in message


def test_the_strongest_exception_wins(tmp_path: Path) -> None:
    durations = skill_durations(loaded(tmp_path, SMALL + OVERRIDES))
    cases = {
        ("left", "2x4"): 3.0,
        ("left", "1x2"): 3.0,
        ("left", None): 3.0,
        ("right", "2x4"): 2.0,
        ("right", "1x2"): 5.0,
        ("third", "1x2"): 4.0,
        ("third", None): 2.0,
    }
    for (robot, kind), seconds in cases.items():
        assert durations.model_of("pick", robot, kind) == Fixed(value_s=seconds)
    assert isinstance(durations.model_of("handover", "left", "1x2"), Packaged)


def test_exceptions_reach_the_tasks_of_a_plan() -> None:
    tpg = random_tpg(3, tasks=40)
    durations = SkillDurations(
        {skill: Fixed(value_s=1.0) for skill in TaskKind.SKILLS},
        tuple(
            SkillOverride(skill=s, duration=Fixed(value_s=2.0), robot="robot_1")
            for s in TaskKind.SKILLS
        ),
    )
    draws = durations.bind(tpg)
    totals = draws.totals(seed=0, replications=[0])
    robots = [tpg.tasks[index].robot for index in draws.tasks]
    assert set(robots) == {"robot_0", "robot_1"}
    assert totals[:, 0].tolist() == [
        2_000_000_000 if robot == "robot_1" else 1_000_000_000 for robot in robots
    ]


def test_what_a_file_leaves_out_is_packaged_and_can_be_scaled(tmp_path: Path) -> None:
    scenario = loaded(tmp_path, SMALL)
    assert (
        set(scenario.execution.skills)
        == set(TaskKind.SKILLS)
        == set(get_args(PackagedSkill))
    )
    content = resolve_scenario(scenario)
    assert content["execution"]["skills"]["handover"] == {
        "kind": "packaged",
        "skill": "handover",
        "scale": 1.0,
    }
    content["execution"]["skills"]["handover"]["scale"] = 1.5
    slower = Scenario.model_validate_json(json.dumps(content))
    assert slower.execution.skill_models()["handover"].mean == pytest.approx(
        1.5 * packaged_timings()["handover"].mean
    )
    assert slower.execution.skill_models()["pick"] == Fixed(value_s=2.0)


# --- whatever is written -----------------------------------------------------------------

NUMBER = st.one_of(
    st.floats(-2, 20), st.sampled_from([0.0, -1.0, 1.0, 2.0, 3.0, 1e6, 1e-9])
)


def with_numbers(content: dict[str, object]) -> st.SearchStrategy[dict[str, object]]:
    """Put any numbers where the section has numbers, in rising order as often as not."""
    keys = [k for k, v in content.items() if isinstance(v, int | float)]
    lists = st.lists(NUMBER, min_size=len(keys), max_size=len(keys))
    return st.one_of(lists, lists.map(sorted)).map(
        lambda numbers: {**content, **dict(zip(keys, numbers, strict=True))}
    )


@settings(deadline=None, max_examples=200)
@given(st.sampled_from([content for _, content in MEANT]).flatmap(with_numbers))
@example({"kind": "normal", "mean_s": -1.0, "sd_s": 1.0})
@example({"kind": "normal", "mean_s": 1.0, "sd_s": 1e-190})
@example({"kind": "lognormal", "median_s": 5e-324, "p95_s": 1.0})
@example({"kind": "gamma", "mean_s": 1.0, "cv": 0.001})
@example({"kind": "lognormal", "median_s": 1.0, "p95_s": 1e6})
def test_a_section_is_refused_or_has_durations_from_0(
    content: dict[str, object],
) -> None:
    try:
        model = section(content).located(Path())
    except (ValidationError, ScenarioError):
        return
    quantiles = model.ppf(np.array([1e-9, 0.5, 1 - 1e-9]))
    assert np.all(np.isfinite(quantiles))
    assert 0 <= quantiles[0] <= quantiles[1] <= quantiles[2]
    assert 0 <= model.minimum <= model.mean * (1 + 1e-9)
    assert np.isfinite(model.mean)


def test_the_lines_of_the_guide_are_a_scenarios(tmp_path: Path) -> None:
    page = Path(__file__).parents[3] / "docs" / "guides" / "durations.md"
    blocks = page.read_text(encoding="utf-8").split("```yaml\n")[1:]
    (lines,) = (b.split("```")[0] for b in blocks if "skill_overrides" in b)
    text = SMALL[: SMALL.index("execution:")] + lines
    (tmp_path / "timings").mkdir()
    (tmp_path / "timings" / "pick.csv").write_text("duration_s\n5\n6\n")
    durations = skill_durations(loaded(tmp_path, text), tmp_path)
    assert durations.model_of("pick", "left", "1x2") == Triangular(
        low_s=5.0, mode_s=6.0, high_s=9.0
    )
    assert durations.model_of("pick", "right", "1x2") == Pert(
        low_s=6.0, mode_s=7.0, high_s=12.0
    )
    assert isinstance(durations.models["handover"], Retries)
