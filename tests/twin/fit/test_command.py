"""``twin fit``: from a CSV file to lines that a scenario takes, with clear errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import stats
from typer.testing import CliRunner, Result

from planning.tasks.task import SKILLS
from planning.transforms import Array
from twin.cli import app
from twin.durations import Fixed, Measured
from twin.scenario.file import load_scenario
from twin.trial.simulation import skill_durations

SMALL = """\
version: 1
name: small
cell:
  robots:
    - {name: left, model: gp4, base: {xyz_m: [0, 0, 0.9246]}}
    - {name: right, model: gp4, base: {xyz_m: [1, 0, 0.9246]}}
assembly:
  kind: lego
  plate: {pose: {xyz_m: [0.4, 0, 1.1145]}}
  stock:
    - {name: b1, brick: 2x4, at: [4, 24, 1]}
  steps:
    - {brick: 2x4, at: [24, 24, 1]}
"""

LEFT = stats.gamma(30, 0, 0.2).rvs(40, random_state=1).round(3)
RIGHT = stats.gamma(30, 0, 0.3).rvs(40, random_state=2).round(3)
TWO_HEAPS = np.r_[np.linspace(3, 3.1, 30), np.linspace(9, 9.2, 30)].round(3)


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["fit", *(str(a) for a in arguments)])


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
    done = invoke(csv, "--by", "skill", "--out", out, "--resamples", 99)
    assert done.exit_code == 0, done.output
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
    assert isinstance(heaps, Measured)
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
    done = invoke(csv, *arguments, "--resamples", 99)
    assert done.exit_code == 0, done.output
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
    assert invoke(csv, "--out", out, "--resamples", 19).exit_code == 0
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
    assert invoke("pick.csv", "--resamples", 19).exit_code == 0
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
        "skill,duration_s\n" + "pik,1\n" * 10,
        ("--by", "skill"),
        f"skill 'pik' is no skill (valid: {', '.join(SKILLS)})",
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
    "not a skill": ("duration_s\n1\n", ("--skill", "dance"), "no skill 'dance'"),
}


@pytest.mark.parametrize(("text", "options", "says"), BAD.values(), ids=BAD.keys())
def test_bad_input_ends_with_a_message_and_leaves_nothing(
    tmp_path: Path, text: str | None, options: tuple[str, ...], says: str
) -> None:
    csv = tmp_path / "times.csv"
    if text is not None:
        csv.write_text(text)
    done = invoke(csv, "--out", tmp_path / "out", *options)
    assert done.exit_code == 2
    assert says in done.stderr
    assert "Traceback" not in done.output
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    csv = plain(tmp_path / "pick.csv", LEFT)
    done = invoke(csv, "--out", csv / "below")
    assert done.exit_code == 2
    assert "cannot be written to" in done.stderr
