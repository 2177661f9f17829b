"""Designs are searched for: what is found is what is known, and the same after any interruption."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.errors import OutputError
from tests.twin.explorations.bench import (
    Bench,
    exploration_of,
    setting_of,
    sliders_explored,
    told,
)
from tests.twin.explorations.sliders import EXPLORE, LEFT, RIGHT, slider_file
from twin.explorations.journal import JOURNAL, SEARCH, Journal, TriedDesign
from twin.explorations.rungs import (
    Evaluation,
    ExplorationSetting,
    RungClimb,
    refused_evaluation,
)
from twin.explorations.section import GoalSection, SamplerName, VarySection
from twin.scenario.variations import apply_variation
from twin.trial.loaded_scenario import load


def oracle_s(left: float, right: float) -> float:
    """Each slider goes from its base to its place at 0.5 m/s, both at once."""
    return max(abs(0.1 - left), abs(-0.1 - right)) / 0.5


def test_designs_take_as_long_as_is_known(tmp_path: Path) -> None:
    setting = setting_of(slider_file(tmp_path))
    for left, right in ((-0.3, 0.3), (0.1, 0.1), (0.5, -0.2), (-0.35, 0.55)):
        found = RungClimb(setting, {LEFT: left, RIGHT: right}).evaluate()
        assert found.outcome == "done", found.reason
        assert found.goals[0] == pytest.approx(oracle_s(left, right), abs=1e-6)


def cheap(task: Any) -> Evaluation:
    """The oracle in place of the planner; bases behind the table are refused."""
    left, right = task.variant.get(LEFT, -0.3), task.variant.get(RIGHT, 0.3)
    if left > 0.5:
        return refused_evaluation(
            "check", f"left stands in the wall at {left:.3f}", left - 0.5
        )
    value = oracle_s(left, right)
    return Evaluation("done", "replications", goals=(value,), results={"m": value})


@pytest.mark.parametrize("sampler", ["tpe", "random"])
def test_designs_that_can_be_counted_up_are_each_tried_once(
    tmp_path: Path, sampler: SamplerName
) -> None:
    values = (-0.3, -0.1, 0.1)
    vary = tuple(VarySection(key=key, values=values) for key in (LEFT, RIGHT))
    setting, exploration = sliders_explored(
        tmp_path, vary=vary, sampler=sampler, designs=9
    )
    exploration.search(Bench(setting, evaluate=cheap), 9, None)
    tried = [
        (row.values[LEFT], row.values[RIGHT]) for row in exploration.journal.searched
    ]
    # The scenario as it is, whose right base is none of these, is one more.
    assert tried[0] == (-0.3, 0.3)
    assert len(set(tried)) == 9


@pytest.mark.parametrize("sampler", ["tpe", "cma-es", "random"])
def test_samplers_come_close_to_the_known_best(
    tmp_path: Path, sampler: SamplerName
) -> None:
    setting, exploration = sliders_explored(tmp_path, sampler=sampler, designs=60)
    exploration.search(Bench(setting, evaluate=cheap), 60, None)
    best = exploration.best(1)[0].evaluation.goals[0]
    assert best < {"tpe": 0.15, "cma-es": 0.15, "random": 0.35}[sampler]
    reasons = [r for r in exploration.journal.rows if r.evaluation.outcome == "refused"]
    assert all("in the wall" in row.evaluation.reason for row in reasons)


def test_planned_designs_come_close_to_the_known_best(tmp_path: Path) -> None:
    setting, exploration = sliders_explored(tmp_path)
    exploration.search(Bench(setting), 25, None)
    rows = exploration.journal.rows
    assert rows[0].design == 0
    assert rows[0].values == {LEFT: -0.3, RIGHT: 0.3}
    for row in rows:
        known = oracle_s(row.values[LEFT], row.values[RIGHT])
        if row.done:
            assert row.evaluation.goals[0] == pytest.approx(known, abs=1e-6)
        else:  # what is left behind could not have been the best
            assert known > exploration.best(1)[0].evaluation.goals[0]
    assert exploration.best(1)[0].evaluation.goals[0] < 0.35


def test_shortcuts_may_gain_more_than_they_ever_did(tmp_path: Path) -> None:
    """They left 0.6 to 0.7 of 10 s, usually 0.65: 0.55 is as far away as that, and the best takes 6 s."""
    goals = (GoalSection(minimise="mean_s"),)
    _, exploration = sliders_explored(tmp_path, goals=goals)
    for number, left in enumerate((0.6, 0.62, 0.64, 0.65, 0.65, 0.66, 0.68, 0.7)):
        assert exploration.longest_turns_s() == np.inf, "little is known"
        found = Evaluation("done", "replications", goals=(10.0 * left,), turns_s=10.0)
        values = {LEFT: 0.01 * number, RIGHT: 0.3}
        exploration.keep(TriedDesign(number, SEARCH, values, 0, found))
    assert exploration.longest_turns_s() == pytest.approx(6.0 / 0.55)


@pytest.mark.nightly
def test_no_repeated_product_is_left_behind(tmp_path: Path) -> None:
    """The plan in turns of one of many products does not tell how long all of them take."""
    scenario = apply_variation(load("kitting").sections, {"assembly.products.count": 2})
    section = setting_of(slider_file(tmp_path)).section
    found = RungClimb(
        ExplorationSetting(scenario, tmp_path, section), {}, 1.0
    ).evaluate()
    assert found.outcome == "done"
    assert np.isnan(found.turns_s)


class StoppedError(Exception):
    """The program is killed here."""


@pytest.mark.parametrize("sampler", ["tpe", "cma-es", "nsga-ii", "random"])
@pytest.mark.parametrize("width", [1, 3])
def test_an_interrupted_search_goes_on_as_if_nothing_had_been(
    tmp_path: Path, sampler: SamplerName, width: int
) -> None:
    setting = setting_of(slider_file(tmp_path), sampler=sampler, designs=40)
    whole = exploration_of(setting, tmp_path / "whole")
    whole.search(Bench(setting, width, cheap), 40, None)
    done: Counter[int] = Counter()
    stops = iter([0, 1, 9, 10, 23, 38])

    def mortal(task: Any) -> Evaluation:
        if len(journal()) == stop:
            raise StoppedError
        done[task.number] += 1
        return cheap(task)

    def journal() -> list[dict[str, Any]]:
        there = (tmp_path / "parts" / JOURNAL).exists()
        return told(tmp_path / "parts") if there else []

    for stop in stops:  # noqa: B007 - mortal looks at it
        part = exploration_of(setting, tmp_path / "parts")
        with pytest.raises(StoppedError):
            part.search(Bench(setting, width, mortal), 40, None)
        with (tmp_path / "parts" / JOURNAL).open("a") as torn:
            torn.write('{"design": 7, "purp')  # what a kill in a write leaves
    stop = -1
    part = exploration_of(setting, tmp_path / "parts")
    part.search(Bench(setting, width, mortal), 40, None)
    assert set(done.values()) == {1}, "no design is evaluated twice"
    found = told(tmp_path / "parts")
    assert sorted(row["design"] for row in found) == list(range(40))
    if width == 1:
        assert found == told(tmp_path / "whole")


def test_a_design_that_was_tried_is_not_evaluated_again(tmp_path: Path) -> None:
    more = """\
