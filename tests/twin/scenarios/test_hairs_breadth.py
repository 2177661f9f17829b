"""Absurd cells, each beside a sane neighbour that is a hair's breadth away: told, or no word at all.

One bench with two arms: grips that hold nothing, parts in each other, joints across air, loads that
nobody carries, work that happens nowhere, and plans in which parts jump.

Plans of shipped scenarios that were changed by hand are not called safe.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from planning.transforms import Transform, from_rpy, translation
from scheduling.graph.plan_files import load_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.verify import verify_plan
from tests.shipped_runs import ShippedRuns
from tests.twin.scenarios.executed import built
from tests.twin.written import Change, checked, written

CELL = """\
version: 1
name: bench
cell:
  tools:
    jaws:
      shapes:
        - {box: [0.06, 0.14, 0.05], pose: {xyz_m: [0, 0, 0.025]}}
        - {box: [0.02, 0.012, 0.09], pose: {xyz_m: [0, 0.046, 0.095]}}
        - {box: [0.02, 0.012, 0.09], pose: {xyz_m: [0, -0.046, 0.095]}}
      tcp: {xyz_m: [0, 0, 0.13]}
      opening_m: 0.08
      mass_kg: 0.9
    cup:
      shapes: [{cylinder: {radius_m: 0.015, length_m: 0.12}, pose: {xyz_m: [0, 0, 0.06]}}]
      tcp: {xyz_m: [0, 0, 0.12]}
      frames: {bit: {xyz_m: [0, 0, 0.12]}}
      suction: true
      mass_kg: 0.4
  robots:
    - {name: west, model: ur5e, tool: jaws, base: {xyz_m: [-0.55, 0, 0]}, home_deg: [0, -100, 110, -100, -90, 0], limits: {payload_kg: 5}}
    - {name: east, model: ur5e, tool: jaws, base: {xyz_m: [0.55, 0, 0], rpy_deg: [0, 0, 180]}, home_deg: [0, -100, 110, -100, -90, 0], limits: {payload_kg: 5}}
  fixtures:
    - {name: bench, size_m: [1.6, 1.4, 0.05], pose: {xyz_m: [0, 0, -0.025]}}
    - {name: wall, size_m: [0.3, 0.03, 0.4], pose: {xyz_m: [0, 0.6, 0.2]}}
    - {name: anvil, size_m: [0.16, 0.16, 0.04], pose: {xyz_m: [0.0, 0.28, 0.02]}}
assembly:
  kind: assembly
  grips: {depth_m: 0.02}
  parts:
    - {name: block, size_m: [0.06, 0.06, 0.08], start: {xyz_m: [-0.25, -0.3, 0.04]}, goal: {xyz_m: [0, -0.1, 0.04]}, mass_kg: 0.8}
    - {name: bar, size_m: [0.2, 0.04, 0.04], start: {xyz_m: [0.25, -0.3, 0.02]}, goal: {xyz_m: [0, -0.1, 0.1]}, mass_kg: 0.9, frames: {top: {xyz_m: [0, 0, 0.02]}}}
    - {name: puck, shape: {cylinder: {radius_m: 0.025, length_m: 0.06}}, start: {xyz_m: [0.0, -0.4, 0.03]}, goal: {xyz_m: [0.15, 0.1, 0.03]}, mass_kg: 0.3}
  machines: {oven: {fixtures: [anvil]}}
  processes:
    tap: {duration: {kind: fixed, value_s: 2}, frame: tool}
    bake: {duration: {kind: fixed, value_s: 20}, machine: oven}
  steps:
    - block
    - bar
    - {place: puck, at: {fixture: anvil, pose: {xyz_m: [0, 0, 0.05]}}}
    - {process: bake, at: {part: puck}}
    - puck
    - {process: tap, at: {part: bar, frame: top}}
  joined: [[block, bar]]
planning: {speed_model: joint}
execution:
  skills: {pick: {kind: fixed, value_s: 2}, place-down: {kind: fixed, value_s: 2}}
