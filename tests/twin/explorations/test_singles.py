"""Single changes of a cell that works: what gains is known, and nothing is tried twice."""

import json
from pathlib import Path

import pytest

from planning.errors import RequestError
from tests.twin.explorations.bench import Bench, setting_of
from tests.twin.explorations.sliders import slider_file
from tests.twin.program import invoke
from twin.explorations.exploration import Exploration
from twin.explorations.finals import Finals
from twin.explorations.journal import JOURNAL
from twin.explorations.rungs import ExplorationSetting
from twin.explorations.single_changes import (
    candidates,
    change_dimensions,
    judge_changes,
    try_changes,
)
from twin.host.progress import report_nothing

MORE = """\
explore:
  goals: [{minimise: makespan_s}]
  efforts: {base: 2, home: 0.5}
"""


def exploration_of(setting: ExplorationSetting, folder: Path) -> Exploration:
    folder.mkdir(exist_ok=True)
    changes = candidates(setting.scenario, setting.folder)
    dimensions = change_dimensions(setting.scenario, changes)
    return Exploration(folder, setting.section, dimensions, 0, report_nothing)


def test_changes_gain_what_is_known_and_are_ranked_by_effort(tmp_path: Path) -> None:
    """Both sliders go 0.4 m: only one that goes less far, alone, gains nothing; so the right one is nearer here."""
    setting = setting_of(slider_file(tmp_path, MORE, right=0.2))
    changes = candidates(setting.scenario, setting.folder)
    kinds = {item.kind for item in changes}
    assert {"base", "home", "order"} <= kinds
    exploration = exploration_of(setting, tmp_path / "out")
    bench = Bench(setting)
    found = try_changes(exploration, bench, changes)
    assert len(found) == len(changes)
    finals = Finals(exploration, setting, report_nothing)
    best = judge_changes(exploration, finals, found, 10, report_nothing)
    told = {item.words: item for item in best}
    # The left base, or its HOME, 50 mm nearer to where it goes, at 0.5 m/s.
    base = told["left.base x by +50 mm"]
    assert base.gain.estimate == pytest.approx(0.1, abs=1e-6)
    assert base.rate == pytest.approx(0.05, abs=1e-6)
    home = told["HOME of left: joint 1 by +50 mm"]
    assert home.gain.estimate == pytest.approx(0.1, abs=1e-6)
    assert home.rate == pytest.approx(0.2, abs=1e-6)
    assert best[0] is home
    assert not any("right" in item.words for item in best)
    tried = len(bench.evaluated)
    again = exploration_of(setting, tmp_path / "out")
    try_changes(again, bench, changes)
    assert len(bench.evaluated) == tried
    assert len(again.journal.rows) == len(exploration.journal.rows) == tried


def test_changes_that_were_finished_out_of_turn_keep_their_numbers(
    tmp_path: Path,
) -> None:
    """What was killed had finished the first and the third of three."""
    setting, out = setting_of(slider_file(tmp_path, MORE)), tmp_path / "out"
    changes, bench = candidates(setting.scenario, setting.folder), Bench(setting)
    try_changes(exploration_of(setting, out), bench, changes[:3])
    log = out / JOURNAL
    lines = log.read_text().splitlines(keepends=True)
    single = [line for line in lines if json.loads(line)["purpose"] == "single"]
    log.write_text("".join(line for line in lines if line != single[1]))
    again = exploration_of(setting, out)
    try_changes(again, bench, changes[:3])
    numbers = [row.design for row in again.journal.rows if row.purpose == "single"]
    assert sorted(numbers) == [0, 2, 3]


def test_a_cell_that_does_not_work_has_no_changes(tmp_path: Path) -> None:
    setting = setting_of(slider_file(tmp_path, MORE, right=3.0))
    exploration = exploration_of(setting, tmp_path / "out")
    changes = candidates(setting.scenario, setting.folder)
    with pytest.raises(RequestError, match=r"does not work.*reach: right does not"):
        try_changes(exploration, Bench(setting), changes)


def test_options_that_contradict_single_changes_are_refused(tmp_path: Path) -> None:
    file = slider_file(tmp_path, MORE)
    vary = ("--vary", "cell.robots.left.base.xyz_m.0=0..1")
    told = invoke("explore", file, "--single-changes", 3, *vary, code=2).output
    assert "leave out --vary" in " ".join(told.split())
