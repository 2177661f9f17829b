"""Damaged descriptions of tools: each is read, or refused with the name of its file."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planning.errors import RobotModelError
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.descriptions.mounting import fitted_description
from planning.robots.descriptions.urdf_file import UrdfOptions
from tests.planning.robots.descriptions.test_mjcf import HAND
from tests.planning.robots.descriptions.vendors import GRIPPER

ARM = Path(__file__).parents[4] / "planning" / "robots" / "urdf" / "ur5e.urdf"
VALUES = (
    *("nan", "inf", "-1", "0", "1e300", "1e999", "", "x", "1 2", "0 0 0", "1 2 3 4"),
    *("palm", "left", "right", "tcp", "squeeze", "finger", "revolute", "floating"),
    *("slide", "hinge", "ball", "free", "mesh", "gone.stl", "../../etc/passwd"),
)


@st.composite
def damaged(draw: st.DrawFn) -> tuple[str, str]:
    """A description with values, elements or letters that are wrong, left out or twice."""
    name, text = draw(st.sampled_from([("tool.urdf", GRIPPER), ("tool.xml", HAND)]))
    for _ in range(draw(st.integers(1, 3))):
        pattern, groups = draw(
            st.sampled_from(
                [
                    (r'="([^"]*)"', "value"),
                    (r"<\w+[^<>]*/>", "element"),
                    (r' \w+="[^"]*"', "key"),
                ]
            )
        )
        found = list(re.finditer(pattern, text))
        if not found:
            continue
        at = found[draw(st.integers(0, len(found) - 1))]
        new = {"value": f'="{draw(st.sampled_from(VALUES))}"', "key": ""}.get(groups)
        if new is None:
            new = draw(st.sampled_from(["", at[0] * 2]))
        text = text[: at.start()] + new + text[at.end() :]
    if draw(st.booleans()):
        cut = draw(st.integers(0, len(text)))
        text = text[:cut] + draw(st.sampled_from(["<", "&", "<a>", "\0"])) + text[cut:]
    return name, text


@settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(damaged())
def test_a_damaged_tool_is_read_or_refused_by_name(
    tmp_path: Path, case: tuple[str, str]
) -> None:
    name, text = case
    path = tmp_path / name
    path.write_text(text)
    tool = Tool(name="t", description=path, tcp=np.eye(4))
    try:
        root = fitted_description(ARM, UrdfOptions(), Fitting(tool=tool), ())
    except RobotModelError as error:
        words = str(error)
    else:
        words = ""
    if words:
        assert str(path) in words
        return
    # What is read has no joint of the tool left that moves, and no number that is none.
    for joint in root.findall("joint"):
        if str(joint.get("name")).startswith("t."):
            assert joint.get("type") == "fixed"
    for origin in root.iter("origin"):
        values = f"{origin.get('xyz', '0')} {origin.get('rpy', '0')}".split()
        assert np.all(np.isfinite([float(value) for value in values]))


@pytest.mark.parametrize("depth", [2000])
def test_a_chain_of_very_many_links_is_no_harm(tmp_path: Path, depth: int) -> None:
    links = "".join(f'<link name="l{k}"/>' for k in range(depth))
    joints = "".join(
        f'<joint name="j{k}" type="fixed"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(depth - 1)
    )
    body = '<link name="l0"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>'
    path = tmp_path / "long.urdf"
    links = links.replace('<link name="l0"/>', body)
    path.write_text(f'<robot name="long">{links}{joints}</robot>')
    tool = Tool(name="t", description=path, tcp=np.eye(4))
    root = fitted_description(ARM, UrdfOptions(), Fitting(tool=tool), ())
    assert len(root.findall("link")) > depth


def test_a_second_place_of_a_shape_has_numbers_too(tmp_path: Path) -> None:
    path = tmp_path / "tool.urdf"
    first = '<collision><origin xyz="0 0 0.05"/>'
    path.write_text(GRIPPER.replace(first, f'{first}<origin xyz="nan"/>'))
    tool = Tool(name="t", description=path, tcp=np.eye(4))
    with pytest.raises(RobotModelError, match="link 'palm'"):
        fitted_description(ARM, UrdfOptions(), Fitting(tool=tool), ())