"""

CUPS: tuple[Change, ...] = (
    ("tool: jaws", "tool: cup"),
    ("grips: {depth_m: 0.02}", "grips: {positions: 1}"),
)
"""Both arms have cups."""

PEG: tuple[Change, ...] = (
    (
        "puck, shape: {cylinder: {radius_m: 0.025, length_m: 0.06}}",
        "puck, shape: {cylinder: {radius_m: 0.012, length_m: 0.06}}",
    ),
    (
        "  fixtures:\n",
        "  fixtures:\n    - {name: collar, shape: {mesh: collar.stl, within_m: 0.0005}, pose: {xyz_m: [0.15, 0.1, 0.015]}}\n",
    ),
)
"""The puck is a peg of 12 mm radius that goes into a collar with a bore of 12.2 mm."""

RACKS: tuple[Change, ...] = (
    (
        "    - {name: east, model: ur5e, tool: jaws",
        "    - {name: east, model: ur5e, tools: [cup, pin]",
    ),
    (
        "    cup:\n",
        "    pin: {shapes: [{cylinder: {radius_m: 0.01, length_m: 0.12}, pose: {xyz_m: [0, 0, 0.06]}}], tcp: {xyz_m: [0, 0, 0.12]}, suction: true, mass_kg: 0.3, rack: {xyz_m: [0.45, 0.35, 0.1205], rpy_deg: [180, 0, 0]}}\n    cup:\n",
    ),
    (
        "      frames: {bit: {xyz_m: [0, 0, 0.12]}}\n",
        "      rack: {xyz_m: [0.6, 0.35, 0.1205], rpy_deg: [180, 0, 0]}\n",
    ),
)
"""One arm changes between a cup and a pin."""


@dataclass(frozen=True)
class Pair:
    """An absurd cell and its sane neighbour.

    Attributes:
        what: is absurd.
        says: words of what is told of it.
        old: what stands in the cell.
        absurd, sane: what is written in its place.
        besides: what else is changed in both.
    """

    what: str
    says: str
    old: str
    absurd: str
    sane: str
    besides: tuple[Change, ...] = ()


PAIRS = (
    # Grips that hold nothing.
    Pair("a tool frame 60 mm beyond the tips", "its tcp lies 60.0 mm beyond their tips", "tcp: {xyz_m: [0, 0, 0.13]}", "tcp: {xyz_m: [0, 0, 0.2]}", "tcp: {xyz_m: [0, 0, 0.139]}"),
    Pair("a tool frame 25 mm beyond the tips", "5.0 mm short of (depth) block", "tcp: {xyz_m: [0, 0, 0.13]}", "tcp: {xyz_m: [0, 0, 0.165]}", "tcp: {xyz_m: [0, 0, 0.135]}"),
    Pair("a tool frame beside the fingers", "20.0 mm beside (across) block", "tcp: {xyz_m: [0, 0, 0.13]}", "tcp: {xyz_m: [0.06, 0, 0.13]}", "tcp: {xyz_m: [0.004, 0, 0.13]}"),
    Pair("a tool frame off the middle", "block would be 3.0 mm off the middle", "tcp: {xyz_m: [0, 0, 0.13]}", "tcp: {xyz_m: [0, 0.003, 0.13]}", "tcp: {xyz_m: [0, 0.001, 0.13]}"),
    Pair("fingers that close the other way", "nothing of jaws on both sides", "tcp: {xyz_m: [0, 0, 0.13]}", "tcp: {xyz_m: [0, 0, 0.13], rpy_deg: [0, 0, 90]}", "tcp: {xyz_m: [0, 0, 0.13], rpy_deg: [0, 0, 180]}"),
    Pair("one finger alone", "nothing of jaws on both sides", "        - {box: [0.02, 0.012, 0.09], pose: {xyz_m: [0, -0.046, 0.095]}}\n", "", "        - {box: [0.02, 0.012, 0.088], pose: {xyz_m: [0, -0.046, 0.096]}}\n"),
    Pair("fingers of unlike length", "block", "        - {box: [0.02, 0.012, 0.09], pose: {xyz_m: [0, -0.046, 0.095]}}\n", "        - {box: [0.02, 0.012, 0.04], pose: {xyz_m: [0, -0.046, 0.07]}}\n", "        - {box: [0.02, 0.012, 0.08], pose: {xyz_m: [0, -0.046, 0.09]}}\n"),
    Pair("suction by a hand with fingers", "ends 10.0 mm away from block", "opening_m: 0.08", "suction: true", "opening_m: 0.081"),
    Pair("a cup whose frame is before it", "cup", "tcp: {xyz_m: [0, 0, 0.12]}\n      frames", "tcp: {xyz_m: [0, 0, 0.125]}\n      frames", "tcp: {xyz_m: [0, 0, 0.1205]}\n      frames", CUPS),
    Pair("a cup beside its frame", "cup", "tcp: {xyz_m: [0, 0, 0.12]}\n      frames", "tcp: {xyz_m: [0.05, 0, 0.12]}\n      frames", "tcp: {xyz_m: [0.005, 0, 0.12]}\n      frames", CUPS),
    # Parts in each other.
    Pair("a block in the bar", "would overlap by 1.5 mm", "[0, -0.1, 0.1]}, mass", "[0, -0.1, 0.0985]}, mass", "[0, -0.1, 0.099995]}, mass"),
    Pair("a puck in the anvil", "would overlap by 1.2 mm", "pose: {xyz_m: [0, 0, 0.05]}", "pose: {xyz_m: [0, 0, 0.0488]}", "pose: {xyz_m: [0, 0, 0.049995]}"),
    Pair("a bar that lies in the bench", "overlap by 1.0 mm at the start", "[0.25, -0.3, 0.02]}", "[0.25, -0.3, 0.019]}", "[0.25, -0.3, 0.019995]}"),
    Pair("a puck a tenth in the bench", "would overlap by 0.1 mm", "[0.15, 0.1, 0.03]}", "[0.15, 0.1, 0.0299]}", "[0.15, 0.1, 0.029995]}"),
    Pair("a block that stands in the bench", "would overlap by 0.5 mm", "[0, -0.1, 0.04]}", "[0, -0.1, 0.0395]}", "[0, -0.1, 0.040005]}"),
    Pair("a peg too thick for its bore", "puck goes where collar stands", "radius_m: 0.012,", "radius_m: 0.0135,", "radius_m: 0.0122,", PEG),
    Pair("a peg beside its bore", "puck goes where collar stands", "[0.15, 0.1, 0.03]}", "[0.1515, 0.1, 0.03]}", "[0.15015, 0.1, 0.03]}", PEG),
    Pair("a press that is more than is said", "would overlap by", "  steps:\n", "  fits: [{parts: [puck, collar], press_m: 0.00005}]\n  steps:\n", "  fits: [{parts: [puck, collar], press_m: 0.0001}]\n  steps:\n", (*PEG, ("radius_m: 0.012,", "radius_m: 0.0123,"))),
    Pair("bores that are too tight for two", "would overlap by", "radius_m: 0.012,", "radius_m: 0.01225,", "radius_m: 0.012205,", PEG),
    Pair("a puck in the wall", "would overlap by", "[0.15, 0.1, 0.03]}", "[0.1, 0.562, 0.03]}", "[0.1, 0.56, 0.03]}"),
    Pair("a bar through the puck", "overlap by", "[0.25, -0.3, 0.02]}", "[0.1, -0.375, 0.02]}", "[0.105, -0.35, 0.02]}"),
    Pair("parts that lie in each other", "at the start", "[-0.25, -0.3, 0.04]}", "[-0.054, -0.4, 0.04]}", "[-0.056, -0.4, 0.04]}"),
    Pair("a wall in the bench", "fixtures bench and wall overlap by 20.0 mm", "pose: {xyz_m: [0, 0.6, 0.2]}", "pose: {xyz_m: [0, 0.6, 0.18]}", "pose: {xyz_m: [0, 0.6, 0.2]}"),
    Pair("a bar that hangs at the start", "bar hangs in the air at the start", "[0.25, -0.3, 0.02]}", "[0.25, -0.3, 0.05]}", "[0.25, -0.3, 0.0215]}"),
    Pair("a puck that is let go in the air", "puck would be left in the air", "[0.15, 0.1, 0.03]}", "[0.15, 0.1, 0.04]}", "[0.15, 0.1, 0.0315]}"),
    # Joints across air.
    Pair("joined across 40 mm", "joined across 40.0 mm of air", "[0, -0.1, 0.1]}, mass", "[0, -0.1, 0.14]}, mass", "[0, -0.1, 0.1015]}, mass"),
    Pair("joined beside, across 25 mm", "joined across 25.0 mm of air", "[0, -0.1, 0.1]}, mass", "[0.155, -0.1, 0.02]}, mass", "[0.1315, -0.1, 0.02]}, mass"),
    Pair("joined across 3 mm", "joined across 3.0 mm of air", "[0, -0.1, 0.1]}, mass", "[0.133, -0.1, 0.02]}, mass", "[0.1318, -0.1, 0.02]}, mass"),
    Pair("joined to a wall far away", "bar and wall are joined across 665.0 mm", "joined: [[block, bar]]", "joined: [[block, bar], [bar, wall]]", "joined: [[block, bar], [block, bench]]"),
    Pair("joined to a wall by nothing", "puck and wall are joined across 460.0 mm", "joined: [[block, bar]]", "joined: [[block, bar], [puck, wall]]", "joined: [[block, bar], {parts: [puck, wall], gap_m: 0.4585}]"),
    Pair("a clip that is too short", "across 665.0 mm of air, and may be 602 mm apart", "joined: [[block, bar]]", "joined: [[block, bar], {parts: [bar, wall], gap_m: 0.6}]", "joined: [[block, bar], {parts: [bar, wall], gap_m: 0.6635}]"),
    Pair("a clip a hair too short", "across 665.0 mm of air, and may be 664 mm apart", "joined: [[block, bar]]", "joined: [[block, bar], {parts: [bar, wall], gap_m: 0.662}]", "joined: [[block, bar], {parts: [bar, wall], gap_m: 0.6632}]"),
    Pair("joined across the bench", "block and puck are joined across 183.0 mm", "joined: [[block, bar]]", "joined: [[block, bar], [block, puck]]", "joined: [[block, bar], [bench, puck]]"),
    Pair("joined to an anvil elsewhere", "bar and anvil are joined across", "joined: [[block, bar]]", "joined: [[block, bar], [bar, anvil]]", "joined: [[block, bar], {parts: [bar, anvil], gap_m: 0.29}]"),
    # Loads that nobody carries.
    Pair("a payload below the tool", "weighs 0.9 kg, and west may carry 0.5 kg with it", "limits: {payload_kg: 5}}\n    - {name: east", "limits: {payload_kg: 0.5}}\n    - {name: east", "limits: {payload_kg: 1.9}}\n    - {name: east"),
    Pair("a tool above the payload", "weighs 6 kg, and west may carry 5 kg with it", "mass_kg: 0.9\n    cup", "mass_kg: 6\n    cup", "mass_kg: 4\n    cup"),
    Pair("a part that nobody lifts", "bar weighs 4.2 kg, which no robot carries", "mass_kg: 0.9, frames", "mass_kg: 4.2, frames", "mass_kg: 4.1, frames"),
    Pair("a part of too dense a stuff", "puck weighs 4.71", "mass_kg: 0.3}", "density_kg_m3: 40000}", "density_kg_m3: 11340}"),
    Pair("a centre of mass outside the part", "the centre of mass of block is 20.0 mm outside it", ", mass_kg: 0.8}", ", mass_kg: 0.8, centre_of_mass_m: [0, 0, 0.06]}", ", mass_kg: 0.8, centre_of_mass_m: [0, 0, 0.0395]}"),
    Pair("a tool without a mass", "jaws has no mass", "opening_m: 0.08\n      mass_kg: 0.9", "opening_m: 0.08", "opening_m: 0.08\n      mass_kg: 0.3"),
    Pair("a part without a mass", "block has no mass", ", mass_kg: 0.8}", "}", ", density_kg_m3: 800}"),
    Pair("the one who may do it cannot lift it", "bar weighs 0.9 kg", "    - bar\n", "    - {place: bar, robots: [west]}\n", "    - {place: bar, robots: [east]}\n", (("limits: {payload_kg: 5}}\n    - {name: east", "limits: {payload_kg: 1.7}}\n    - {name: east"),)),
    # Work that happens nowhere, or in no time.
    Pair("baked in the air", "in the air", "{place: puck, at: {fixture: anvil, pose: {xyz_m: [0, 0, 0.05]}}}", "{place: puck, at: {fixture: anvil, pose: {xyz_m: [0, 0, 0.3]}}}", "{place: puck, at: {fixture: anvil, pose: {xyz_m: [0, 0, 0.0502]}}}"),
    Pair("baked on the bench", "which lies on none of its fixtures", "{place: puck, at: {fixture: anvil, pose: {xyz_m: [0, 0, 0.05]}}}", "{place: puck, at: {fixture: bench, pose: {xyz_m: [0.3, 0.1, 0.055]}}}", "{place: puck, at: {fixture: anvil, pose: {xyz_m: [0.07, 0, 0.05]}}}"),
    Pair("an oven of the wall", "which lies on none of its fixtures", "oven: {fixtures: [anvil]}", "oven: {fixtures: [wall]}", "oven: {fixtures: [anvil, wall]}"),
    Pair("an oven whose door is elsewhere", "m away from its door", "oven: {fixtures: [anvil]}", "oven: {door: {size_m: [0.3, 0.3, 0.02], pose: {xyz_m: [0, 0.28, 1.2]}}}", "oven: {door: {size_m: [0.3, 0.3, 0.02], pose: {xyz_m: [0, 0.28, 0.3]}}}"),
    Pair("an oven that nothing is brought to", "no step brings it to the machine", "oven: {fixtures: [anvil]}", "oven: {}", "oven: {fixtures: [bench]}", (("    - {place: puck, at: {fixture: anvil, pose: {xyz_m: [0, 0, 0.05]}}}\n", ""),)),
    Pair("tapped above the bar", "stays 53.9 mm away from bar", "top: {xyz_m: [0, 0, 0.02]}", "top: {xyz_m: [0, 0, 0.08]}", "top: {xyz_m: [0, 0, 0.03]}"),
    Pair("tapped beside the bar", "away from bar", "top: {xyz_m: [0, 0, 0.02]}", "top: {xyz_m: [0, 0.2, 0.02]}", "top: {xyz_m: [0.09, 0, 0.02]}"),
    Pair("tapped along a way in the air", "stays 44.7 mm away", "frame: tool}", "frame: tool, path: [{xyz_m: [0, 0, 0.05]}, {xyz_m: [0.05, 0, 0.05]}]}", "frame: tool, path: [{xyz_m: [0, 0, 0]}, {xyz_m: [0.05, 0, 0]}]}"),
    Pair("a camera farther than it says", "at most 70.0 mm is what a tool distance_m 0.05 says", "frame: tool}", "frame: tool, distance_m: 0.05, path: [{xyz_m: [0, 0, 0.15]}]}", "frame: tool, distance_m: 0.05, path: [{xyz_m: [0, 0, 0.06]}]}"),
    Pair("a rack in the air", "hangs in the air", "0.35, 0.1205], rpy_deg: [180, 0, 0]}\n", "0.35, 0.4], rpy_deg: [180, 0, 0]}\n", "0.35, 0.1215], rpy_deg: [180, 0, 0]}\n", RACKS),
    Pair("nothing takes time", "takes 0 s", "value_s: 2}, place-down: {kind: fixed, value_s: 2}", "value_s: 0}, place-down: {kind: fixed, value_s: 0}", "value_s: 0}, place-down: {kind: fixed, value_s: 1}", (("kind: fixed, value_s: 2}, frame", "kind: fixed, value_s: 0}, frame"), ("value_s: 20}", "value_s: 0}"),)),
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the collar."""
    out = tmp_path_factory.mktemp("bench")
    trimesh.creation.annulus(0.0122, 0.03, 0.03, sections=64).export(out / "collar.stl")
    return out


