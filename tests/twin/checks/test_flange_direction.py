"""Which axis points out of a flange: that of a roll joint, or the direction in which a pitch joint swings it."""

from pathlib import Path

import pytest

from planning.robots.registry import robot_model
from tests.twin.program import invoke
from twin.checks.overview import flange_warning

LINK = """\
<link name="{name}"><collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
"""
JOINT = """\
<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{next}"/>
<origin xyz="{at}" rpy="{turn}"/><axis xyz="{axis}"/>
<limit lower="-2" upper="2"{speed}/></joint>
"""
FLANGE = """\
<joint name="end" type="fixed"><parent link="l{k}"/><child link="flange"/>
<origin xyz="{at}" rpy="{turn}"/></joint>
"""


def arm(
    folder: Path,
    axes: list[str],
    at: str,
    turn: str = "0 0 0",
    speed: str = ' velocity="2" effort="10"',
) -> Path:
    """Write an arm of links 0.2 m long, along z of each, and a flange on the last one."""
    count = len(axes)
    body = "".join(LINK.format(name=f"l{k}") for k in range(count + 1))
    for k, axis in enumerate(axes):
        own = {"k": k, "next": k + 1, "axis": axis, "turn": "0 0 0", "speed": speed}
        body += JOINT.format(at="0 0 0.2", **own)
    body += LINK.format(name="flange") + FLANGE.format(k=count, at=at, turn=turn)
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{body}</robot>')
    return path


YAW, PITCH, ROLL_X = "0 0 1", "0 1 0", "1 0 0"
QUARTER = "0 1.5707963267948966 0"


@pytest.mark.parametrize(
    ("axes", "at", "turn", "points"),
    [
        ([YAW, PITCH, YAW], "0 0 0.1", "0 0 0", None),
        # x forward, as in links called flange: the joint turns about it.
        ([YAW, PITCH, ROLL_X], "0.1 0 0", "0 0 0", "x"),
        ([YAW, PITCH, ROLL_X], "0 0 0", "0 0 0", "x"),
        ([YAW, PITCH, ROLL_X], "0.1 0 0", QUARTER, None),
        # Pitch joints: z along the last link is right, whatever the axis is called.
        ([YAW, PITCH, PITCH], "0 0 0.1", "0 0 0", None),
        ([YAW, ROLL_X, ROLL_X], "0 0 0.1", "0 0 0", None),
        ([YAW, ROLL_X, PITCH], "0 0 0.1", "0 0 0", None),
        ([YAW, PITCH, PITCH], "0 0 0", "0 0 0", None),
        # x along the last link of an arm that ends in a pitch joint.
        ([YAW, PITCH, PITCH], "0.1 0 0", "0 0 0", "x"),
        ([YAW, PITCH, PITCH], "0.1 0 0", QUARTER, None),
        ([YAW, ROLL_X, PITCH], "0.1 0 0", "0 0 0", "x"),
        # Neither along an axis of the flange.
        ([YAW, PITCH, PITCH], "0.1 0 0.1", "0 0 0", None),
    ],
)
def test_what_points_out_of_a_flange(
    tmp_path: Path, axes: list[str], at: str, turn: str, points: str | None
) -> None:
    words = flange_warning(robot_model(str(arm(tmp_path, axes, at, turn))))
    assert (words or "")[:1] == (points or "")


def test_an_arm_without_speeds_is_shown_with_its_ranges(tmp_path: Path) -> None:
    path = arm(tmp_path, [YAW, PITCH, PITCH], "0 0 0.1", speed="")
    shown = " ".join(invoke("robots", path).output.split())
    assert "no scenario can use it as it is" in shown
    assert "'limits: {velocity: ...}'" in shown
    assert "as it is no robot" not in shown
    assert shown.count("-2") >= 3
    assert "unknown" in shown
