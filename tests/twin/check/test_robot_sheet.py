"""``twin robots MODEL``: what is in a description, in tables that are never cut, and a picture."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image
from typer.testing import CliRunner

from planning.cell.robot_model import limits_of
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.descriptions.urdf_file import GivenLimits
from planning.robots.overview import flange_doubt, overview
from planning.robots.registry import ROBOTS, robot_model
from planning.transforms import identity
from tests.planning.robots.descriptions.test_mounting import link_poses
from tests.planning.robots.descriptions.vendors import GRIPPER, ur5e
from twin.check.finding import Subject
from twin.check.picture import cell_figure
from twin.check.tools import finger_gap
from twin.check.views import MOST, close_ups
from twin.cli import app
from twin.scenario.manifest import load_scenario
from twin.scenario.shipped import scenario_path

SCENARIO = """version: 1
name: pair
cell:
  tools:
    hand: {description: hand.urdf, joints: {squeeze: 0.02}, opening_m: 0.09}
  robots:
    - {name: left, model: ur5e, tool: hand, base: {xyz_m: [0, 0, 0]}}
    - {name: right, model: ur5e, tool: hand, base: {xyz_m: [2, 0, 0]}}
    - {name: bare, model: ur5e, base: {xyz_m: [4, 0, 0]}, limits: {velocity: 1.25, payload_kg: 5}}
assembly:
  kind: goals
  moves: [{robot: left, to_rad_or_m: [0, -1, 1, 0, 0, 0]}]
