"""Assembly sequences of small structures, replayed step by step with the plain program.

What a structure bears at a step, against the plain program at forces on either side of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.text import Annotation
from PIL import Image

from planning.errors import InfeasibleStepError, ScenarioError, UndecidedError
from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    Cell,
    LegoAssembly,
    LegoStep,
    PlacedBrick,
    Press,
    StockBrick,
    Support,
)
from planning.lego.bricks.brick_grips import legal_presses, press_cell
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.importers.apex_mr.importer import import_apex_mr
from planning.lego.insertion.insertion import Insertions
from planning.lego.insertion.rules import SequencingRules
from planning.lego.insertion.tool_room import GRID, tool_room
from planning.lego.sequencing.explained_step import explain_step
from planning.lego.sequencing.sequencing import SequencedStructure, sequence_structure
from planning.lego.stability.contacts import ToolHold
from planning.statics.equilibrium import Load
from tests.planning.lego.importers.published_form import (
    DATA,
    cell_of,
    needs_data,
    types_of,
)
from tests.planning.lego.structures import brick, dropped
from tests.planning.lego.whole_stability import stability
from twin.kinds.lego.step_picture import draw_step, step_figure


def _tower(height: int, x: int = 20, y: int = 20) -> list[PlacedBrick]:
    return [brick(f"tower{z}", "2x4", x, y, z) for z in range(1, height + 1)]


def _replay(
    structure: list[PlacedBrick],
    found: SequencedStructure,
    scaffold: Sequence[PlacedBrick] = (),
) -> None:
    """Check every step of a sequence from scratch."""
    goal = {i.name: i for i in structure}
    assert sorted(q.name for q in found.sequence) == sorted(goal)
    there = list(scaffold)
    assert stability(there).stable
    for item in found.sequence:
        step, brick = item.step, goal[item.name]
        assert (step.brick, step.cell) == (brick.brick, brick.cell)
        filled = {p: i for i in there for p in i.places}
        own = brick.places
        above = {filled.get((x, y, z + 1)) for x, y, z in own} - {None, brick}
        below = {filled.get((x, y, z - 1)) for x, y, z in own} - {None, brick}
        if step.up:
            assert above
            assert not below
            assert step.cell.level > 0
        else:
            assert not above
            assert below or step.cell.level == 0
        there.append(brick)
        assert item.step.presses[0] == step.press
        assert set(item.step.presses) <= set(legal_presses(brick.brick))
        for press in item.step.presses:
            force = _force(brick, there, up=step.up)
            loads = _loads(brick, press, force, up=step.up)
            holds = [] if step.support is None else _holds(there, step)
            assert (step.support is None) == (not holds)
            report = stability(
                there, loads=loads, holds=holds, loose=frozenset((brick.name,))
            )
            assert report.stable, (item.name, press, report)
        assert stability(there).stable


def _loads(brick: PlacedBrick, press: Press, force: float, *, up: bool) -> list[Load]:
    """Return the press as one load whose points are the rims of the pressed studs."""
    contact = press_cell(brick, press, up=up)
    pair = PlacedBrick("tool", BRICKS["1x2"], contact)
    own = brick.studs
    studs = [s for s in pair.studs if s in own]
    top = brick.cell.level + brick.brick.height
    height = (brick.cell.level if up else top) * LAYER_HEIGHT / 3
    rims = ((0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.0, -0.3))
    points = tuple(
        ((x + 0.5 + i) * STUD_PITCH, (y + 0.5 + j) * STUD_PITCH, height)
        for x, y in studs
        for i, j in rims
    )
    return [Load(brick.name, (0.0, 0.0, force if up else -force), points)]


def _force(brick: PlacedBrick, there: Sequence[PlacedBrick], *, up: bool) -> float:
    """Return 1.5 times the friction of all contacts that engage, at most 15 N."""
    on = [b for b in there if b.name != brick.name]
    level = brick.cell.level + (brick.brick.height if up else 0)
    total = 0.0
    for x, y in brick.studs:
        if level == 0:
            uppers = [brick]
        elif up:
            uppers = [b for b in on if b.cell.level == level and (x, y) in b.studs]
        else:
            uppers = [
                brick
                for b in on
                if b.cell.level + b.brick.height == level and (x, y) in b.studs
            ]
        for upper in uppers:
            total += 4 * 0.98 if min(upper.brick.studs) == 1 else 3 * 0.85
    return min(15.0, 1.5 * total)


def _holds(there: Sequence[PlacedBrick], step: LegoStep) -> list[ToolHold]:
    """Return where the support touches, found by sampling its face."""
    assert step.support is not None
    (x0, y0, _), (x1, y1, _) = tool_room("gp4").support(step.support).face
    level = step.support.cell.level + (-1 if step.up else 3)
    filled = {p: i.name for i in there for p in i.places}
    n = 9
    out = []
    for i in range(n):
        for j in range(n):
            x = x0 + (x1 - x0) * (0.001 + 0.998 * i / (n - 1))
            y = y0 + (y1 - y0) * (0.001 + 0.998 * j / (n - 1))
            name = filled.get((int(x // STUD_PITCH), int(y // STUD_PITCH), level))
            if name is not None:
                out.append(ToolHold(name, -1 if step.up else 1, (x, y, 0.0)))
    return out


def test_a_tower_is_built_from_the_bottom() -> None:
    tower = _tower(6)
    found = sequence_structure(tower[::-1])
    assert [q.name for q in found.sequence] == [b.name for b in tower]
    assert all(not s.up and s.support is None for s in found.steps)
    assert found.programs == 0
    _replay(tower, found)


def test_an_overhang_is_supported_from_below() -> None:
    structure = [
        *_tower(9),
        brick("arm", "2x4", 20, 18, 10),
        brick("hand", "2x4", 20, 15, 11),
    ]
    found = sequence_structure(structure)
    _replay(structure, found)
    by_name = {q.name: q for q in found.sequence}
    assert by_name["arm"].step.support is None
    hand = by_name["hand"]
    assert hand.step.support is not None
    assert "give way" in hand.reason
    assert hand.step.supports[0] == hand.step.support
    assert (
        hand.step.support.cell.z == 9
    )  # under the arm, which the hand is pressed onto
    with pytest.raises(InfeasibleStepError, match=r"(?s)'hand'.*gives way.*'support'"):
        sequence_structure(structure, rules=SequencingRules(support=False))
    gentle = sequence_structure(structure, rules=SequencingRules(force=0.5))
    assert all(s.support is None for s in gentle.steps)


def test_a_hanging_brick_is_placed_from_below() -> None:
    structure = [
        *_tower(15),
        brick("beam", "2x6", 20, 18, 16),
        brick("lamp", "2x2", 20, 18, 15),
    ]
    found = sequence_structure(structure)
    _replay(structure, found)
    lamp = found.sequence[-1]
    assert lamp.name == "lamp"
    assert lamp.step.up
    assert lamp.step.support is not None
    assert lamp.step.support.cell.z > 16
    assert "hangs below 'beam'" in lamp.reason
    with pytest.raises(InfeasibleStepError, match="from below is not allowed"):
        sequence_structure(structure, rules=SequencingRules(place_up=False))


def test_scaffold_stays() -> None:
    scaffold = _tower(4)
    structure = [brick("top", "2x2", 20, 20, 5), brick("tip", "2x2", 20, 20, 6)]
    found = sequence_structure(structure, scaffold=scaffold)
    assert [q.name for q in found.sequence] == ["top", "tip"]
    _replay(structure, found, scaffold)
    with pytest.raises(InfeasibleStepError, match="nothing holds 'top'"):
        sequence_structure(structure)


def test_a_structure_that_collapses_is_refused() -> None:
    heavy = BrickType("2x4", (2, 4), 0.5)
    structure = [
        *_tower(2),
        PlacedBrick("slab", heavy, Cell(20, 17, 3)),
    ]
    with pytest.raises(
        InfeasibleStepError, match=r"'slab' \(2x4 .* times the friction"
    ):
        sequence_structure(structure)


def test_a_slab_is_pressed_on_where_it_has_a_stud_below() -> None:
    structure = [brick("foot", "1x1", 20, 20, 1), brick("roof", "2x4", 20, 20, 2)]
    found = sequence_structure(structure)
    _replay(structure, found)
    press = found.sequence[-1].step.presses
    item = structure[-1]
    contacts = [press_cell(item, p, up=False) for p in press]
    pairs = [PlacedBrick("tool", BRICKS["1x2"], at) for at in contacts]
    assert all((20, 20) in pair.studs for pair in pairs)
    two = [structure[0], brick("roof", "1x8", 20, 20, 2)]
    heavy = [*two, brick("end", "2x4", 20, 26, 3)]
    with pytest.raises(InfeasibleStepError, match=r"(?s)'end'.*gives way"):
        sequence_structure(heavy, rules=SequencingRules(support=False))


def test_a_brick_in_a_pit_has_no_room_for_the_tool() -> None:
    walls = [
        brick(f"{side}{z}", kind, x, y, z, turned)
        for z in (1, 2, 3)
        for side, kind, x, y, turned in (
            ("west", "1x6", 18, 17, False),
            ("east", "1x6", 22, 17, False),
            ("south", "1x2", 19, 17, True),
            ("north", "1x2", 19, 22, True),
        )
    ]
    pit = brick("pit", "1x1", 20, 20, 1)
    with pytest.raises(InfeasibleStepError, match=r"'pit'.*no room"):
        sequence_structure([pit], scaffold=walls)


def test_what_a_dead_end_lacked_is_kept_longer_in_the_next_try() -> None:
    """The cap is borne only while the weight is on the lever, and both are in the top layer."""
    structure = [
        brick("lever", "1x8", 20, 20, 2),
        brick("post", "1x1", 20, 22, 1),
        brick("side1", "1x2", 21, 26, 1),
        brick("side2", "1x2", 21, 26, 2),
        brick("weight", "2x2", 20, 26, 3),
        brick("cap", "1x1", 20, 20, 3),
    ]
    rules = SequencingRules(support=False, place_up=False)
    found = sequence_structure(structure, rules=rules)
    _replay(structure, found)
    assert found.visited > len(structure) + 1
    with pytest.raises(UndecidedError, match="no proof"):
        sequence_structure(structure, rules=replace(rules, search_limit=0))


@settings(max_examples=8, deadline=None)
@given(
    st.sampled_from([(), ("2x4-plate", "1x6-plate")]).flatmap(
        lambda plates: dropped(("2x2", "2x4", "1x4", "2x6", *plates), (3, 8), (20, 24))
    )
)
def test_random_towers_are_built_or_refused_with_a_reason(
    structure: list[PlacedBrick],
) -> None:
    try:
        found = sequence_structure(structure)
    except InfeasibleStepError as error:
        reason = str(error)
    else:
        _replay(structure, found)
        return
    assert any(f"'{item.name}'" in reason for item in structure)


@pytest.mark.nightly
def test_a_wall_of_120_bricks() -> None:
    structure: list[PlacedBrick] = []
    layer = 1
    while len(structure) < 120:
        shift = 0 if layer % 2 else 2
        for y in range(0, 12, 2):
            for x in range(shift, 16 - shift, 4):
                name = f"b{len(structure)}"
                structure.append(brick(name, "2x4", x, y, layer, True))
        layer += 1
    structure = structure[:120]
    found = sequence_structure(structure)
    assert len(found.steps) == 120
    assert found.visited == 121
    assert all(not s.up and s.support is None for s in found.steps)


def _published(
    task: str,
) -> tuple[dict[str, Any], list[PlacedBrick], list[PlacedBrick]]:
    """Return the steps of a published task by name, its structure and its scaffold."""
    assembly = import_apex_mr(DATA, task)["assembly"]
    types = types_of(assembly)

    def placed(name: str, entry: Mapping[str, Any]) -> PlacedBrick:
        return PlacedBrick(name, types[entry["brick"]], cell_of(entry))

    steps = {f"s{k}": entry for k, entry in enumerate(assembly["steps"])}
    structure = [placed(name, entry) for name, entry in steps.items()]
    scaffold = [placed(e["name"], e) for e in assembly["stock"] if e.get("fixed")]
    return steps, structure, scaffold


@needs_data
@pytest.mark.parametrize("task", ["cliff", "faucet"])
def test_published_structures_get_the_published_ways(task: str) -> None:
    steps, structure, scaffold = _published(task)
    found = sequence_structure(structure, scaffold=scaffold)
    _replay(structure, found, scaffold)
    for item in found.sequence:
        published = steps[item.name]
        assert item.step.up == (published.get("place") == "up")
        assert (item.step.support is not None) == ("support" in published)
        side, offset = published["press"]["side"], published["press"]["offset"]
        assert Press(side, offset) in item.step.presses


@needs_data
@pytest.mark.parametrize("task", ["cliff", "faucet", "bridge"])
@pytest.mark.parametrize("force", [15.0, 18.0])
def test_published_sequences_have_support_exactly_where_it_is_needed(
    task: str, force: float
) -> None:
    """In the published order, with the published presses and supports."""
    steps, structure, scaffold = _published(task)
    rules = Insertions.of(structure, scaffold, SequencingRules(force=force))
    names = frozenset(item.name for item in scaffold)
    for item in structure:
        names |= {item.name}
        step = steps[item.name]
        press = Press(**step["press"])
        site = rules.at(names, item.name, up=step.get("place") == "up")
        assert press in site.roomy_presses
        alone = site.bears(press).stable
        assert alone == ("support" not in step), item
        if "support" in step:
            entry = step["support"]
            cell, up = Cell(*entry["at"]), step.get("place") == "up"
            support = Support(cell, entry["orientation"], from_above=up)
            assert site.bears(press, support).stable


def test_an_assembly_is_planned_anew_from_its_goal() -> None:
    steps = [
        LegoStep(BRICKS["2x4"], Cell(20, 20, 3)),
        LegoStep(BRICKS["2x4"], Cell(20, 20, 2), stock="b"),
    ]
    stock = (StockBrick("base", BRICKS["2x4"], Cell(20, 20, 1), fixed=True),)
    assembly = LegoAssembly(GRID, stock, tuple(steps), {})
    found = sequence_structure(assembly.structure, scaffold=assembly.scaffold)
    assert [s.cell.z for s in found.steps] == [2, 3]
    assert [q.name for q in found.sequence] == ["step 2", "step 1"]
    assert all(s.press is not None and s.stock is None for s in found.steps)


def _overhang(*supports: Support) -> LegoAssembly:
    """A tower, an arm that sticks out two studs, and a hand on the arm's end."""
    tower = [LegoStep(BRICKS["2x4"], Cell(20, 20, z)) for z in range(1, 10)]
    arm = LegoStep(BRICKS["2x4"], Cell(20, 18, 10), presses=(Press(1, 2),))
    hand = LegoStep(
        BRICKS["2x4"], Cell(20, 15, 11), presses=(Press(1, 2),), supports=supports
    )
    return LegoAssembly(GRID, (), (*tower, arm, hand), {})


