"""``twin fit``: from a CSV file to lines that a scenario takes, with clear errors."""

import json
from datetime import datetime, timedelta
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy import stats
from typer.testing import Result

from planning.tasks.task import TaskKind
from planning.transforms import Array
from tests.twin import program
from tests.twin.scenarios.cells import ONE_BRICK as SMALL
from twin.durations.bounded import Fixed
from twin.durations.measured import MeasuredTimes
from twin.planning.build_workcell import build_workcell
from twin.planning.pipeline import motion_settings
from twin.reading.scenario_file import load_scenario
from twin.trial.simulation import skill_durations

LEFT = stats.gamma(30, 0, 0.2).rvs(40, random_state=1).round(3)
RIGHT = stats.gamma(30, 0, 0.3).rvs(40, random_state=2).round(3)
TWO_HEAPS = np.r_[np.linspace(3, 3.1, 30), np.linspace(9, 9.2, 30)].round(3)
invoke = partial(program.invoke, "fit")


def write(path: Path, *groups: tuple[str, Array]) -> Path:
    """Write groups of durations, with their labels in front: "skill,robot"."""
    lines = ["skill,robot,object,duration_s"]
    for labels, values in groups:
        cells = (labels + ",,").split(",")[:3]
        lines += [",".join([*cells, str(value)]) for value in values]
    path.write_text("\n".join(lines) + "\n")
    return path


def plain(path: Path, values: Array, header: str = "duration_s") -> Path:
    path.write_text("\n".join([header, *(str(v) for v in values)]) + "\n")
    return path


def test_the_snippet_loads_back_as_what_was_fitted(tmp_path: Path) -> None:
    csv = write(
        tmp_path / "times.csv",
        ("pick", LEFT),
        ("handover", RIGHT),
        ("place-up", TWO_HEAPS),
        ("place-down", np.full(12, 7.5)),
    )
    out = tmp_path / "out"
    done = invoke(csv, "--by", "skill", "--out", out, "--resamples", 99, code=0)
    text = (out / "durations.yaml").read_text()
    assert text in done.stdout
    (out / "small.yaml").write_text(SMALL + text)
    durations = skill_durations(load_scenario(out / "small.yaml"), out)
    u = np.linspace(0.01, 0.99, 50)
    pick = durations.models["pick"]
    # The distribution that was fitted is the one that measured times come from.
    assert stats.kstest(LEFT, lambda t: np.interp(t, pick.ppf(u), u)).statistic < 0.15
    assert durations.models["handover"].mean == pytest.approx(RIGHT.mean(), rel=0.01)
    assert durations.models["place-down"] == Fixed(value_s=7.5)
    heaps = durations.models["place-up"]
    assert isinstance(heaps, MeasuredTimes)
    assert heaps.values_s.tolist() == sorted(TWO_HEAPS)


def test_figures_and_pictures_are_written(tmp_path: Path) -> None:
    csv = write(tmp_path / "times.csv", ("pick", LEFT), ("handover", RIGHT))
    out = tmp_path / "out"
    done = invoke(csv, "--by", "skill", "--out", out, "--resamples", 19, "--json")
    figures = json.loads(done.stdout)
    assert figures == json.loads((out / "fit.json").read_text())
    assert [entry["skill"] for entry in figures] == ["pick", "handover"]
    first = figures[0]["candidates"][0]
    assert set(first) == {
        *("distribution", "section", "aicc", "anderson_darling", "p_value", "rejected")
    }
    assert figures[0]["section"] == first["section"]
    for name in ("pick", "handover"):
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_groups_of_robots_become_exceptions(tmp_path: Path) -> None:
    csv = write(
        tmp_path / "times.csv", ("pick,left,2x4", LEFT), ("pick,right,2x4", RIGHT)
    )
    out = tmp_path / "out"
    arguments = ("--by", "robot", "--by", "object", "--skill", "pick", "--out", out)
    invoke(csv, *arguments, "--resamples", 99, code=0)
    (out / "small.yaml").write_text(SMALL + (out / "durations.yaml").read_text())
    durations = skill_durations(load_scenario(out / "small.yaml"), out)
    for robot, values in (("left", LEFT), ("right", RIGHT)):
        model = durations.model_of("pick", robot, "2x4")
        assert model is not None
        assert model.mean == pytest.approx(values.mean(), rel=0.02)