"""


def robots(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["robots", *arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture
def hand(tmp_path: Path) -> Path:
    path = tmp_path / "hand.urdf"
    path.write_text(GRIPPER)
    return path


def test_every_registered_robot_has_a_sheet() -> None:
    for name in ROBOTS:
        text = robots(name)
        model = robot_model(name)
        assert f"flange: link '{model.flange_link}'" in text
        for joint in (*model.joint_names, *model.frames):
            assert f" {joint} " in text
        assert "…" not in text
        assert "doubtful: the last joint" not in text


def test_links_are_where_pinocchio_puts_them() -> None:
    model = robot_model("panda")
    found = overview(model)
    values = dict(zip(model.joint_names, model.home, strict=True))
    wanted = link_poses(model.urdf, values | ROBOTS["panda"].frozen)
    own = {row.name: row.pose for row in found.links}
    for link in ("panda_link4", "panda_link8", "panda_hand"):
        assert np.allclose(own[link], wanted[link], atol=1e-9)


def test_a_tool_has_a_sheet_too(hand: Path, tmp_path: Path) -> None:
    text = robots(str(hand), "--hold", "squeeze=0.03", "--out", str(tmp_path / "p"))
    assert "a tool, as it is no robot" in text
    assert "│ squeeze │ 0.03    │" in text
    assert "│ follow  │ -0.03   │" in text
    assert "(-0.01, 0.03, 0.09)" in text  # the least corner of the left finger
    with Image.open(tmp_path / "p" / "hand.png") as picture:
        assert picture.size[0] > 1000


def test_the_robots_of_a_scenario_are_shown_with_their_tools(
    hand: Path, tmp_path: Path
) -> None:
    path = tmp_path / "pair.yaml"
    path.write_text(SCENARIO)
    pair, bare = json.loads(robots(str(path), "--json"))
    assert pair["title"] == "ur5e+hand (left, right)"
    assert bare["title"] == "ur5e-fitted (bare)"
    assert "hand: fingers open from 0 to 90 mm, held 40.0 mm apart" in pair["notes"]
    assert "payload 5 kg, the tool included" in bare["notes"]
    assert {row["velocity"] for row in bare["joints"]} == {"1.25"}
    held = {row["joint"]: row["kind"] for row in pair["joints"]}
    assert held["hand.follow"] == "held at -0.02"


def test_limits_are_told_with_where_they_come_from() -> None:
    (panda,) = json.loads(robots("panda", "--json"))
    assert any("libfranka" in word for word in panda["notes"])
    assert [row["acceleration"] for row in panda["joints"][:3]] == ["15", "7.5", "10"]
    assert panda["joints"][0]["jerk"] == "7500"
    (ur5e,) = json.loads(robots("ur5e", "--json"))
    assert {row["acceleration"] for row in ur5e["joints"]} == {"5 (usual)"}
    assert any("nobody says it" in word for word in ur5e["notes"])


def test_a_maker_s_limits_stay_when_a_cell_adds_a_tool_or_a_limit() -> None:
    own = robot_model("panda")
    fitted = robot_model("panda", None, Fitting(limits=GivenLimits(velocity=(1.0,))))
    slower = robot_model(
        "panda", None, Fitting(limits=GivenLimits(acceleration=(2.0,)))
    )
    for model in (own, fitted):
        assert limits_of(model).acceleration.tolist()[:3] == [15.0, 7.5, 10.0]
        assert limits_of(model).jerk.tolist()[-1] == 10000.0
    assert set(limits_of(slower).acceleration.tolist()) == {2.0}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nobody.urdf"], "does not exist"),
        (["nobody"], "no robot 'nobody'"),
        (["panda", "--hold", "finger"], "JOINT=VALUE expected"),
        (["panda", "--hold", "thumb=1"], "no joint 'thumb'"),
        (["panda", "--flange", "thumb"], "'thumb' is no link"),
    ],
)
def test_mistakes_are_explained(arguments: list[str], words: str) -> None:
    done = CliRunner().invoke(app, ["robots", *arguments])
    assert done.exit_code == 2
    assert words in done.output


def test_what_is_neither_a_robot_nor_a_tool_gets_both_reasons(tmp_path: Path) -> None:
    path = tmp_path / "thing.urdf"
    path.write_text('<robot name="x"><link name="a"/></robot>')
    done = CliRunner().invoke(app, ["robots", str(path)])
    assert done.exit_code == 2
    assert "it is no robot: " in done.output
    assert "has no collision geometry" in done.output


def test_a_flange_with_x_out_of_it_is_doubtful() -> None:
    other = robot_model(str(ur5e()), None, Fitting(flange="flange"))
    words = flange_doubt(other)
    assert words is not None
    assert "x points out of the flange" in words
    assert flange_doubt(robot_model(str(ur5e()))) is None


@pytest.mark.parametrize("held", [0.0, 0.01, 0.04])
def test_the_gap_between_fingers_is_measured(hand: Path, held: float) -> None:
    tool = Tool(name="h", description=hand, held={"squeeze": held})
    model = robot_model("ur5e", None, Fitting(tool=tool))
    gap = finger_gap(model, model.frames["tool"])
    assert gap == pytest.approx(2.0 * held, abs=1e-9)
    assert finger_gap(model, identity()) == 0.0  # the flange is in the palm


ROW = (15.0, 3.3)


def _boxes(*centres: tuple[float, float], size: float = 0.02) -> np.ndarray:
    middle = np.array(centres)
    return np.stack([middle - 0.5 * size, middle + 0.5 * size], axis=1)


def test_tiny_things_near_each_other_are_drawn_larger() -> None:
    boxes = _boxes((0, 0), (0.05, 0), (0.03, 0.04), (1.9, 1.9), (1.0, 0.1))
    (found,) = close_ups(boxes, np.array([2.0, 2.0]), 0.004, ROW)
    assert [found.holds(box) for box in boxes] == [True, True, True, False, False]
    assert close_ups(10 * boxes, np.array([2.0, 2.0]), 0.004, ROW) == []
    assert close_ups(boxes[:0], np.array([2.0, 2.0]), 0.004, ROW) == []
    many = [(x, y) for x in np.arange(8) / 4 for y in (0.0, 0.03, 1.0, 1.03)]
    assert len(close_ups(_boxes(*many), np.array([2.0, 2.0]), 0.004, ROW)) <= MOST


def test_names_in_the_picture_are_not_on_each_other() -> None:
    path = scenario_path(Path("cliff"))
    figure = cell_figure(Subject(load_scenario(path), path.parent))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    above, _, *larger = figure.axes
    assert len(larger) == 3
    # The two reach 1.47 m from side to side, what happens there less than 1 m.
    assert np.ptp(above.get_xlim()) < 1.4
    for area in figure.axes:
        boxes = [
            text.get_window_extent(canvas.get_renderer()).expanded(0.9, 0.8)
            for text in area.texts
        ]
        assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    named = {text.get_text() for area in larger for text in area.texts}
    assert {"left_2x4_a", "right_2x6", "step 10"} <= named