def test_the_force_that_is_borne_is_where_the_plain_program_gives_way() -> None:
    found = explain_step(_overhang(), 11, SequencingRules())
    assert found.needed == pytest.approx(1.5 * 2 * 3 * 0.85)
    assert found.bears < found.needed
    assert found.bears == found.bears_unsupported
    sign = np.sign(found.load.force[2])
    for factor, stable in ((0.999, True), (1.001, False)):
        load = Load(
            found.load.body, (0.0, 0.0, sign * factor * found.bears), found.load.points
        )
        loose = frozenset((found.load.body,))
        assert stability(found.bricks, loads=[load], loose=loose).stable == stable
    assert max(found.friction_shares.values()) == pytest.approx(found.report.score)
    assert found.report.score > 1.0


def test_a_support_is_what_makes_the_difference(tmp_path: Path) -> None:
    found = explain_step(_overhang(Support(Cell(20, 18, 9), 0)), 11, SequencingRules())
    assert found.holds
    assert found.bears_unsupported < found.needed < found.bears
    (tmp_path / "step.png").write_bytes(draw_step(found))
    with Image.open(tmp_path / "step.png") as picture:
        assert picture.size == (1000, 550)


def test_the_picture_has_room_for_its_arrows_and_says_what_they_are() -> None:
    plain = _overhang(Support(Cell(20, 18, 9), 0))
    steps = tuple(replace(step, temporary=k == 2) for k, step in enumerate(plain.steps))
    for assembly in (plain, replace(plain, steps=steps)):
        found = explain_step(assembly, 11, SequencingRules())
        figure = step_figure(found)
        for axis, axes in enumerate(figure.axes):
            low, high = axes.get_ylim()
            for arrow in axes.texts:
                assert isinstance(arrow, Annotation)
                x, z = arrow.xyann
                assert low < z < high
                assert axes.get_xlim()[0] < x < axes.get_xlim()[1], axis
            hatched = [patch for patch in axes.patches if patch.get_hatch()]
            assert len(hatched) == len(found.temporary) == (assembly is not plain)
        (legend,) = figure.legends
        words = {text.get_text() for text in legend.get_texts()}
        assert {"press", "support", "pressed brick"} <= words
        assert ("temporary" in words) == (assembly is not plain)


def test_steps_that_are_not_there() -> None:
    with pytest.raises(ScenarioError, match="steps are 1 to 11"):
        explain_step(_overhang(), 12, SequencingRules())
    with pytest.raises(ScenarioError, match="does not say its grip"):
        explain_step(_overhang(), 1, SequencingRules())
