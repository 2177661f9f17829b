"""What is said of an exploration: who is best, what it is worth, what matters, and the scenario of a design."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.twin.explorations.bench import Bench, exploration_of, sliders_explored
from tests.twin.explorations.sliders import EXPLORE, LEFT, RIGHT, slider_file
from tests.twin.program import invoke
from twin.explorations.crew import DesignTask
from twin.explorations.design_scenario import scenario_text
from twin.explorations.dimensions import Dimension
from twin.explorations.finals import Finals
from twin.explorations.folder import write_sample
from twin.explorations.influence import importances, pareto_front
from twin.explorations.journal import SEARCH, TriedDesign
from twin.explorations.page_words import describe_changes, verdict
from twin.explorations.report import write_report
from twin.explorations.rungs import Evaluation, RungClimb
from twin.explorations.section import GoalSection, VarySection
from twin.explorations.summary import summary_of
from twin.host.progress import report_nothing
from twin.reading.scenario_file import load_scenario, parse_scenario
from twin.scenario.shipped import shipped_scenarios
from twin.scenario.variations import apply_variation
from twin.studies.replications.statistics import mean_interval

ALONE = (VarySection(key=LEFT, low=-0.6, high=0.6),)
FEW = {"replications": 20, "most_replications": 80}
JITTER = "execution: {jitter: {kind: uniform, low_s: 0, high_s: 0.02}}\n"


def tried(number: int, goals: tuple[float, ...], **values: object) -> TriedDesign:
    kind = "done" if goals else "refused"
    found = Evaluation(kind, "replications", goals=goals)  # type: ignore[arg-type]
    return TriedDesign(number, SEARCH, values, 0, found)


def test_what_matters_is_what_the_goal_is_made_of() -> None:
    rng = np.random.default_rng(1)
    spread = rng.uniform(size=(60, 3))
    rows = [
        tried(k, (4.0 * a + b,), a=float(a), b=float(b), c=float(c), d=k % 2)
        for k, (a, b, c) in enumerate(spread)
    ]
    dimensions = [Dimension(name, 0.0, 0.0, 1.0) for name in "abc"]
    dimensions.append(Dimension("d", 0, choices=(0, 1)))
    found = {item.key: item.share for item in importances(rows, dimensions)}
    assert list(found) == sorted(found, key=lambda k: -found[k].estimate)
    assert found["a"].low > 0.6
    assert found["a"].low > found["b"].high
    assert max(found["c"].estimate, found["d"].estimate) < 0.15
    assert all(s.low <= s.estimate <= s.high for s in found.values())
    assert importances(rows[:5], dimensions) == ()


def test_compromises_are_those_that_nothing_beats() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        points = rng.integers(0, 8, (15, 2)).astype(float)
        rows = [tried(k, tuple(p)) for k, p in enumerate(points.tolist())]
        found = {row.evaluation.goals for row in pareto_front(rows)}
        slow = {
            tuple(p)
            for p in points.tolist()
            if not any(
                all(o <= v for o, v in zip(other, p, strict=True)) and other != p
                for other in points.tolist()
            )
        }
        assert found == slow


@pytest.mark.parametrize(
    "goal", ["mean_s", "p90_s", "2 * mean_s + robots", "makespan_s"]
)
def test_changes_are_worth_what_is_known(tmp_path: Path, goal: str) -> None:
    """The left slider decides: it is 0.4 m away, and 0.1 m in the best design that is tried."""
    setting, exploration = sliders_explored(
        tmp_path,
        JITTER + EXPLORE,
        goals=(GoalSection(minimise=goal),),
        replications=30,
        most_replications=60,
    )
    base, half, best = {LEFT: -0.3, RIGHT: 0.3}, {LEFT: 0.0, RIGHT: 0.3}, None
    for number, values in enumerate((base, {LEFT: 0.0, RIGHT: 0.1}, half)):
        changed = {k: v for k, v in values.items() if v != base[k]}
        evaluation = RungClimb(setting, changed).evaluate()
        exploration.keep(TriedDesign(number, SEARCH, values, 0, evaluation))
    finals = Finals(exploration, setting, report_nothing)
    race = finals.race()
    best = race[0]
    assert best.row.design == 1
    assert all(item.apart for item in race[1:]), "0.4 s of difference, 0.02 s of noise"
    bench = Bench(setting)
    worths = {item.key: item for item in finals.change_values(best, bench)}
    replanned = 2 * (setting.section.plans - 1)
    assert len(bench.evaluated) == 1 + replanned, "of two without a change one is known"
    # 0.4 s, and 8 nodes fewer of which each takes 0.01 s longer on average.
    gain = {"makespan_s": 0.4, "2 * mean_s + robots": 0.96}.get(goal, 0.48)
    for item in worths.values():
        assert item.gain is not None
        assert item.gain.low - 1e-9 <= item.gain.estimate <= item.gain.high + 1e-9
        assert item.gain.estimate == pytest.approx(gain, abs=0.03)
    found = summary_of("sliders", exploration, race, list(worths.values()), 0)
    assert found.decided
    words = list(describe_changes(found))
    assert words[0].startswith("the best design (left.base x by +300 mm;")
    # What was replicated is not replicated again.
    again = Finals(exploration, setting, report_nothing).race()
    assert [f.goals for f in again] == [f.goals for f in race]


def test_the_luck_of_a_plan_is_told_from_what_a_design_is_worth(tmp_path: Path) -> None:
    setting, exploration = sliders_explored(tmp_path, plans=4)
    luck = {0: (0.0, -0.3), 1: (0.1, 0.0), 2: (-0.1, 0.2), 3: (0.0, 0.0)}

    def lucky(found: Evaluation, change_s: float) -> Evaluation:
        length = found.results["makespan_s"] + change_s
        return replace(found, results={"makespan_s": length}, goals=(length,))

    def evaluated(task: DesignTask) -> Evaluation:
        climb = RungClimb(setting, task.variant, planner_seed=task.planner_seed)
        assert task.planner_seed is not None
        moved = bool(task.variant)
        return lucky(climb.evaluate(), luck[task.planner_seed][moved])

    rows = []
    for number, left in enumerate((-0.3, 0.0)):
        values = {LEFT: left, RIGHT: 0.3}
        found = RungClimb(setting, {LEFT: left} if number else {}).evaluate()
        row = TriedDesign(number, SEARCH, values, 0, lucky(found, luck[0][number]))
        exploration.keep(row)
        rows.append(row)
    bench = Bench(setting, 2, evaluated)
    finals = Finals(exploration, setting, report_nothing)
    base, best = rows
    gain = finals.gain_by_plans(base, best, 0, bench)
    every = [one - other for one, other in luck.values()]
    shared = rows[0].evaluation.goals[0] - rows[1].evaluation.goals[0] - every[0]
    assert gain is not None
    told = stats.ttest_1samp(np.array(every) + shared, 0.0).confidence_interval(0.95)
    assert gain.estimate == pytest.approx(np.mean(every) + shared)
    # Student's interval, and farther on the side of the longer tail.
    own = mean_interval(np.array(every) + shared)
    assert (gain.low, gain.high) == pytest.approx((own.low, own.high))
    assert gain.low <= told.low + 1e-9
    assert told.high - 1e-9 <= gain.high
    assert len(bench.evaluated) == 6
    again = Finals(exploration_of(setting, tmp_path / "out"), setting, report_nothing)
    assert again.gain_by_plans(base, best, 0, Bench(setting)) == gain, (
        "all is in the journal"
    )


def test_designs_that_do_not_differ_are_not_told_apart(tmp_path: Path) -> None:
    """Only the slider that ends last counts: where it stands alike, designs are equally good."""
    goals = (GoalSection(minimise="mean_s"),)
    setting, exploration = sliders_explored(
        tmp_path, JITTER + EXPLORE, vary=ALONE, goals=goals, **FEW
    )
    for number, left in enumerate((0.3, 0.31, 0.29)):
        evaluation = RungClimb(setting, {LEFT: left}).evaluate()
        exploration.keep(TriedDesign(number, SEARCH, {LEFT: left}, 0, evaluation))
    race = Finals(exploration, setting, report_nothing).race()
    assert not any(item.apart for item in race)
    assert {len(item.makespans_s) for item in race} == {80}


def test_compromises_are_told_from_those_that_draws_flattered(tmp_path: Path) -> None:
    """The left slider takes |0.1 - x| / 0.5 s and is to stand far to the left: beyond 0.1 both are worse."""
    goals = (
        GoalSection(minimise="mean_s"),
        GoalSection(maximise=f"-key('{LEFT}')"),
    )
    setting, exploration = sliders_explored(
        tmp_path, JITTER + EXPLORE, -0.1, vary=ALONE, goals=goals, **FEW
    )
    for number, left in enumerate((-0.3, -0.1, 0.0, 0.3, 0.301)):
        found = RungClimb(setting, {LEFT: left}).evaluate()
        if left > 0.1:  # by draws that were kind to it
            found = replace(found, goals=(0.1 - left / 10.0, found.goals[1]))
        exploration.keep(TriedDesign(number, SEARCH, {LEFT: left}, 0, found))
    race = Finals(exploration, setting, report_nothing).race()
    assert {item.row.design for item in race} == {0, 1, 2, 3, 4}
    assert {item.row.design for item in race if item.apart} == {3, 4}
    assert not any(item.unsure for item in race)
    for item in race:  # 2 cm take 0.04 s, and 0.008 s of jitter on average
        left = item.row.values[LEFT]
        told = pytest.approx((2.4 * abs(0.1 - left), left), abs=0.02)
        assert item.goals == told
    summary = summary_of("sliders", exploration, race, (), 0)
    assert [item.design for item in summary.compromises] == [2, 1, 0]
    assert summary.decided
    (words,) = verdict(summary)
    assert words.startswith("of the compromises of the search #4, #5 are none: others")
    # Where draws hide what differs, it is said to be open.
    rng = np.random.default_rng(0)
    for row in exploration.journal.searched[:2]:
        write_sample(exploration.samples_of(row), rng.normal(1.0, 0.1, 80))
    race = Finals(exploration, setting, report_nothing).race()
    assert {item.row.design for item in race if item.unsure} == {0, 1}
    summary = summary_of("sliders", exploration, race, (), 0)
    assert not summary.decided
    assert "are compromises is not known after 80" in list(verdict(summary))[1]


def test_several_goals_constraints_and_prices(tmp_path: Path) -> None:
    more = """\
