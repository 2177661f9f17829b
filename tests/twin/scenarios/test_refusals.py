"""What cannot be is said as the file is read: a table of mistakes, one a line."""

from pathlib import Path

import pytest

from tests.planted import rows
from tests.shipped_runs import SCENARIOS
from tests.twin.scenarios.test_construction_scenarios import OWN
from tests.twin.scenarios.test_part_assembly import SCENARIO as CROSSING
from tests.twin.scenarios.test_processes import SCENARIO as COVER
from tests.twin.scenarios.test_storage_plate import SCENARIO as STORED
from tests.twin.scenarios.test_tool_changes import scenario_text
from tests.twin.scenarios.test_trusses import KEPT
from tests.twin.scenarios.test_trusses import SCENARIO as CANTILEVER
from tests.twin.written import refusal

GOALS = SCENARIOS / "multi_arm" / "multi_goal.yaml"
CELLS = {
    "cover": COVER,
    "crossing": CROSSING,
    "cantilever": CANTILEVER,
    "kept": KEPT,
    "changer": scenario_text(["block"]),
    "stored": STORED,
    "construction": OWN,
    "goals": GOALS.read_text(encoding="utf-8"),
}

WRONG = rows(r"""
cell         | old                                    | new                                     | says
cover        | process: seal                          | process: seel                           | unknown process 'seel'; did you mean
cover        | frame: hole1}                          | frame: hole}                            | unknown frame 'hole'; did you mean
cover        | frame: corner}                         | frame: edge}                            | table: unknown frame 'edge' (valid: corner)
cover        | {part: cover, frame: hole2}            | {part: pin, frame: tip}                 | pin has no frames
cover        | fixture: table, f                      | fixture: tabel, f                       | unknown fixture 'tabel'
cover        | {part: cover, frame: hole2}            | {frame: hole2}                          | of which part or fixture
cover        | robots: [right]                        | robots: [wright]                        | unknown robot 'wright'
cover        | after: [cover]                         | after: [pin]                            | pin is listed later, as step 5
cover        | after: [cover]                         | after: [lid]                            | unknown step 'lid'
cover        | place: pin, hold: cover                | place: pin, hold: pin                   | is in the hand of who
cover        | duration: {kind: fixed, value_s: 4}    | approach_m: 0.04                        | Give it a dur
cover        | screw: {duration                       | pick: {duration                         | cannot be called 'pick'
cover        | "    seal:\n"                          | "    seal:\n      tool: gun\n"          | no robot has the tool 'gun'
cover        | at: {fixture: table, frame: corner}    | name: x                                 | where is seal done?
cover        | {process: seal, at                     | {process: seal, att                     | unknown key 'att'
cover        | pick: {kind                            | screwed: {kind                          | unknown skill 'screwed'; did you mean
cover        | "  steps:\n    - cover\n"              | "  order: find\n  steps:\n    - {place: cover, after: [pin]}\n" | cover after pin after first after
crossing     | steps: [south,                         | steps: [sout,                           | south
crossing     | north, across]                         | north, north]                           | already placed in step 2
crossing     | across]                                | bystander]                              | bystander has no goal
crossing     | name: bystander                        | name: north                             | already taken
crossing     | name: bystander                        | name: east                              | is that of a robot
crossing     | kind: assembly                         | kind: assemble                          | assembly
crossing     | positions: 3                           | directions: [[0, 0, 0]]                 | must not be zero
cantilever   | "  steps:"                             | "  joined: [[post, bean]]\n  steps:"    | unknown part or fixture 'bean'
cantilever   | "  steps:"                             | "  joined: [[post, post]]\n  steps:"    | cannot be joined to itself
cantilever   | "  steps:"                             | "  joined: [{parts: [post, beam], by: weld}]\n  steps:" | unknown step 'weld'
cantilever   | "  steps:"                             | "  joined: [[table, table2]]\n  steps:" | table2
cantilever   | "  steps:"                             | "  joined: [[post]]\n  steps:"          | 2
kept         | "    - beam\n"                         | "    - {place: beam, until: nect}\n"    | unknown step 'nect'
kept         | "    - beam\n"                         | "    - {place: beam, until: post}\n"    | post is listed before
kept         | "    - beam\n"                         | "    - {place: beam, until: beam}\n"    | beam is this step
kept         | name: neck}                            | name: neck, until: cap}                 | until is of a step that places
changer      | tools: [gripper, driver, nozzle]       | tools: [gripper, drivver]               | did you mean
changer      | tools: [gripper, driver, nozzle]       | tools: [gripper]                        | two or more
changer      | model: ur5e, tools                     | model: ur5e, tool: driver, tools        | give tool or tools
changer      | model: ur5e, tools                     | model: ur5e, flange: nowhere, tools     | 'nowhere' is no link
changer      | rpy_deg: [180, 0, 0], change_s: 3}      | rpy_deg: [180, 0, 0], quat_wxyz: [1, 0, 0, 0]} | give rpy_deg or quat_wxyz, not both
changer      | , change_s: 3}                         | , change_s: 3, change: {kind: fixed, value_s: 1}} | not both
changer      | "      rack: {xyz_m: [-0.2, 0.3, 0.2], rpy_deg: [180, 0, 0], change_s: 3}\n" | ""                | driver has no rack: give cell.tools.driver.rack
changer      | "  fixtures:\n"                        | "    - {name: other, model: ur5e, tool: driver, base: {xyz_m: [1, 0, 0]}}\n  fixtures:\n" | driver is changed by arm
changer      | pick: {kind                            | take-tol: {kind                         | did you mean 'take-tool'
changer      | screw: {duration                       | take-tool: {duration                    | cannot be called 'take-tool'
changer      | parts:                                 | "parts:\n    - {name: driver, size_m: [0.1, 0.1, 0.1], start: {xyz_m: [0.5, 0.5, 0.05]}}" | 'driver' of a part is already taken by a tool at
stored       | name: low, brick: 2x4, at: [34, 4, 1]   | name: low, brick: 2x4, at: [34, 14, 1]  | beyond the plate of 48 x 16 studs
construction | "  supply:"                            | "  model: {name: tower}\n  supply:"     | give 'model' or 'parts', one of them
construction | model: mobile-manipulator              | model: gp4                              | gp4 cannot park: its first joints do not drive it
construction | mobile-manipulator                     | mobile-manipulater                      | did you mean 'mobile-manipulator'?
construction | "  team: {model: mobile-manipulator, count: 2, name: mover, ring: {radius_m: 4.0, start_deg: 90}}" | "  fixtures: []" | a cell needs robots, or a team
construction | name: low                              | name: ground                            | is that of the floor
construction | name: low                              | name: mover2                            | is that of a robot
construction | [+y, +z]                               | [up]                                    | unknown value 'up' (valid: +x, -x,
goals        | "planning:\n  coordination: synchronous" | "execution: {policy: synchronous}\nplanning:\n  coordination: sequential" | coordination
goals        | {robot: east, to                       | {robot: eats, to                        | east
""")


@pytest.mark.parametrize(
    ("cell", "old", "new", "says"), WRONG, ids=lambda cell: str(cell)[:20]
)
def test_what_cannot_be_is_said(
    tmp_path: Path, cell: str, old: str, new: str, says: str
) -> None:
    text = CELLS[cell]
    found = refusal(tmp_path, text, (old, new))
    assert says in str(found)
    if cell == "crossing":
        (place, *_) = found.problems
        assert says in place.message
        assert place.mark.line == text[: text.index(old)].count("\n") + 1
