"""Payloads against what tool and part weigh together, and masses that nobody tells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planning.cell.shape import Box, Cylinder, Element
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.descriptions.urdf_file import GivenLimits
from planning.robots.registry import robot_model
from planning.transforms import translation
from tests.planning.robots.descriptions.vendors import GRIPPER
from tests.planted import planted
from tests.twin.check.test_tools import CELL
from twin.check.finding import Subject
from twin.check.robots import check_payloads
from twin.scenario.document.validation import InvalidScenarioError
from twin.scenario.manifest import load_scenario, read_scenario
from twin.scenario.sections.scenario import resolved, restored

WEIGHED = GRIPPER.replace(
    '<link name="palm">',
    '<link name="palm"><inertial><origin xyz="0 0 0.04"/><mass value="0.3"/>'
    '<inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>',
).replace(
    '<link name="left">',
    '<link name="left"><inertial><mass value="0.06"/>'
    '<inertia ixx="0.0001" iyy="0.0001" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial>',
)
"""The gripper with masses that add up to 0.36 kg."""

TOO = planted(r"""
what                             | old             | new             | says                                                                          | level
tool alone                       | payload_kg: 3   | payload_kg: 0.1 | the tool hand of arm weighs 0.5 kg, and arm may carry 0.1 kg with it           | warning
tool of its description          | ", mass_kg: 0.5" | ""             | the tool hand of arm weighs 0.36 kg, and arm may carry 0.1 kg with it          | warning
tool and part                    | mass_kg: 1}     | mass_kg: 2.6}   | a weighs 2.6 kg, which no robot carries beside its tool (arm 2.5 kg;           | error
tool and a part by its density   | mass_kg: 1}     | density_kg_m3: 40000} | a weighs 3.84 kg, which no robot carries beside its tool (arm 2.5 kg;    | error
part without mass                | ", mass_kg: 1}" | "}"             | a has no mass, so that of what arm may carry (limits.payload_kg) the tool alone counts: give mass_kg, or density_kg_m3 | warning
part of 0 kg                     | mass_kg: 1}     | mass_kg: 0}     | a has no mass                                                                 | warning
tool without mass                | ", mass_kg: 0.5" | ""             | hand has no mass, so that of the 3 kg that arm may carry                       | warning
""")


def said(folder: Path, text: str, hand: str = GRIPPER) -> list[tuple[str, bool]]:
    (folder / "hand.urdf").write_text(hand)
    file = folder / "cell.yaml"
    file.write_text(text.replace("ARM", "ur5e"))
    scenario, _ = read_scenario(file)
    found = check_payloads(Subject(scenario, folder))
    return [(item.message, item.error) for item in found]


@pytest.mark.parametrize("what", TOO)
def test_masses_that_cannot_be_are_told(what: str, tmp_path: Path) -> None:
    old, new, words, level = TOO[what]
    assert old in CELL
    text = CELL.replace(old, new, 1)
    hand = GRIPPER
    if what == "tool of its description":
        text, hand = text.replace("payload_kg: 3", "payload_kg: 0.1"), WEIGHED
    found = said(tmp_path, text, hand)
    assert any(words in m and bad == (level == "error") for m, bad in found), found


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("payload_kg: 3", "payload_kg: 1.5"),
        ("mass_kg: 1}", "mass_kg: 2.5}"),
        ("mass_kg: 1}", "density_kg_m3: 7850}"),
        (", limits: {payload_kg: 3}", ""),
    ],
)
def test_what_a_robot_carries_is_no_word_worth(
    old: str, new: str, tmp_path: Path
) -> None:
    assert old in CELL
    assert said(tmp_path, CELL.replace(old, new, 1)) == []


def test_without_a_payload_in_the_scenario_masses_may_be_left_out(
    tmp_path: Path,
) -> None:
    """The UR5e's maker tells its payload: a cell that says nothing of masses is none that is wrong."""
    text = CELL.replace(", limits: {payload_kg: 3}", "").replace(", mass_kg: 0.5", "")
    assert said(tmp_path, text.replace(", mass_kg: 1}", "}")) == []


def test_a_part_that_who_may_place_it_cannot_carry_is_refused(tmp_path: Path) -> None:
    other = "    - {name: weak, model: ARM, tool: hand, base: {xyz_m: [1, 0, 0]}, limits: {payload_kg: 1}}\n"
    text = CELL.replace("  fixtures:\n", f"{other}  fixtures:\n")
    assert said(tmp_path, text) == []
    own = text.replace("steps: [a]", "steps: [{place: a, robots: [weak]}]")
    ((words, error),) = said(tmp_path, own)
    assert error
    assert "a weighs 1 kg, which no robot that may place it carries" in words
    assert "(weak 0.5 kg;" in words


@pytest.mark.parametrize("shapes", [False, True])
@pytest.mark.parametrize("hand", [GRIPPER, WEIGHED])
def test_a_tool_weighs_what_the_scenario_says(
    hand: str, shapes: bool, tmp_path: Path
) -> None:
    """Its links keep their shares; a tool of shapes has it where these are."""
    path = tmp_path / "hand.urdf"
    path.write_text(hand)
    forms = (
        Element(Box((0.06, 0.06, 0.1)), translation(0.0, 0.0, 0.05)),
        Element(Cylinder(0.01, 0.1), translation(0.0, 0.0, 0.15)),
    )
    one = {"shapes": forms} if shapes else {"description": path}
    bare = robot_model("ur5e", None, Fitting(limits=GivenLimits(payload=5.0)))
    tool = Tool(name="hand", tcp=translation(0.0, 0.0, 0.2), mass=0.9, **one)  # type: ignore[arg-type]
    model = robot_model(
        "ur5e", None, Fitting(tool=tool, limits=GivenLimits(payload=5.0))
    )
    assert model.drives is not None
    assert bare.drives is not None
    assert bare.inertias is not None
    assert model.inertias is not None
    assert model.drives.tool_mass == pytest.approx(0.9)
    assert model.drives.spare == pytest.approx(4.1)
    gained = model.inertias.mass[-1] - bare.inertias.mass[-1]
    assert gained == pytest.approx(0.9)
    # In the frame of the last joint: where it was, and where the tool is.
    whole = model.inertias.mass[-1] * model.inertias.centre[-1]
    centre = (whole - bare.inertias.mass[-1] * bare.inertias.centre[-1]) / gained
    ahead = (np.linalg.inv(model.flange) @ np.append(centre, 1.0))[2]
    assert 0.03 < ahead < 0.12


def test_a_density_stays_what_it_is_in_a_manifest(tmp_path: Path) -> None:
    (tmp_path / "hand.urdf").write_text(GRIPPER)
    file = tmp_path / "cell.yaml"
    text = CELL.replace("ARM", "ur5e").replace("mass_kg: 1}", "density_kg_m3: 500}")
    file.write_text(text)
    scenario = load_scenario(file)
    assert restored(resolved(scenario)) == scenario
    assert Subject(scenario, tmp_path).cell.object("a").mass == pytest.approx(0.048)
    file.write_text(
        text.replace("density_kg_m3: 500}", "density_kg_m3: 500, mass_kg: 1}")
    )
    with pytest.raises(
        InvalidScenarioError, match="give mass_kg or density_kg_m3, not both"
    ):
        load_scenario(file)
