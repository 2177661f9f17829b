"""What cannot be explored is refused with its place in the file and the valid choices."""

from pathlib import Path

import pytest

from tests.twin.explorations.sliders import slider_file
from tests.twin.program import invoke
from twin.explorations.dimensions import dimensions_of, vary_section
from twin.explorations.expressions import Expression, ExpressionError, Inequality
from twin.explorations.section import ExploreSection
from twin.trial.loaded_scenario import load

GOOD = "{key: cell.robots.left.base.xyz_m.0, low: -0.6, high: 0.6}"


@pytest.mark.parametrize(
    ("section", "line", "words"),
    [
        ("vary: [{key: cell.robots.left.base.xyz_m.0}]", 15, "low and high, or values"),
        ("vary: [{key: a, low: 1}]", 15, "give both of low and high"),
        ("vary: [{key: a, low: 2, high: 1}]", 15, "low 2 is not below high 1"),
        ("vary: [{key: a, values: [1]}]", 15, "values are two or more"),
        ("vary: [{key: cell.robots.lefd.model, values: [a, b]}]", 15, "no entry 'lefd' (valid: 0, 1, left, right)"),
        ("vary: [{key: cell.robots.left.modl, values: [a, b]}]", 15, "has no 'modl' (valid: name, model"),
        ("vary: [{key: cell.robots.left.model, low: 0, high: 1}]", 15, "is no number, but 'slider.urdf'"),
        ("vary: [{key: cell.robots.left.model, order: true}]", 15, "no list of two or more entries"),
        ("vary: [{key: seed, low: 0, high: 9}]", 15, "all designs see the same draws"),
        ("vary: [{key: name, values: [a, b]}]", 15, "name: it is no design"),
        ("vary: [{key: planning.speed_rad_s, low: 0, high: 1}]", 15, "must be at least 0.01, not 0"),
        ("vary: [{key: robots, low: 0, high: 2}]", 15, "no number of robots: 0"),
        ("vary: [{key: cell.robots.left.model, values: [slider.urdf, slidr]}]", 15, "unknown robot model 'slidr'"),
        (f"vary: [{GOOD}]\n  goals: [{{minimise: price}}]", 15, "give prices"),
        (f"vary: [{GOOD}]\n  prices: {{slidr.urdf: 1}}", 16, "unknown model or tool 'slidr.urdf'; did you mean 'slider.urdf'"),
        (f"vary: [{GOOD}]\n  goals: [{{minimise: \"key('cell.robots.left.model')\"}}]", 16, "is no number, but 'slider.urdf'"),
        (f"vary: [{GOOD}, {GOOD}]", 15, "is varied twice"),
        (f"vary: [{GOOD}, {{key: cell.robots.left.base.xyz_m, values: [[0, 0, 0], [1, 0, 0]]}}]", 15, "is varied twice"),
        (f"vary: [{GOOD}]\n  goals: [{{minimise: men_s}}]", 16, "no result 'men_s' (valid: makespan_s, mean_s"),
        (f"vary: [{GOOD}]\n  goals: [{{minimise: \"key('cell.x')\"}}]", 16, "cell has no 'x'"),
        (f"vary: [{GOOD}]\n  constraints: [mean_s]", 16, "a comparison such as late <= 0.05"),
        (f"vary: [{GOOD}]\n  constraints: ['late <= 0.1']", 15, "give it"),
        (f"vary: [{GOOD}]\n  sampler: grid", 16, "valid: tpe, cma-es"),
    ],
)  # fmt: skip
def test_malformed_sections_are_named_with_their_line(
    tmp_path: Path, section: str, line: int, words: str
) -> None:
    file = slider_file(tmp_path, f"explore:\n  {section}\n")
    told = invoke("explore", file, "--out", tmp_path / "out", code=2).output
    assert f"sliders.yaml:{line}:" in told
    assert words in " ".join(told.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("cell.robots.left.base.xyz_m.0", "write key=low..high"),
        ("cell.robots.left.base.xyz_m.0=2..1", "low 2 is not below high 1"),
        ("cell.robots.left.base.xyz_m.0=1", "values are two or more"),
        ("cell.robots.left.base.xyz_m.0=a..b", "low and high of a range are numbers"),
        ("cell.robots.left.base.xyz_m.0=0..inf", "low and high of a range are numbers"),
        ("cell.robots.lefd.base.xyz_m.0=1..2", "no entry 'lefd'"),
    ],
)
def test_malformed_options_are_named(tmp_path: Path, text: str, words: str) -> None:
    file = slider_file(tmp_path, "")
    assert words in invoke("explore", file, "--vary", text, code=2).output


def test_what_other_keys_may_set_right_is_tried(tmp_path: Path) -> None:
    """HOME of an arm alone does not fit this model, and with the arm it does."""
    case = load(slider_file(tmp_path, ""))
    homes = vary_section("cell.robots.left.home_rad_or_m=[0.1],[0,0,0,0,0,0]")
    models = vary_section("cell.robots.left.model=slider.urdf,ur5e")
    section = ExploreSection(vary=(homes, models))
    found = dimensions_of(case.sections, section, case.document, case.folder)
    assert [one.key for one in found] == [homes.key, models.key]


def test_options_say_ranges_values_and_orders() -> None:
    found = vary_section("execution.skills.pick.scale=0.5..2")
    assert (found.key, found.low, found.high) == ("skills.pick.scale", 0.5, 2.0)
    whole = vary_section("robots=1..3")
    assert isinstance(whole.low, int)
    assert vary_section("a.b=-1e-3..-.5e-3").high == -0.0005
    assert vary_section("a.b=panda,ur5e").values == ("panda", "ur5e")
    assert vary_section("assembly.steps=order").order


NAMES = ("mean_s", "price")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2 * mean_s + price / 4", 21.0),
        ("-mean_s ** 2", -100.0),
        ("max(mean_s, price, 5)", 10.0),
        ("sqrt(price) + key('a.0') - floor(1.7)", 4.0),
    ],
)
def test_arithmetic_has_its_value(text: str, value: float) -> None:
    given = {"mean_s": 10.0, "price": 4.0}
    found = Expression(text, NAMES).check().value(given, {"a.0": 3}.__getitem__)
    assert found == value


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "mean_s.real",
        "[mean_s][0]",
        "(lambda: 1)()",
        "'a' * 9",
        "mean_s if price else 1",
        "True",
        "max(*[1, 2])",
        "open('x')",
        "key(mean_s)",
        "mean_s +",
        "1 < 2",
        "(" * 400,
    ],
)
def test_what_is_no_arithmetic_is_refused(text: str) -> None:
    with pytest.raises(ExpressionError):
        Expression(text, NAMES).check()


NO_KEYS: dict[str, float] = {}


def test_what_has_no_value_says_so() -> None:
    for text in ("1 / 0", "10.0 ** 999", "(-1) ** 0.5", "late"):
        with pytest.raises(ExpressionError):
            Expression(text, ("late",)).value({}, NO_KEYS.__getitem__)


def test_inequalities_tell_how_far_they_are_missed() -> None:
    given = {"mean_s": 12.0, "price": 4.0}
    for text, excess in (
        ("mean_s <= 10", 0.2),
        ("mean_s >= 24", 0.5),
        ("price < 9", 0),
    ):
        found = Inequality(text, NAMES).check().excess(given, NO_KEYS.__getitem__)
        assert found == pytest.approx(excess)
    for text in ("1 < mean_s < 3", "mean_s == 3", "mean_s"):
        with pytest.raises(ExpressionError):
            Inequality(text, NAMES).check()
