"""Cells as others bring them: what their files want to say, from the file to an audited run.

`docs/reference/own-cells.md` lists what can be said, with the tests that hold it, and what cannot.
"""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from planning.errors import TwinError
from planning.grips.grip import GripRules
from planning.grips.tool_grips import explain_tool_misfit, robot_grips
from planning.steps.skill import Obstruction
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.scenarios.executed import built
from tests.twin.written import loaded
from twin.planning.build_workcell import build_workcell
from twin.trial.planning import plan_scenario

END = """\
planning: {speed_model: joint, shortcut_candidates: 200}
execution:
  skills: {pick: {kind: fixed, value_s: 1}, place-down: {kind: fixed, value_s: 1}}
"""

ARM = """\
version: 1
name: own
cell:
  tools:
    fingers:
      shapes:
        - {box: [0.04, 0.1, 0.04], pose: {xyz_m: [0, 0, 0.02]}}
        - {box: [0.02, 0.01, 0.08], pose: {xyz_m: [0, 0.04, 0.08]}}
        - {box: [0.02, 0.01, 0.08], pose: {xyz_m: [0, -0.04, 0.08]}}
      tcp: {xyz_m: [0, 0, 0.11]}
      opening_m: 0.07
      frames: {camera: {xyz_m: [0.06, 0, 0.25]}}
    cup:
      shapes: [{cylinder: {radius_m: 0.02, length_m: 0.1}, pose: {xyz_m: [0, 0, 0.05]}}]
      tcp: {xyz_m: [0, 0, 0.1]}
      suction: true
  robots:
    - {name: left, model: ur5e, tool: TOOL, base: {xyz_m: [-0.5, 0, 0]}, MORE}
    - {name: right, model: ur5e, tool: TOOL, base: {xyz_m: [0.5, 0, 0], rpy_deg: [0, 0, 180]}}
  fixtures:
    - {name: table, size_m: [1.8, 1.4, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
"""


def cell(tool: str, more: str = "limits: {velocity: 2}") -> str:
    return ARM.replace("TOOL", tool).replace("MORE", more)


def done(folder: Path, text: str) -> TemporalPlanGraph:
    """Return the plan of a cell, once check, proof and audit are content."""
    return built(folder, text + END).tpg


def robots_of(tpg: TemporalPlanGraph, kind: str) -> list[str]:
    return [task.robot for task in tpg.tasks if task.kind == kind]


@pytest.mark.expensive
def test_who_may_carry_it_places_it(tmp_path: Path) -> None:
    """The left arm is nearer to everything, and may carry too little."""
    part = """\
assembly:
  kind: assembly
  parts:
    - {name: billet, size_m: [0.06, 0.06, 0.1], start: {xyz_m: [0, 0.3, 0.05]}, goal: {xyz_m: [-0.05, -0.3, 0.05]}, mass_kg: 2.5}
  steps: [billet]
"""
    light = cell("fingers", "limits: {payload_kg: 2}")
    tpg = done(tmp_path, light + part)
    assert set(robots_of(tpg, "pick")) == {"right"}
    pinned = "[billet]", "[{place: billet, robots: [left]}]"
    with pytest.raises(
        TwinError, match=r"may carry 2 kg beside its tool, and billet weighs 2\.5 kg"
    ):
        plan_scenario(loaded(tmp_path, light + part + END, pinned), tmp_path)


def test_fingers_take_nothing_wider_than_they_are_held(tmp_path: Path) -> None:
    """They might open to 100 mm, and are held 70 mm apart: what they would be in is not gripped."""
    text = """\
assembly:
  kind: assembly
  parts:
    - {name: box, size_m: [0.05, 0.09, 0.05], start: {xyz_m: [0, 0.3, 0.025]}, goal: {xyz_m: [0, -0.3, 0.025]}}
  steps: [box]
"""
    wide = "opening_m: 0.07", "opening_m: 0.1"
    there = build_workcell(loaded(tmp_path, cell("fingers") + text, wide))
    robot, part = there.robots[0], there.object("box")
    held: dict[float, list[Obstruction | None]] = {}
    rules = GripRules(opening=0.1, depth=0.02)
    for grip in robot_grips(robot, part.shape, part.start, part.start, rules):
        width = round(float(np.abs(grip.pose[:3, 1]) @ part.size), 6)
        held.setdefault(width, []).append(
            explain_tool_misfit(robot, "tool", part, grip, 0.06)
        )
    assert sorted(held) == [0.05, 0.09]
    assert not any(held[0.05])
    assert all("mm in box" in str(found) for found in held[0.09])


@pytest.mark.expensive
def test_sheets_are_taken_from_a_pile_by_suction(tmp_path: Path) -> None:
    parts = "".join(
        f"    - {{name: sheet{k}, size_m: [0.24, 0.16, 0.001], source: pile,"
        f" goal: {{xyz_m: [0.05, -0.3, {0.0005 + 0.001 * k:.4f}]}}, mass_kg: 0.2}}\n"
        for k in range(3)
    )
    text = f"""\
assembly:
  kind: assembly
  sources:
    pile: {{kind: stack, pose: {{xyz_m: [0, 0.3, 0.0025]}}, count: 3, pitch_m: 0.001}}
  parts:
{parts}  steps: [sheet0, sheet1, sheet2]
"""
    tpg = done(tmp_path, cell("cup") + text)
    assert len(robots_of(tpg, "pick")) == 3


