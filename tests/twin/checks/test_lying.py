"""Processes far from their work, machines that stand nowhere, meshes with holes, what takes no time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planning.cell.shape import Element, Mesh, shape_of
from tests.planning.robots.descriptions.vendors import GRIPPER
from tests.planted import planted
from tests.twin.written import Change, checked, refusal, written
from twin.checks.finding import CheckContext, Finding
from twin.checks.meshes import check_meshes
from twin.reading.scenario_file import load_scenario

CELL = """\
version: 1
name: work
cell:
  tools:
    cup: {shapes: [{cylinder: {radius_m: 0.012, length_m: 0.1}, pose: {xyz_m: [0, 0, 0.05]}}], tcp: {xyz_m: [0, 0, 0.1]}, frames: {driver: {xyz_m: [0, 0, 0.1]}}, suction: true}
    hand: {description: hand.urdf, joints: {squeeze: 0.03}, opening_m: 0.08}
    bellows: {description: bellows.urdf, suction: true}
  robots:
    - name: arm
      model: ur5e
      tool: cup
      base: {xyz_m: [-0.5, 0, 0]}
      home_deg: [0, -100, 110, -100, -90, 0]
  fixtures:
    - {name: table, size_m: [2, 2, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
    - {name: vise, size_m: [0.2, 0.1, 0.05], pose: {xyz_m: [0, 0.2, 0.025]}}
assembly:
  kind: assembly
  grips: {positions: 1, depth_m: 0.012}
  parts:
    - name: a
      size_m: [0.08, 0.03, 0.03]
      start: {xyz_m: [-0.1, -0.3, 0.0155]}
      goal: {xyz_m: [0, -0.1, 0.0155]}
      frames: {top: {xyz_m: [0, 0, 0.015]}}
    - name: b
      size_m: [0.08, 0.03, 0.03]
      start: {xyz_m: [0.1, -0.3, 0.0155]}
      goal: {xyz_m: [0.05, 0.45, 0.0155]}
  machines: {mill: {}}
  processes:
    screw: {duration: {kind: fixed, value_s: 1}, frame: driver}
    milling: {duration: {kind: fixed, value_s: 5}, machine: mill}
  steps:
    - {place: a, at: {fixture: vise, pose: {xyz_m: [0, 0, 0.041]}}}
    - {process: milling, at: {part: a}}
    - a
    - b
    - {process: screw, at: {part: a, frame: top}}
planning: {speed_model: joint}
execution:
  skills:
    pick: {kind: fixed, value_s: 2}
    place-down: {kind: fixed, value_s: 2}
"""

BELLOWS = """<robot name="bellows">
  <link name="body"><collision><origin xyz="0 0 0.04"/>
    <geometry><cylinder radius="0.02" length="0.08"/></geometry></collision></link>
  <link name="tip"><collision><geometry><cylinder radius="0.012" length="0.02"/></geometry></collision></link>
  <link name="tcp"/>
  <joint name="yields" type="prismatic"><parent link="body"/><child link="tip"/>
    <origin xyz="0 0 0.09"/><axis xyz="0 0 1"/><limit lower="-0.01" upper="0"/></joint>
  <joint name="end" type="fixed"><parent link="tip"/><child link="tcp"/><origin xyz="0 0 0.01"/></joint>
</robot>"""
"""A cup that yields: one joint, and no fingers."""

ABSURD = planted(r"""
what                       | old                           | new                                | says                                                              | level
place above its part       | top: {xyz_m: [0, 0, 0.015]}   | top: {xyz_m: [0, 0, 0.095]}        | screw a/top: the tool of arm stays 80.0 mm away from a            | warning
frame in front of its tool | driver: {xyz_m: [0, 0, 0.1]}  | driver: {xyz_m: [0, 0, 0.18]}      | screw a/top: the tool of arm stays 80.0 mm                           | warning
path above its part        | value_s: 1}, frame: driver}   | "value_s: 1}, frame: driver, path: [{xyz_m: [0, 0, 0.06]}, {xyz_m: [0.02, 0, 0.06]}]}" | the tool of arm stays 60.0 mm | warning
place in mid-air           | at: {part: a, frame: top}}    | at: {pose: {xyz_m: [0, 0, 0.4]}}}  | the nearest that it could work at, and at most 20.0 mm            | warning
farther than it says       | value_s: 1}, frame: driver}   | "value_s: 1}, frame: driver, distance_m: 0.02, path: [{xyz_m: [0, 0, 0.06]}]}" | at most 40.0 mm is what a tool distance_m 0.02 says | warning
elsewhere than its machine | mill: {}                      | mill: {fixtures: [table]}          | mill works at a, which lies on none of its fixtures by then: table is 51.0 mm away | error
part left where it lay     | "at: {part: a}}\n    - a"     | "at: {part: b}}\n    - a"          | mill works at b where that lies at the start                      | warning
worked at before it comes  | "    - {place: a, at: {fixture: vise, pose: {xyz_m: [0, 0, 0.041]}}}\n" | "" | mill works at a where that lies at the start            | warning
machine in two places      | "    - b\n"                   | "    - b\n    - {process: milling, at: {part: b}}\n" | mill works at b 0.95 m away from where it worked before, at (0.00, 0.20, 0.07) m | warning
door of another room       | mill: {}                      | "mill: {door: {size_m: [0.3, 0.3, 0.02], pose: {xyz_m: [0, 0.9, 0.9]}}}" | m away from its door: machines.mill.fixtures | warning
suction with fingers       | "joints: {squeeze: 0.03}, opening_m: 0.08" | "joints: {squeeze: 0.03}, suction: true" | hand of arm is said to hold by suction (cell.tools.hand.suction), at one face, and its description has 2 joints that move (hand.squeeze, hand.follow) | warning
suction by a hand          | tool: cup                     | "tool: none"                       | its tool of arm is said to hold by suction (assembly.grips.suction) | warning
nothing takes time         | "{kind: fixed, value_s: 2}"   | "{kind: fixed, value_s: 0}"        | all that is done takes 0 s (pick, place-down, screw, milling)     | warning
uniform from 0 to 0        | "{kind: fixed, value_s: 2}"   | "{kind: uniform, low_s: 0, high_s: 0}" | all that is done takes 0 s                                    | warning
""")

SANE = planted(r"""
what                       | old                           | new
nothing                    | version: 1                    | version: 1
a drop's height            | top: {xyz_m: [0, 0, 0.015]}   | top: {xyz_m: [0, 0, 0.025]}
a camera                   | value_s: 1}, frame: driver}   | "value_s: 1}, frame: driver, distance_m: 0.06, path: [{xyz_m: [0, 0, 0.06]}]}"
a path that comes down     | value_s: 1}, frame: driver}   | "value_s: 1}, frame: driver, path: [{xyz_m: [0, 0, 0.06]}, {xyz_m: [0, 0, 0]}]}"
its own fixture            | mill: {}                      | mill: {fixtures: [vise]}
a lid over it              | mill: {}                      | "mill: {door: {size_m: [0.3, 0.3, 0.02], pose: {xyz_m: [0, 0.2, 0.2]}}}"
a machine at the start     | "mill: {}"                    | "mill: {fixtures: [table, vise]}"
a cup that yields          | tool: cup                     | tool: bellows
fingers                    | tool: cup                     | tool: hand
a process of no time       | "screw: {duration: {kind: fixed, value_s: 1}" | "screw: {duration: {kind: fixed, value_s: 0}"
""")


Changes = tuple[Change, ...]
NO_DRIVER: Change = (", frame: driver", "")
NO_TIME: Changes = (("value_s: 1}", "value_s: 0}"), ("value_s: 5}", "value_s: 0}"))
BESIDES: dict[str, Changes] = {
    "suction with fingers": (("tool: cup", "tool: hand"), NO_DRIVER),
    "suction by a hand": (
        ("model: ur5e\n      tool: none\n", "model: panda\n"),
        ("      home_deg: [0, -100, 110, -100, -90, 0]\n", ""),
        ("depth_m: 0.012", "suction: true"),
        NO_DRIVER,
    ),
    "nothing takes time": NO_TIME,
    "uniform from 0 to 0": NO_TIME,
    "machine in two places": (("[0.05, 0.45, 0.0155]", "[0.05, -0.75, 0.0155]"),),
    "a machine at the start": (("at: {part: a}}\n    - a", "at: {part: b}}\n    - a"),),
    "a cup that yields": (NO_DRIVER,),
    "fingers": (NO_DRIVER,),
}
"""What else is changed for a mistake, or for what is none."""


def findings(folder: Path, *changes: Change) -> tuple[Finding, ...]:
    (folder / "hand.urdf").write_text(GRIPPER)
    (folder / "bellows.urdf").write_text(BELLOWS)
    return checked(written(folder, CELL, *changes)).findings


@pytest.mark.parametrize("what", ABSURD)
def test_what_can_hardly_be_is_told(what: str, tmp_path: Path) -> None:
    old, new, words, level = ABSURD[what]
    found = findings(tmp_path, (old, new), *BESIDES.get(what, ()))
    own = [item for item in found if words in item.message]
    assert own, [item.message for item in found]
    assert all(item.error == (level == "error") for item in own)


@pytest.mark.parametrize("what", SANE)
def test_what_may_be_is_no_word_worth(what: str, tmp_path: Path) -> None:
    old, new = SANE[what]
    found = findings(tmp_path, (old, new), *BESIDES.get(what, ()))
    assert [item.message for item in found] == []


def test_a_machine_may_work_at_two_parts_that_are_beside_each_other(
    tmp_path: Path,
) -> None:
    old, new, *_ = ABSURD["machine in two places"]
    found = [item.message for item in findings(tmp_path, (old, new))]
    assert not any("where it worked before" in message for message in found)


def test_a_machine_names_fixtures_that_there_are(tmp_path: Path) -> None:
    said = refusal(tmp_path, CELL, ("mill: {}", "mill: {fixtures: [vice]}"))
    assert "unknown fixture 'vice'; did you mean" in str(said)


def test_a_rack_in_mid_air_is_told(tmp_path: Path) -> None:
    """Of two tools one lies in its rack: on the table no word, half a metre above it one."""
    for height, said in ((0.041, 0), (0.5, 1)):
        rack = f"rack: {{xyz_m: [-0.3, 0.45, {height}], rpy_deg: [180, 0, 0]}}"
        first = "rack: {xyz_m: [-0.7, 0.45, 0.041], rpy_deg: [180, 0, 0]}"
        found = findings(
            tmp_path,
            ("suction: true}\n    hand", f"suction: true, {first}}}\n    hand"),
            ("opening_m: 0.08}", f"opening_m: 0.08, {rack}}}"),
            ("tool: cup", "tools: [cup, hand]"),
            NO_DRIVER,
        )
        hangs = [item for item in found if "hand hangs in the air" in item.message]
        assert len(hangs) == said, found


FILE = Path(__file__).parents[3] / "scenarios" / "assembly" / "shapes.yaml"


def test_what_is_outside_of_all_pieces_is_told() -> None:
    subject = CheckContext(load_scenario(FILE), FILE.parent)
    assert list(check_meshes(subject)) == []
    housing = subject.cell.object("housing")
    form = housing.shape.elements[0].form
    assert isinstance(form, Mesh)
    form = replace(form, missed=0.0012)
    shape = shape_of("housing", [Element(form, np.eye(4))])
    objects = (replace(housing, shape=shape), *subject.cell.objects[1:])
    subject.__dict__["cell"] = replace(subject.cell, objects=objects)
    (found,) = check_meshes(subject)
    assert "housing is up to 1.2 mm outside" in found.message
    assert not found.error
