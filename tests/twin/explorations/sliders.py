"""Two sliders that face a table: each goes to a place along x, so the best place of its base is known."""

from pathlib import Path

LEFT, RIGHT = "cell.robots.left.base.xyz_m.0", "cell.robots.right.base.xyz_m.0"
URDF = """\
<robot name="slider">
  <link name="base"/>
  <link name="carriage">
    <collision><origin xyz="0 0 0.1"/><geometry><box size="0.04 0.04 0.04"/></geometry></collision>
  </link>
  <joint name="along" type="prismatic">
    <parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="0.5" effort="10"/>
  </joint>
</robot>
"""

SCENARIO = """\
version: 1
name: sliders
cell:
  robots:
    - {name: left, model: slider.urdf, base: {xyz_m: [-0.3, -0.5, 0]}}
    - {name: right, model: slider.urdf, base: {xyz_m: [0.3, 0.5, 0]}}
  fixtures: [{name: table, size_m: [1, 0.2, 0.02], pose: {xyz_m: [0, 0, 0.01]}}]
assembly:
  kind: goals
  moves:
    - {robot: left, frame: flange, to: {xyz_m: [0.1, -0.5, 0]}}
    - {robot: right, frame: flange, to: {xyz_m: [-0.1, 0.5, 0]}}
planning: {speed_model: joint}
"""

EXPLORE = """\
explore:
  vary:
    - {key: cell.robots.left.base.xyz_m.0, low: -0.6, high: 0.6}
    - {key: cell.robots.right.base.xyz_m.0, low: -0.6, high: 0.6}
  goals: [{minimise: makespan_s}]
  designs: 10
"""


def slider_file(folder: Path, more: str = EXPLORE, *, right: float = 0.3) -> Path:
    """Write the scenario, with more at its end and the right base there, and what it needs; return its file."""
    folder.mkdir(exist_ok=True, parents=True)
    (folder / "slider.urdf").write_text(URDF)
    file = folder / "sliders.yaml"
    file.write_text(SCENARIO.replace("[0.3, 0.5", f"[{right}, 0.5") + more)
    return file