def test_the_name_of_the_file_may_say_the_skill(tmp_path: Path) -> None:
    out = tmp_path / "out"
    csv = plain(tmp_path / "pick.csv", LEFT, "seconds")
    done = invoke(csv, "--column", "seconds", "--out", out, "--resamples", 19, "-q")
    assert (done.exit_code, done.output) == (0, "")
    found = yaml.safe_load((out / "durations.yaml").read_text())
    assert list(found["execution"]["skills"]) == ["pick"]


def test_durations_of_no_skill_become_a_section(tmp_path: Path) -> None:
    out = tmp_path / "out"
    csv = plain(tmp_path / "stalls.csv", LEFT)
    invoke(csv, "--out", out, "--resamples", 19, code=0)
    found = yaml.safe_load((out / "durations.yaml").read_text())
    assert list(found) == ["duration"]
    text = SMALL + f"execution: {{jitter: {json.dumps(found['duration'])}}}\n"
    (tmp_path / "small.yaml").write_text(text)
    assert load_scenario(tmp_path / "small.yaml").execution.jitter is not None


def test_groups_that_were_not_asked_for_are_mentioned(tmp_path: Path) -> None:
    csv = write(tmp_path / "times.csv", ("pick", LEFT), ("handover", RIGHT))
    done = invoke(csv, "--out", tmp_path / "out", "--resamples", 19)
    assert "column 'skill' has 2 values" in done.stderr
    assert "--by skill" in done.stderr


def test_results_go_below_logs_unless_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plain(tmp_path / "pick.csv", LEFT)
    invoke("pick.csv", "--resamples", 19, code=0)
    (folder,) = (tmp_path / "logs").iterdir()
    assert folder.name.startswith("fit-pick-")
    assert {path.name for path in folder.iterdir()} >= {"durations.yaml", "fit.json"}


BAD = {
    "missing": (None, (), "cannot read durations"),
    "empty": ("", (), "no column 'duration_s'"),
    "no rows": ("duration_s\n", (), "column 'duration_s' has no rows"),
    "other column": ("t\n1\n", (), "no column 'duration_s' (valid: t)"),
    "no label": ("duration_s\n1\n", ("--by", "skill"), "no column 'skill'"),
    "not a number": ("duration_s\n1\nsoon\n", (), ":3: duration_s is 'soon'"),
    "negative": ("duration_s\n1\n-2\n", (), ":3: duration_s is '-2'"),
    "infinite": ("duration_s\n1\ninf\n", (), ":3: duration_s is 'inf'"),
    "too few": ("duration_s\n" + "1\n" * 9, (), "9 durations; at least 10"),
    "unknown skill": (
        "skill,duration_s\n" + "screw it,1\n" * 10,
        ("--by", "skill"),
        f"skill 'screw it' is no skill (valid: {', '.join(TaskKind.SKILLS)})",
    ),
    "no skill": (
        "skill,duration_s\n" + ",1\n" * 10,
        ("--by", "skill"),
        "skill '' is no skill",
    ),
    "too few of a group": (
        "skill,duration_s\n" + "pick,1\n" * 10 + "handover,1\n",
        ("--by", "skill"),
        "skill 'handover' has 1 durations",
    ),
    "which skill": (
        "robot,duration_s\n" + "left,1\n" * 10,
        ("--by", "robot"),
        "of which skill are these?",
    ),
    "no robot": (
        "robot,duration_s\n" + ",1\n" * 10,
        ("--by", "robot", "--skill", "pick"),
        "a row has no robot",
    ),
    "not a group": (
        "colour,duration_s\nred,1\n",
        ("--by", "colour"),
        "cannot group by 'colour' (valid: skill, robot, object)",
    ),
    "not a skill": ("duration_s\n1\n", ("--skill", "transit"), "'transit' cannot be"),
    "comma": ("duration_s\n7,5\n", (), ":2: more cells than columns"),
    "backwards": ("start,end\n5,4\n", (), ":2: end is before start"),
    "clocks": (
        "start,end\n2026-03-31T12:00:00,2026-03-31T12:00:01Z\n",
        (),
        ":2: start and end are not of one clock",
    ),
    "no time": (
        "start,end\n1,soon\n",
        (),
        "end is 'soon', neither a number nor a time",
    ),
    "one column": ("a,b\n1,2\n", ("--start", "a"), "give --start and --end"),
    "thousands": ("x;duration_s\n1;1.234,5\n", (), "duration_s is '1.234,5'"),
    "nowhere": ("duration_s\n1\n", ("-o", "x.yaml"), "--apply SCENARIO"),
}