explore:
  vary:
    - {key: cell.robots.left.base.xyz_m.0, low: -0.6, high: 0.6, mirrors: [cell.robots.right.base.xyz_m.0]}
  goals: [{minimise: makespan_s}, {maximise: "key('cell.robots.right.base.xyz_m.0') + price / 1000"}]
  constraints: [makespan_s <= 1.25, robots >= 2]
  prices: {slider.urdf: 500}
  designs: 24
"""
    setting, exploration = sliders_explored(tmp_path, more)
    exploration.search(Bench(setting), 24, None)
    for row in exploration.journal.rows:
        left = row.values[LEFT]
        right = 0.3 - (left + 0.3)
        time_s = max(abs(0.1 - left), abs(-0.1 - right)) / 0.5
        assert row.done == (time_s <= 1.25)
        if row.done:
            assert row.evaluation.goals == pytest.approx((time_s, -right - 1.0))
        else:
            assert row.evaluation.rung == "constraints"
            assert "not makespan_s <= 1.25 (makespan_s = " in row.evaluation.reason
            assert 0.0 < row.evaluation.violation < 1.0
    found = summary_of("sliders", exploration, (), (), 0)
    # Left of its place it trades one goal for the other; right of it both are worse.
    assert len(found.compromises) > 1
    assert all(item.values[LEFT] <= 0.1 + 0.05 for item in found.compromises)
    write_report(
        found, setting, exploration.dimensions, tmp_path / "out", report_nothing
    )
    page = (tmp_path / "out" / "report.html").read_text()
    assert "the best compromises" in page
    assert "not makespan_s &lt;= 1.25" in page
    assert (tmp_path / "out" / "front.png").exists()


def test_scenarios_are_written_as_they_are() -> None:
    for name, path in shipped_scenarios().items():
        wanted = load_scenario(path).changed(explore=None)
        found, _ = parse_scenario(path, scenario_text(wanted))
        assert found == wanted, name


def test_a_design_becomes_a_scenario_of_its_own(tmp_path: Path) -> None:
    file, out = slider_file(tmp_path / "cell"), tmp_path / "out"
    options = ("--designs", 5, "--workers", 1, "--seed", 3, "--out", out)
    invoke("explore", file, *options, code=0)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["base"]["design"] == 0
    for row in summary["best"][:2]:
        own = tmp_path / f"own-{row['rank']}"
        source = f"{out}#{row['rank']}" if row["rank"] > 1 else out
        invoke("init", own, "--from", source, code=0)
        found = load_scenario(own / "scenario.yaml")
        wanted = apply_variation(load_scenario(file), {"seed": 3, **row["values"]})
        assert found == wanted.changed(explore=None, name=own.name)
        assert (own / "slider.urdf").exists()
    told = invoke("init", tmp_path / "none", "--from", f"{out}#99", code=2).output
    assert "has no design #99: there are 1 to" in " ".join(told.split())
    told = invoke("init", tmp_path / "none", "--from", f"{tmp_path}#1", code=2).output
    assert "no summary of an exploration: there is none" in " ".join(told.split())
    told = invoke("init", tmp_path / "none", "--from", f"{out}#x", code=2).output
    assert "such as explored#3" in " ".join(told.split())