def told(folder: Path, *changes: Change) -> list[str]:
    return [item.message for item in checked(written(folder, CELL, *changes)).findings]


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.what)
def test_what_cannot_be_is_told_and_its_neighbour_is_not(
    pair: Pair, folder: Path
) -> None:
    found = told(folder, *pair.besides, (pair.old, pair.absurd))
    assert any(pair.says in message for message in found), found
    assert told(folder, *pair.besides, (pair.old, pair.sane)) == []


@pytest.fixture(scope="module")
def plan(folder: Path) -> TemporalPlanGraph:
    """The plan of the bench, once check, proof and audit are content."""
    return built(folder, CELL).tpg


Edit = Callable[[TemporalPlanGraph, float], TemporalPlanGraph]


def moved(kind: str, by: Callable[[float], Transform]) -> Edit:
    """Return an edit that moves the part in the last handling of a kind of task."""

    def edit(tpg: TemporalPlanGraph, size: float) -> TemporalPlanGraph:
        kinds = [
            tpg.tasks[int(tpg.chains[h.robot].task[h.node])].kind for h in tpg.handlings
        ]
        last = int(np.flatnonzero(np.array(kinds) == kind)[-1])
        return with_part_moved(tpg, last, by(size))

    return edit


def bent(tpg: TemporalPlanGraph, size: float) -> TemporalPlanGraph:
    """Turn a joint in the middle of a robot's longest motion."""
    chain = tpg.chains[0]
    node = int(np.argmax(np.diff(chain.first)))
    waypoints = chain.waypoints.copy()
    waypoints[(chain.first[node] + chain.first[node + 1]) // 2, 1] += size
    return replace(tpg, chains=(replace(chain, waypoints=waypoints), *tpg.chains[1:]))


EDITS: dict[str, tuple[Edit, float]] = {
    "picked beside": (moved("pick", lambda s: translation(s, 0.0, 0.0)), 0.02),
    "picked below": (moved("pick", lambda s: translation(0.0, 0.0, -s)), 0.005),
    "picked askew": (moved("pick", lambda s: from_rpy((0, 0, 0), (0, 0, s))), 0.1),
    "put down beside": (moved("place-down", lambda s: translation(0.0, s, 0.0)), 0.002),
    "put down above": (moved("place-down", lambda s: translation(0.0, 0.0, s)), 0.02),
    "bent on the way": (bent, 0.3),
    "put down askew": (
        moved("place-down", lambda s: from_rpy((0, 0, 0), (s, 0, 0))),
        0.05,
    ),
}
"""What is changed in a plan, and by how much [m or rad]."""


@pytest.mark.parametrize("what", EDITS)
def test_a_plan_in_which_something_jumps_is_not_safe(
    what: str, plan: TemporalPlanGraph
) -> None:
    edit, size = EDITS[what]
    assert verify_plan(edit(plan, size), limit=1).problems != ()
    assert verify_plan(edit(plan, 1e-8), limit=1).problems == ()


def with_part_moved(tpg: TemporalPlanGraph, k: int, by: Transform) -> TemporalPlanGraph:
    """Move what changes hands in the k-th handling, in the task as in the node."""
    h = tpg.handlings[k]
    pose = h.pose @ by
    index = int(tpg.chains[h.robot].task[h.node])
    handlings, tasks = list(tpg.handlings), list(tpg.tasks)
    handlings[k] = replace(h, pose=pose)
    said = tuple(
        replace(s, pose=pose) if (s.object, s.holder) == (h.object, h.holder) else s
        for s in tasks[index].handlings
    )
    tasks[index] = replace(tasks[index], handlings=said)
    return replace(tpg, handlings=tuple(handlings), tasks=tuple(tasks))


@pytest.mark.parametrize(
    ("name", "robots", "kinds"),
    [
        ("lego/cliff", None, ["pick", "place-down", "place-up", "handover"]),
        pytest.param(
            *("assembly/taskboard", None, ["pick", "place-down"]),
            marks=pytest.mark.nightly,
        ),
        ("multi_arm/tray", None, ["pick", "place-down"]),
        ("construction/tower", 2, ["pick", "place-down"]),
    ],
)
def test_parts_that_are_moved_as_they_change_hands_are_found(
    shipped: ShippedRuns, name: str, robots: int | None, kinds: list[str]
) -> None:
    tpg = load_plan(shipped(name, robots).trial.files)
    kind = [
        tpg.tasks[int(tpg.chains[h.robot].task[h.node])].kind for h in tpg.handlings
    ]
    for wanted in kinds:
        own = [k for k, found in enumerate(kind) if found == wanted]
        for k in sorted({own[0], own[-1]}):
            moved = with_part_moved(tpg, k, translation(0.0, 0.02, 0.0))
            (problem,) = verify_plan(moved, limit=1).problems
            assert problem.kind == "jump"
            assert "20.00 mm away from where" in problem.message