@pytest.mark.parametrize(("text", "options", "says"), BAD.values(), ids=BAD.keys())
def test_bad_input_ends_with_a_message_and_leaves_nothing(
    tmp_path: Path, text: str | None, options: tuple[str, ...], says: str
) -> None:
    csv = tmp_path / "times.csv"
    if text is not None:
        csv.write_text(text)
    done = invoke(csv, "--out", tmp_path / "out", *options, code=2)
    assert says in done.stderr
    assert "Traceback" not in done.output
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    csv = plain(tmp_path / "pick.csv", LEFT)
    done = invoke(csv, "--out", csv / "below", code=2)
    assert "cannot be written to" in done.stderr


def german(path: Path, values: Array) -> Path:
    rows = [f"pick;{str(value).replace('.', ',')}" for value in values]
    path.write_text("skill;duration_s\n" + "\n".join(rows) + "\n")
    return path


def fitted(csv: Path, *options: object) -> Any:
    done = invoke(csv, "--resamples", 19, "--json", "--skill", "pick", *options, code=0)
    return json.loads(done.stdout)


def test_semicolons_decimal_commas_and_time_stamps_say_the_same(tmp_path: Path) -> None:
    expected = fitted(plain(tmp_path / "a.csv", LEFT), "--out", tmp_path / "1")
    assert fitted(german(tmp_path / "b.csv", LEFT), "--out", tmp_path / "2") == expected
    noon = datetime.fromisoformat("2026-03-31T12:00:00+02:00")
    rows = [f"{noon}\t{noon + timedelta(seconds=value)}" for value in LEFT]
    stamps = tmp_path / "c.csv"
    stamps.write_text("start\tend\n" + "\n".join(rows) + "\n")
    assert fitted(stamps, "--out", tmp_path / "3") == expected
    epoch = Decimal("1763838534.123")
    rows = [f"{epoch},{epoch + Decimal(str(value))},x" for value in LEFT]
    stamps.write_text("from,to,note\n" + "\n".join(rows) + "\n")
    options = ("--start", "from", "--end", "to", "--out", tmp_path / "4")
    assert fitted(stamps, *options) == expected


def applied(source: Path, csv: Path, *options: object) -> Result:
    """Apply what is fitted to a scenario beside it."""
    out = ("--out", source.parent / "out", "--resamples", 19)
    return invoke(csv, *out, "--apply", source, *options)


COMMENTED = SMALL.replace("cell:", "# of the cell\ncell:", 1) + (
    "# how it is executed\nexecution:\n  queue_depth: 3\n"
    "  skills:\n    handover: {kind: fixed, value_s: 4}\n    pick: {kind: fixed, value_s: 5}\n"
    "  skill_overrides:\n"
    "    - {skill: pick, robot: left, duration: {kind: fixed, value_s: 6}}\n"
    "    - {skill: pick, robot: right, duration: {kind: fixed, value_s: 7}}\n"
    "# how it is planned\nplanning: {attempts: 7}\n"
)


