"""An arm whose last link folds back on the first, with SRDF that allows it, and a cell in which it does."""

from pathlib import Path

ROD = '<collision><origin xyz="0.15 0 {z}"/><geometry><box size="0.3 0.04 {size}"/></geometry></collision>'
JOINT = (
    '<joint name="turn{k}" type="revolute"><parent link="{parent}"/><child link="link{k}"/><origin xyz="{x} 0 {z}"/>'
    '<axis xyz="0 0 1"/><limit lower="-2.8" upper="2.8" effort="50" velocity="2"/></joint>'
)
URDF = (
    '<robot name="folding"><link name="foot"><collision><geometry><box size="0.05 0.05 0.05"/></geometry></collision></link>'
    + "".join(
        f'<link name="link{k}">{ROD.format(z=0, size=0.04)}</link>'
        + JOINT.format(k=k, parent=parent, x=x, z=z)
        for k, parent, x, z in (
            (1, "foot", 0, 0.1),
            (2, "link1", 0.3, 0),
            (3, "link2", 0.3, 0),
        )
    )
    + '<link name="hand"/><joint name="wrist" type="fixed"><parent link="link3"/><child link="hand"/>'
    '<origin xyz="0.3 0 0"/></joint><link name="tip"/><joint name="end" type="fixed"><parent link="hand"/>'
    '<child link="tip"/></joint></robot>'
)
SRDF = """<robot name="folding">
  <group name="arm"><chain base_link="foot" tip_link="hand"/></group>
  <group_state name="straight" group="arm"><joint name="turn1" value="0"/><joint name="turn2" value="0"/>
    <joint name="turn3" value="0"/></group_state>
  <group_state name="Home" group="arm"><joint name="turn1" value="0.1"/><joint name="turn2" value="0.2"/>
    <joint name="turn3" value="-0.3"/></group_state>
  <group_state name="half" group="arm"><joint name="turn1" value="0.1"/></group_state>
  <group_state name="far" group="arm"><joint name="turn1" value="0"/><joint name="turn2" value="3.1"/>
    <joint name="turn3" value="0"/></group_state>
  <end_effector name="point" parent_link="tip" group="grip"/>
  <end_effector name="grip" parent_link="hand" group="grip"/>
  <disable_collisions link1="link1" link2="link2" reason="Adjacent"/>
  <disable_collisions link1="link3" link2="link1" reason="User"/>
  <disable_collisions link1="link1" link2="camera" reason="Never"/>
</robot>"""
FOLDED = (0, 120, 125)
"""Configuration in which link3 lies on link1 [deg]."""

CELL = """version: 1
name: folding
cell:
  robots:
    - {{name: one, model: arm.urdf, home_deg: [0, 0, 0]{more}}}
assembly:
  kind: goals
  moves: [{{robot: one, to_deg: [0, 120, 125], frame: flange}}]
"""


def folding_cell(folder: Path, more: str = "", srdf: str | None = None) -> Path:
    """Write a cell in which the arm folds, with more keys of the robot, and what it needs; return its file."""
    (folder / "arm.urdf").write_text(URDF)
    if srdf is not None:
        (folder / "arm.srdf").write_text(srdf)
    path = folder / "cell.yaml"
    path.write_text(CELL.format(more=more))
    return path
