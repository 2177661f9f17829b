"""What is said of two robots of one description that contradict each other."""

from pathlib import Path

import pytest

from planning.errors import RobotModelError
from planning.robots.descriptions.fitting import Fitting
from planning.robots.registry import robot_model
from tests.twin.shared_bodies.torsos import built_cell, torso, written_cell
from tests.twin.written import checked
from twin.document.validation import InvalidScenarioError
from twin.reading.scenario_file import load_scenario

HELD = ", joints: {waist: 0.1}"
FOLLOWS = '<joint name="neck" type="revolute"><mimic joint="{}"/>'


@pytest.mark.parametrize(
    ("left", "right", "line", "words"),
    [
        (
            "",
            "",
            6,
            "left and right are arms of one body, and joint 'waist' carries both",
        ),
        (HELD, "", 6, "hold it in both, with 'joints: {waist: 0}'"),
        ("", HELD, 6, "no robot can move the base of another one"),
        (HELD, HELD.replace("1", "2"), 6, "held at 0.1 by left and at 0.2 by right"),
        (
            ", joints: {waist: 0, neck: 0.5}",
            ", joints: {waist: 0, neck: 0.4}",
            6,
            "joint 'neck' of it is held at 0.5 by left and at 0.4 by right",
        ),
        (
            HELD + ", base_error: {m: 0.001}",
            HELD,
            5,
            "left is an arm of one body with right",
        ),
        (", joints: {waist: 9}", HELD, 5, "'waist' cannot be held at 9"),
        (HELD, ", joints: {waist: 0.1, nape: 0}", 6, "has no joint 'nape' to hold"),
    ],
)
def test_contradictions_are_said_once_with_both_names(
    left: str, right: str, line: int, words: str, tmp_path: Path
) -> None:
    file = written_cell(tmp_path, left=left, right=right)
    with pytest.raises(InvalidScenarioError) as found:
        load_scenario(file)
    said = [text for text in str(found.value).splitlines() if "cell.yaml:" in text]
    assert len(said) == 1
    assert f"cell.yaml:{line}:" in said[0]
    assert words in said[0]


@pytest.mark.parametrize(
    ("flange", "words"),
    [
        (
            "left_tool",
            r"'left_tool' is no link that a joint moves \(valid: chest, head",
        ),
        ("pedestal", "'pedestal' is no link that a joint moves"),
        (
            None,
            "the chain branches at joints .*name its 'flange'.*head, left_tool0",
        ),
    ],
)
def test_a_flange_is_a_link_that_moves(
    flange: str | None, words: str, tmp_path: Path
) -> None:
    (tmp_path / "body.urdf").write_text(torso())
    with pytest.raises(RobotModelError, match=words):
        robot_model(str(tmp_path / "body.urdf"), None, Fitting(flange=flange))


def test_joints_beyond_the_flange_stand_still(tmp_path: Path) -> None:
    """So do those beside it: at zero, at their nearest limit, or where they are held."""
    text = torso().replace('lower="-2"', 'lower="0.3"', 2)  # of waist and neck
    (tmp_path / "body.urdf").write_text(text)
    fitting = Fitting(flange="left2", held={"left_3": 0.4})
    model = robot_model(str(tmp_path / "body.urdf"), None, fitting)
    assert model.joint_names == ("waist", "left_1", "left_2")
    held = model.urdf.read_text()
    assert held.count('held="0.0"') == 3
    assert held.count('held="0.3"') == 1
    assert held.count('held="0.4"') == 1


@pytest.mark.parametrize(
    ("leader", "words"),
    [("left_1", "'neck' mimics a joint .* that the arm moves"), ("right_1", "")],
)
def test_what_follows_a_joint_of_the_arm_is_refused(
    leader: str, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "body.urdf"
    old = '<joint name="neck" type="revolute">'
    path.write_text(torso().replace(old, FOLLOWS.format(leader)))
    if not words:
        assert robot_model(str(path), None, Fitting(flange="left3")).dof == 4
        return
    with pytest.raises(RobotModelError, match=words):
        robot_model(str(path), None, Fitting(flange="left3"))


def test_arms_of_one_body_with_different_bases_are_told_to_stand_together(
    tmp_path: Path,
) -> None:
    file = written_cell(
        tmp_path, left=HELD, right=HELD + ", base: {xyz_m: [0.02, 0, 0]}"
    )
    said = [item.message for item in checked(file).errors]
    assert any(
        "left and right are arms of one description: give both the same base" in words
        for words in said
    )
    far = written_cell(tmp_path, left=HELD, right=HELD + ", base: {xyz_m: [2, 0, 0]}")
    assert checked(far).errors == ()
    assert built_cell(far).fixtures == ()


@pytest.mark.parametrize("base", ["rpy_deg: [0, 0, 360]", "quat_wxyz: [2, 0, 0, 0]"])
@pytest.mark.parametrize("model", ["./body.urdf", "body.urdf"])
def test_the_same_file_and_base_are_recognised(
    base: str, model: str, tmp_path: Path
) -> None:
    """However they are written, and with joints of the other arm held in place of a flange."""
    here = f", base: {{xyz_m: [0, 0, 0], {base}}}"
    rest = ", joints: {waist: 0.1, neck: 0, left_1: 0, left_2: 0, left_3: 0}"
    file = written_cell(tmp_path, left=HELD, right=rest + here)
    text = file.read_text().replace(", flange: right_tool0", "")
    file.write_text(text.replace("right, model: body.urdf", f"right, model: {model}"))
    cell = built_cell(file)
    assert [len(robot.model.parts) for robot in cell.robots] == [3, 3]
    assert len(cell.fixtures) == 3
    taken = text.replace("assembly:", TABLE + "assembly:")
    file.write_text(taken)
    assert [item.name for item in built_cell(file).fixtures] == [
        "body.chest",
        "body.pedestal",
        "body.chest_2",
        "body.head",
    ]


TABLE = """  fixtures:
    - {name: body.chest, size_m: [0.1, 0.1, 0.1], pose: {xyz_m: [2, 0, 0]}}
"""

MJCF = """<mujoco><worldbody><body name="chest"><geom type="box" size="0.1 0.1 0.3"/>
  <body name="up{0}" pos="0 0.2 0.2"><joint name="{0}" axis="0 1 0" range="-2 2"/>
    <geom type="box" size="0.03 0.03 0.1"/><body name="hand{0}" pos="0 0 0.2"/></body>
  <body name="up{1}" pos="0 -0.2 0.2"><joint name="{1}" axis="0 1 0" range="-2 2"/>
    <geom type="box" size="0.03 0.03 0.1"/><body name="hand{1}" pos="0 0 0.2"/></body>
</body></worldbody></mujoco>"""


def test_arms_of_an_mjcf_file_take_their_speeds_from_the_cell(tmp_path: Path) -> None:
    """It has none; the world and the chest are of both."""
    speed = ", limits: {velocity: 2}"
    file = written_cell(tmp_path, left=speed, right=speed)
    (tmp_path / "body.xml").write_text(MJCF.format("left", "right"))
    text = file.read_text().replace("body.urdf", "body.xml")
    for arm in ("left", "right"):
        text = text.replace(f"{arm}_tool0", f"hand{arm}")
    text = text.replace("[0.2, 0.5, -0.5]", "[0.2]").replace("[-0.2, -0.5, 0.5]", "[0]")
    file.write_text(text)
    assert checked(file).errors == ()
    cell = built_cell(file)
    assert [f.name for f in cell.fixtures] == ["body.chest"]
    assert [r.model.joint_names for r in cell.robots] == [("left",), ("right",)]