def test_apply_writes_a_scenario_with_what_was_fitted(tmp_path: Path) -> None:
    source = tmp_path / "cell.yaml"
    source.write_text(COMMENTED)
    csv = write(
        tmp_path / "times.csv",
        ("pick,left", LEFT),
        ("place-up,left", TWO_HEAPS),
    )
    options = ("--by", "skill", "--by", "robot", "--out", tmp_path / "out")
    arguments = (csv, *options, "--resamples", 99, "--apply", source)
    invoke(*arguments, code=0)
    target = tmp_path / "cell-fitted.yaml"
    text = target.read_text()
    for comment in ("# of the cell", "# how it is executed", "# how it is planned"):
        assert comment in text
    scenario, before = load_scenario(target), load_scenario(source)
    assert scenario.execution.queue_depth == 3
    assert scenario.planning == before.planning
    durations = skill_durations(scenario, tmp_path)
    assert durations.models == skill_durations(before, tmp_path).models
    left = durations.model_of("pick", "left", None)
    assert left is not None
    assert left.mean == pytest.approx(LEFT.mean(), rel=0.02)
    assert durations.model_of("pick", "right", None) == Fixed(value_s=7)
    heaps = durations.model_of("place-up", "left", None)
    assert isinstance(heaps, MeasuredTimes)
    assert heaps.values_s.tolist() == sorted(TWO_HEAPS)
    # What the planner is told is what was fitted.
    cell = build_workcell(scenario, tmp_path)
    settings = motion_settings(scenario, cell, tmp_path)
    assert settings.skill_exceptions["pick", "left", None] == left.mean
    # Applied to what it wrote it changes nothing, and the comment is there once.
    invoke(*arguments[:-1], target, "-o", target, code=0)
    assert target.read_text() == text.replace("cell-", "cell-fitted-", 0)


def test_exceptions_that_beat_what_was_fitted_are_mentioned(tmp_path: Path) -> None:
    source = tmp_path / "cell.yaml"
    source.write_text(COMMENTED)
    target = tmp_path / "new.yaml"
    done = applied(source, plain(tmp_path / "pick.csv", LEFT), "-o", target)
    assert done.exit_code == 0, done.output
    assert "exception for pick of left stays" in done.stderr
    durations = skill_durations(load_scenario(target), tmp_path)
    assert durations.models["pick"].mean == pytest.approx(LEFT.mean(), rel=0.05)
    assert durations.models["handover"] == Fixed(value_s=4)


def test_a_scenario_in_braces_and_one_without_execution(tmp_path: Path) -> None:
    csv = plain(tmp_path / "pick.csv", LEFT)
    data = yaml.safe_load(SMALL)
    for text in (SMALL, SMALL.rstrip("\n"), json.dumps(data)):
        source = tmp_path / "cell.yaml"
        source.write_text(text)
        done = applied(source, csv)
        assert done.exit_code == 0, done.output
        again = yaml.safe_load((tmp_path / "cell-fitted.yaml").read_text())
        assert list(again.pop("execution")["skills"]) == ["pick"]
        assert again == data


@pytest.mark.parametrize(
    ("labels", "says"),
    [
        ("pick,middle", "unknown robot 'middle'"),
        ("", "of which skill are these"),
    ],
)
def test_what_cannot_be_applied_leaves_no_scenario(
    tmp_path: Path, labels: str, says: str
) -> None:
    source = tmp_path / "cell.yaml"
    source.write_text(COMMENTED)
    csv = write(tmp_path / "times.csv", (labels, TWO_HEAPS))
    by = ("--by", "skill", "--by", "robot") if labels else ()
    done = applied(source, csv, *by)
    assert done.exit_code == 2
    assert says in done.stderr
    names = {path.name for path in tmp_path.iterdir()} - {"out"}
    assert names == {"cell.yaml", "times.csv"}


def test_paths_that_would_name_other_files_are_refused(tmp_path: Path) -> None:
    source = tmp_path / "cell.yaml"
    plain(tmp_path / "own.csv", RIGHT)
    source.write_text(SMALL + "execution: {jitter: {kind: empirical, csv: own.csv}}\n")
    csv = plain(tmp_path / "pick.csv", LEFT)
    (tmp_path / "away").mkdir()
    done = applied(source, csv, "-o", tmp_path / "away" / "new.yaml")
    assert done.exit_code == 2
    assert "names files relative to its folder" in done.stderr
    assert not any((tmp_path / "away").iterdir())