explore:
  vary: [{key: cell.robots.left.base.xyz_m.0, values: [-0.3, 0.1]}]
  goals: [{minimise: makespan_s}]
  sampler: random
"""
    setting, exploration = sliders_explored(tmp_path, more)
    bench = Bench(setting, 2, cheap)
    exploration.search(bench, 12, None)
    assert len(exploration.journal.rows) == 12
    assert len(bench.evaluated) == 2
    own = [row for row in exploration.journal.rows if row.same_as is None]
    assert len(own) == 2
    assert exploration.best(5) == sorted(own, key=lambda r: r.design)


def test_a_damaged_journal_names_its_line(tmp_path: Path) -> None:
    setting, exploration = sliders_explored(tmp_path)
    exploration.search(Bench(setting, 1, cheap), 3, None)
    path = tmp_path / "out" / JOURNAL
    text = path.read_text().splitlines()
    path.write_text("\n".join([text[0], text[1][:40], text[2]]) + "\n")
    with pytest.raises(Exception, match=r"journal.jsonl, line 2: damaged"):
        Journal(tmp_path / "out")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("purpose", "../../outside"),  # it is part of the name of a file
        ("design", 10**9),
        ("design", -1),
        ("design", True),
        ("outcome", "fine"),
        ("goals", []),
        ("violation", 10**400),
        ("makespans_s", ["1"]),
        ("turns_s", -(10**400)),
        ("same_as", "0"),
        ("values", {LEFT: 1e9, RIGHT: 0.0}),
        ("values", {LEFT: 0.0}),
    ],
)
def test_a_journal_says_nothing_that_was_not_tried(
    tmp_path: Path, key: str, value: object
) -> None:
    _, exploration = sliders_explored(tmp_path)
    found = Evaluation("done", "replications", goals=(1.0,))
    folder, values = exploration.folder, {LEFT: 0.0, RIGHT: 0.0}
    row = TriedDesign(0, SEARCH, values, 0, found).content()
    (folder / JOURNAL).write_text(json.dumps(row) + "\n")
    assert len(sliders_explored(tmp_path)[1].journal.rows) == 1
    (folder / JOURNAL).write_text(json.dumps(row | {key: value}) + "\n")
    with pytest.raises(OutputError, match=r"journal\.jsonl, line 1: "):
        sliders_explored(tmp_path)


def test_orders_of_steps_are_designs(tmp_path: Path) -> None:
    more = EXPLORE.replace(
        "- {key: cell.robots.left.base.xyz_m.0, low: -0.6, high: 0.6}",
        "- {key: assembly.moves, order: true}",
    )
    setting, exploration = sliders_explored(tmp_path, more)
    exploration.search(Bench(setting), 8, None)
    orders = {
        tuple(move["robot"] for move in row.values["assembly.moves"])
        for row in exploration.journal.rows
    }
    assert orders == {("left", "right"), ("right", "left")}
    assert all(row.done for row in exploration.journal.rows)