@pytest.mark.expensive
def test_a_plug_is_pushed_in_sideways_by_grips_of_its_own(tmp_path: Path) -> None:
    """The socket has walls on all sides but one, and a roof: no way leads down."""
    text = """\
    - name: socket
      shape:
        compound:
          - {box: [0.06, 0.07, 0.02], pose: {xyz_m: [0.03, 0, 0.01]}}
          - {box: [0.06, 0.01, 0.05], pose: {xyz_m: [0.03, 0.03, 0.045]}}
          - {box: [0.06, 0.01, 0.05], pose: {xyz_m: [0.03, -0.03, 0.045]}}
          - {box: [0.06, 0.07, 0.01], pose: {xyz_m: [0.03, 0, 0.075]}}
      pose: {xyz_m: [0.05, -0.3, 0]}
assembly:
  kind: assembly
  parts:
    - name: plug
      size_m: [0.14, 0.03, 0.03]
      start: {xyz_m: [0, 0.3, 0.015]}
      goal: {xyz_m: [0.035, -0.3, 0.035]}
      insert: [1, 0, 0]
      approach_m: 0.09
      grips: {positions: 5, end_margin_m: 0.015, depth_m: 0.012}
      mass_kg: 0.1
  steps: [plug]
  joined: [[plug, socket]]
"""
    tpg = done(tmp_path, cell("fingers") + text)
    assert len(robots_of(tpg, "place-down")) == 1
    down = "insert: [1, 0, 0]", "insert: [0, 0, -1]"
    other = loaded(tmp_path, cell("fingers") + text + END, down)
    with pytest.raises(
        TwinError,
        match=r"\(plug\) leads through socket on the straight way into its place",
    ):
        plan_scenario(other, tmp_path)


@pytest.mark.expensive
def test_a_part_is_turned_over_and_looked_at_from_afar_while_it_dwells(
    tmp_path: Path,
) -> None:
    """Upside down: gripped at its sides, laid down in between; then a camera looks at what was below."""
    text = """\
assembly:
  kind: assembly
  grips: {directions: [[0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], depth_m: 0.02}
  parts:
    - name: block
      size_m: [0.06, 0.06, 0.1]
      start: {xyz_m: [0, 0.35, 0.05]}
      goal: {xyz_m: [0, -0.3, 0.05], rpy_deg: [180, 0, 0]}
      frames: {below: {xyz_m: [0, 0, -0.05], rpy_deg: [180, 0, 0]}}
      mass_kg: 0.3
  processes:
    inspect: {duration: {kind: fixed, value_s: 2}, frame: camera}
    dwell: {duration: {kind: fixed, value_s: 5}, frame: camera}
  steps:
    - block
    - {process: inspect, at: {part: block, frame: below}, name: look}
    - {process: dwell, at: {part: block, frame: below}, after: [look]}
"""
    tpg = done(tmp_path, cell("fingers") + text)
    assert len(robots_of(tpg, "inspect")) == len(robots_of(tpg, "dwell")) == 1
    last = [h for task in tpg.tasks for h in task.handlings if h.holder is None][-1]
    np.testing.assert_allclose(last.pose[:3, 2], [0, 0, -1], atol=1e-6)


def sketchy(folder: Path) -> None:
    """Write meshes as odd programs do: text STL with a hole in it, OBJ of quads in inches."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=24)
    cut = ball.submesh([np.arange(len(ball.faces) - 3)], append=True)
    (folder / "ball.stl").write_text(trimesh.exchange.stl.export_stl_ascii(cut))
    corners = [(x, y, z) for z in (0, 2) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    quads = ("4 3 2 1", "5 6 7 8", "1 2 6 5", "2 3 7 6", "3 4 8 7", "4 1 5 8")
    lines = ["# inches", "o post", "s off", "usemtl none"]
    lines += [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {quad}" for quad in quads]
    (folder / "post.obj").write_text("\n".join(lines) + "\n")


@pytest.mark.expensive
def test_meshes_of_odd_programs_are_built_with(tmp_path: Path) -> None:
    sketchy(tmp_path)
    text = """\
assembly:
  kind: assembly
  balance: {check: false}
  parts:
    - {name: post, shape: {mesh: post.obj, scale: 0.0254}, start: {xyz_m: [-0.1, 0.3, 0]}, goal: {xyz_m: [-0.1, -0.3, 0]}, mass_kg: 0.1}
    - {name: ball, shape: {mesh: ball.stl, scale: 0.001}, start: {xyz_m: [0.1, 0.3, 0.0245]}, goal: {xyz_m: [0.1, -0.3, 0.0245]}, mass_kg: 0.1}
  steps: [post, ball]
"""
    tpg = done(tmp_path, cell("fingers") + text)
    assert len(robots_of(tpg, "place-down")) == 2
