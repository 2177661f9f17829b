"""SRDF beside a description: pairs of links, named poses and end effectors; damaged files are refused with the place."""

from pathlib import Path

import numpy as np
import pytest

from planning.errors import FittingError, RobotModelError
from planning.robots.descriptions.fitting import Fitting
from planning.robots.registry import robot_model
from planning.vendor_files.vendor_files import with_vendor_files
from tests.planning.vendor_files.folding_arm import SRDF, URDF, folding_cell
from tests.twin.program import invoke

DAMAGED = {
    "": "is not XML",
    "<robot name='x'>": "is not XML",
    "<sdf/>": "root element is <sdf>",
    "<!DOCTYPE r [<!ENTITY a '1'>]><robot>&b;</robot>": "is not XML",
    "<robot><disable_collisions link1='link1'/></robot>": "<disable_collisions> 1 has no link2",
    "<robot><disable_collisions link1=' ' link2='link2'/></robot>": "1 has no link1",
    "<robot><group_state/></robot>": "<group_state> 1 has no name",
    "<robot><group_state name='home'><joint value='1'/></group_state></robot>": "a <joint> has no name",
    "<robot><group_state name='home'><joint name='turn1'/></group_state></robot>": "'turn1' has no value",
    "<robot><group_state name='home'><joint name='turn1' value='1 nan'/></group_state></robot>": "finite number",
    "<robot><group_state name='home'><joint name='turn1' value='__import__'/></group_state></robot>": "finite number",
    "<robot><end_effector name='hand'/></robot>": "<end_effector> 'hand' has no parent_link",
    "<robot>" + "<a>" * 5000 + "</a>" * 5000 + "</robot>": "nested",
}


def described(folder: Path, srdf: str | None = None, at: str = "arm.srdf") -> Path:
    path = folder / "arm.urdf"
    path.write_text(URDF)
    if srdf is not None:
        (folder / at).parent.mkdir(parents=True, exist_ok=True)
        (folder / at).write_text(srdf)
    return path


@pytest.mark.parametrize("text", DAMAGED)
def test_a_damaged_file_is_refused_with_its_place(text: str, tmp_path: Path) -> None:
    path = described(tmp_path, text)
    with pytest.raises(RobotModelError) as error:
        with_vendor_files(str(path), tmp_path, Fitting())
    assert str(path.with_suffix(".srdf")) in error.value.message
    assert DAMAGED[text] in error.value.message


@pytest.mark.parametrize("command", ["check", "run"])
def test_a_damaged_file_ends_commands_with_code_2(command: str, tmp_path: Path) -> None:
    text = "<robot><disable_collisions link1='link1'/></robot>"
    file = folding_cell(tmp_path, srdf=text)
    done = invoke(command, file, code=2)
    assert "arm.srdf: <disable_collisions> 1 has no link2" in done.output


@pytest.mark.parametrize(
    ("at", "found"),
    [
        ("arm.srdf", True),
        ("srdf/arm.srdf", True),
        ("../config/arm.srdf", True),
        ("any.srdf", True),
        ("srdf/any.srdf", False),
        ("../arm.srdf", False),
    ],
)
def test_the_file_is_found_beside_the_description(
    at: str, found: bool, tmp_path: Path
) -> None:
    (tmp_path / "urdf").mkdir()
    path = described(tmp_path / "urdf", SRDF, at)
    _, fitting = with_vendor_files(str(path), tmp_path, Fitting())
    assert bool(fitting.ignored) == found


def test_a_file_of_another_name_is_only_taken_for_the_same_robot(
    tmp_path: Path,
) -> None:
    path = described(tmp_path, SRDF.replace('"folding"', '"other"'), "any.srdf")
    assert with_vendor_files(str(path), tmp_path, Fitting())[1] == Fitting()
    _, given = with_vendor_files(str(path), tmp_path, Fitting(), srdf="any.srdf")
    assert len(given.ignored) == 2
    assert with_vendor_files(str(path), tmp_path, Fitting(), srdf=False)[1] == Fitting()


def test_pairs_home_and_flange_come_from_the_file(tmp_path: Path) -> None:
    path = described(tmp_path, SRDF)
    plain = robot_model(str(path))
    model = robot_model(*with_vendor_files(str(path), tmp_path, Fitting())[:1])
    assert model is plain  # the description alone says nothing
    model_path, fitting = with_vendor_files(str(path), tmp_path, Fitting())
    model = robot_model(model_path, None, fitting)
    assert model.home == pytest.approx([0.1, 0.2, -0.3])
    assert (plain.flange_link, model.flange_link) == ("link3", "hand")
    links = [part.link for part in model.parts]
    more = {(links[i], links[j]) for i, j in model.never_collide - plain.never_collide}
    assert more == {("link1", "link3")}
    assert fitting.ignored == {
        ("link1", "link2"): "arm.srdf: Adjacent",
        ("link3", "link1"): "arm.srdf: User",
    }


def test_the_cell_goes_before_the_file(tmp_path: Path) -> None:
    path = described(tmp_path, SRDF)
    own = Fitting(flange="link3", held={"turn3": 0.5})
    model_path, fitting = with_vendor_files(str(path), tmp_path, own, home="straight")
    model = robot_model(model_path, None, fitting)
    assert model.flange_link == "link3"
    assert np.array_equal(model.home, [0.0, 0.0])


@pytest.mark.parametrize(
    ("home", "words"),
    [
        ("nowhere", "has no pose 'nowhere' (valid: straight, Home, half, far)"),
        ("half", "has no value of joint 'turn2'"),
        ("far", "has joint 'turn2' at 3.1, beyond -2.8 to 2.8"),
    ],
)
def test_a_pose_that_is_no_home_is_refused(
    home: str, words: str, tmp_path: Path
) -> None:
    path = described(tmp_path, SRDF)
    with pytest.raises(FittingError) as error:
        with_vendor_files(str(path), tmp_path, Fitting(), home=home)
    assert error.value.key == "home"
    assert words in str(error.value)


def test_a_home_out_of_limits_that_nobody_asked_for_is_not_taken(
    tmp_path: Path,
) -> None:
    path = described(tmp_path, SRDF.replace('"far"', '"ready"').replace("Home", "rest"))
    assert with_vendor_files(str(path), tmp_path, Fitting())[1].home == {}


MJCF = """<mujoco model="own"><worldbody><geom type="box" size="0.05 0.05 0.01"/>
  <body name="a" pos="0 0 0.1"><joint name="one" type="hinge" axis="0 0 1" range="-90 90"/>
    <geom type="box" size="0.15 0.02 0.02" pos="0.15 0 0"/>
    <body name="b" pos="0.3 0 0"><joint name="two" type="hinge" axis="0 0 1" range="-170 170"/>
      <geom type="box" size="0.15 0.02 0.02" pos="0.15 0 0"/></body></body>
  </worldbody>
  <contact><exclude body1="world" body2="b"/></contact>
  <keyframe><key name="home" qpos="0.2 0.3"/></keyframe></mujoco>"""


def test_mjcf_says_the_same_in_its_own_words(tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    path.write_text(MJCF)
    _, fitting = with_vendor_files(str(path), tmp_path, Fitting())
    assert fitting.ignored == {("world", "b"): "own.xml: exclude"}
    assert fitting.home == {"one": 0.2, "two": 0.3}
    path.write_text(MJCF.replace('body2="b"', ""))
    with pytest.raises(RobotModelError, match="<exclude> 1 has no body2"):
        with_vendor_files(str(path), tmp_path, Fitting())
