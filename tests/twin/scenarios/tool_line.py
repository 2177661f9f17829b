"""A line in which an arm changes its gripper for a driver, and another one on a rail brings caps from afar.

The rack of the driver is behind the door of a press: nobody comes there while that works.
"""

from pathlib import Path

ARM = Path(__file__).parents[3] / "planning" / "robots" / "urdf" / "ur5e.urdf"

RAIL = """\
<link name="rail">
    <collision><origin xyz="0 0 -0.03"/><geometry><box size="2.4 0.16 0.06"/></geometry></collision>
  </link>
  <joint name="along" type="prismatic">
    <parent link="rail"/><child link="base_link"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="0.8" effort="900"/>
  </joint>
  """

LINE = """\
version: 1
name: tool_line
cell:
  tools:
    gripper:
      shapes:
        - {box: [0.06, 0.1, 0.06], pose: {xyz_m: [0, 0, 0.03]}}
        - {box: [0.02, 0.01, 0.06], pose: {xyz_m: [0, 0.045, 0.09]}}
        - {box: [0.02, 0.01, 0.06], pose: {xyz_m: [0, -0.045, 0.09]}}
      tcp: {xyz_m: [0, 0, 0.115]}
      opening_m: 0.08
      rack: {xyz_m: [-0.35, 0.3, 0.2], rpy_deg: [180, 0, 0]}
    driver:
      shapes: [{cylinder: {radius_m: 0.02, length_m: 0.14}, pose: {xyz_m: [0, 0, 0.07]}}]
      tcp: {xyz_m: [0, 0, 0.14]}
      opening_m: 0
      rack: {xyz_m: [-0.2, 0.3, 0.2], rpy_deg: [180, 0, 0], change_s: 3}
    cup:
      shapes: [{cylinder: {radius_m: 0.015, length_m: 0.1}, pose: {xyz_m: [0, 0, 0.05]}}]
      tcp: {xyz_m: [0, 0, 0.1]}
      suction: true
  robots:
    - {name: arm, model: ur5e, tools: [gripper, driver], base: {xyz_m: [-0.4, 0, 0]}}
    - name: slider
      model: railed.urdf
      tool: cup
      base: {xyz_m: [0.55, 0.4, 0.06], rpy_deg: [0, 0, 90]}
      home_rad_or_m: [0.6, 0, -1.5708, 1.5708, -1.5708, -1.5708, 0]
  fixtures:
    - {name: table, size_m: [2, 3, 0.04], pose: {xyz_m: [0.1, 0.3, -0.02]}}
assembly:
  kind: assembly
  grips: {depth_m: 0.02, positions: 3}
  sources:
    blocks: {kind: feeder, pose: {xyz_m: [-0.1, -0.3, 0.02]}}
    caps: {kind: feeder, pose: {xyz_m: [0.2, 1.3, 0.01]}}
  machines:
    press: {door: {size_m: [0.3, 0.3, 0.3], pose: {xyz_m: [-0.05, 0.4, 0.15]}}}
  processes:
    screw: {duration: {kind: uniform, low_s: 1, high_s: 9}, tool: driver}
    pressing: {duration: {kind: uniform, low_s: 1, high_s: 25}, machine: press}
  parts:
    - {name: block, size_m: [0.06, 0.04, 0.04], source: blocks, goal: {xyz_m: [0.05, 0, 0.02]}}
    - name: cap
      size_m: [0.06, 0.04, 0.02]
      source: caps
      goal: {xyz_m: [0.05, 0, 0.05]}
      frames: {top: {xyz_m: [0, 0, 0.01]}}
  steps:
    - {place: block, robots: [arm]}
    - {process: pressing, at: {part: block}}
    - cap
    - {process: screw, at: {part: cap, frame: top}}
  products: {count: 7, leave_s: 2}
planning: {speed_model: joint, shortcut_candidates: 60}
execution:
  skills: {pick: {kind: uniform, low_s: 1, high_s: 5}, place-down: {kind: uniform, low_s: 1, high_s: 5}}
"""

AT_RACKS = """\
  failures: {take-tool: {probability: 0.5, retries: 0}, leave-tool: {probability: 0.2, retries: 1}}
"""
"""Failures of its changes of tools, to be written at its end."""


def tool_line(folder: Path) -> str:
    """Return the text of the line, with the description of its robot on a rail in a folder."""
    file = folder / "railed.urdf"
    arm = ARM.read_text("utf-8")
    link = '<link name="base_link">'
    file.write_text(arm.replace(link, RAIL + link, 1), "utf-8")
    return LINE.replace("railed.urdf", str(file))
