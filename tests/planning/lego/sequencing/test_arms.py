"""Sequences that the arms of a cell can do: grips they reach, bricks that keep them out, houses."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.workcell import Workcell
from planning.errors import InfeasibleStepError, ScenarioError
from planning.handling.skill_targets import skill_postures
from planning.lego.bricks.assembly import (
    Cell,
    GridSpan,
    LegoStep,
    PlacedBrick,
    Press,
)
from planning.lego.bricks.brick_grips import legal_presses
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.grid import top_pose
from planning.lego.importers.brick_models.brick_list import read_brick_list
from planning.lego.importers.brick_models.cell import (
    Finished,
    Station,
    find_stations,
    model_cell,
)
from planning.lego.insertion.rules import ArmLimits, SequencingRules
from planning.lego.sequencing.arms import GripReach
from planning.lego.sequencing.sequencing import sequence_structure
from planning.lego.skills.targets import BrickGrip, place_targets
from planning.steps.skill import SkillPath
from tests.planning.lego.structures import brick
from twin.document.yaml_text import scenario_text
from twin.host.progress import StageWatch
from twin.kinds.lego.kind import build_lego, buildable_sequence
from twin.kinds.lego.section import LegoSection
from twin.planning.build_workcell import build_workcell
from twin.reading.scenario_file import parse_scenario


def hollow_house(
    wide: int, deep: int, high: int, at: tuple[int, int] = (0, 0)
) -> list[PlacedBrick]:
    """Return four walls, one brick 2x4 thick, that bind at their corners and in between.

    Args:
        wide, deep: studs along x and y, multiples of 4 and at least 8.
        high: layers.
        at: the least stud.
    """
    if wide % 4 or deep % 4 or min(wide, deep) < 8:
        raise ValueError(f"no house of {wide} x {deep} studs")
    bricks: list[PlacedBrick] = []

    def lay(x: int, y: int, z: int, turned: bool) -> None:
        # A brick 2x4 has four studs along y, and along x where it is turned.
        cell = Cell(at[0] + x, at[1] + y, z, turned)
        bricks.append(PlacedBrick(f"b{len(bricks)}", BRICKS["2x4"], cell))

    for z in range(1, high + 1):
        inset = 2 if z % 2 else 0
        for y in (0, deep - 2):
            for x in range(inset, wide - inset, 4):
                lay(x, y, z, True)
        for x in (0, wide - 2):
            for y in range(2 - inset, deep - 2 + inset, 4):
                lay(x, y, z, False)
    return bricks


def _cell_of(folder: Path, bricks: list[PlacedBrick]) -> tuple[Workcell, LegoSection]:
    """Return the cell that an import chooses for some bricks, and the section."""
    file = folder / "bricks.txt"
    lines = [
        f"{b.span.size[0]}x{b.span.size[1]} ({b.cell.x},{b.cell.y},{b.cell.z - 1})"
        for b in bricks
    ]
    file.write_text("\n".join(lines) + "\n")
    content = {"version": 1, "name": "house", **model_cell(read_brick_list(file))}
    scenario, _ = parse_scenario(folder / "house.yaml", scenario_text(content, ""))
    assert isinstance(scenario.assembly, LegoSection)
    return build_workcell(scenario, folder), scenario.assembly


@pytest.fixture(scope="module")
def gate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Workcell, LegoSection]:
    """A cell of two arms, and a small house in it."""
    return _cell_of(tmp_path_factory.mktemp("house"), hollow_house(8, 8, 2))


def test_every_step_of_a_house_can_be_done(gate: tuple[Workcell, LegoSection]) -> None:
    cell, section = gate
    found = buildable_sequence(section, cell, StageWatch())
    assert found.done
    assert len(found.found.sequence) == 12


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(["1x2", "2x2", "2x4"]),
    st.integers(0, 44),
    st.integers(0, 44),
    st.sampled_from([1, 4, 12, 25, 30]),
    st.booleans(),
    st.booleans(),
    st.data(),
)
def test_reach_of_a_grip_is_that_of_each_arm_asked_by_itself(
    gate: tuple[Workcell, LegoSection],
    kind: str,
    x: int,
    y: int,
    z: int,
    turned: bool,
    up: bool,
    data: st.DataObject,
) -> None:
    """What is remembered of bricks gripped at the same place is true of all of them."""
    cell, section = gate
    plate = build_lego(section).plate
    reach = GripReach(cell, plate)
    item = PlacedBrick("a", BRICKS[kind], Cell(x, y, z, turned))
    for other in legal_presses(item.brick):
        reach(PlacedBrick("b", item.brick, Cell(x, y, z, turned)), other, up)
    press = data.draw(st.sampled_from(legal_presses(item.brick)))
    grips = [
        BrickGrip(r.model.frames, item.brick, top_pose(plate, item), press)
        for r in cell.robots
    ]
    asked = any(
        isinstance(found, SkillPath)
        for robot, grip in zip(cell.robots, grips, strict=True)
        for attack in (1, -1)
        for height in (0.010, 0.012)
        for found in skill_postures(
            robot, place_targets(grip, up=up, attack=attack, height=height)
        )
    )
    assert reach(item, press, up) == asked


def _side_by_side() -> list[PlacedBrick]:
    return [brick("a", "2x4", 20, 20, 1), brick("b", "2x4", 30, 20, 1)]


def _barred(
    first: str, other: str
) -> dict[tuple[str, Press, bool], tuple[frozenset[str]]]:
    grips = legal_presses(BRICKS["2x4"])
    return {(first, press, False): (frozenset([other]),) for press in grips}


def _anywhere(item: PlacedBrick, press: object, up: bool) -> bool:
    return True


@pytest.mark.parametrize(("first", "then"), [("a", "b"), ("b", "a")])
def test_what_keeps_the_arms_out_comes_later(first: str, then: str) -> None:
    rules = SequencingRules(arms=ArmLimits(_anywhere, _barred(first, then)))
    found = sequence_structure(_side_by_side(), rules=rules)
    assert [item.name for item in found.sequence] == [first, then]


def test_bricks_that_keep_the_arms_from_each_other_are_refused() -> None:
    beside = {**_barred("a", "b"), **_barred("b", "a")}
    rules = SequencingRules(arms=ArmLimits(_anywhere, beside))
    with pytest.raises(InfeasibleStepError, match="of these 2 bricks none can go in"):
        sequence_structure(_side_by_side(), rules=rules)


def test_a_brick_that_no_arm_reaches_is_named() -> None:
    def reaches(item: PlacedBrick, press: object, up: bool) -> bool:
        return item.name != "b"

    rules = SequencingRules(arms=ArmLimits(reaches))
    with pytest.raises(InfeasibleStepError) as caught:
        sequence_structure(_side_by_side(), rules=rules)
    assert "'b' (2x4 at [30, 20, 1])" in str(caught.value)
    assert "no arm of the cell gets there" in str(caught.value)


def test_only_grips_that_some_arm_reaches_are_offered() -> None:
    allowed = legal_presses(BRICKS["2x4"])[3]

    def reaches(item: PlacedBrick, press: object, up: bool) -> bool:
        return press == allowed

    rules = SequencingRules(arms=ArmLimits(reaches))
    found = sequence_structure(_side_by_side(), rules=rules)
    assert [item.step.presses for item in found.sequence] == [(allowed,)] * 2


def test_a_station_beside_a_high_wall_is_not_free_for_ever(
    gate: tuple[Workcell, LegoSection],
) -> None:
    cell, section = gate
    plate = build_lego(section).plate
    station = Station(BRICKS["2x4"], Cell(2, 22, 1), None)
    free = []
    for high in (1, 11):
        wall = [
            LegoStep(BRICKS["2x4"], Cell(8, y, z))
            for z in range(1, high + 1)
            for y in range(10, 38, 4)
        ]
        free.append(Finished(cell.robots, plate, wall).stays_free("left", station))
    assert free == [True, False]


def test_stations_stand_where_picks_stay_free(
    gate: tuple[Workcell, LegoSection],
) -> None:
    cell, section = gate
    room = GridSpan(20, 28, 20, 28, 0, 1)
    asked = cell.robots[0], build_lego(section).plate, room, [BRICKS["2x4"]]
    (found,) = find_stations(*asked, far=False, stays_free=lambda s: s.cell.y > 30)
    assert found.cell.y > 30
    with pytest.raises(ScenarioError, match="no room for a feeding station"):
        find_stations(*asked, far=False, stays_free=lambda _: False)


@pytest.mark.nightly
def test_a_house_of_396_bricks_can_be_built(tmp_path: Path) -> None:
    cell, section = _cell_of(tmp_path, hollow_house(32, 44, 11))
    # On the usual plate the walls would keep the arms from their stations.
    assert section.plate.studs[0] > 48
    found = buildable_sequence(section, cell, StageWatch())
    assert found.done
    assert len(found.found.sequence) == 396
