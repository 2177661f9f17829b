"""What a structure bears at a step, against the plain program at forces on either side of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    BRICKS,
    Cell,
    LegoAssembly,
    LegoStep,
    Press,
    Support,
)
from planning.lego.insertion.rules import SequencingRules
from planning.lego.insertion.tool_room import GRID
from planning.lego.sequencing.stable_steps import explain_step
from planning.statics.equilibrium import Load
from tests.planning.lego.whole_stability import stability
from twin.planning.step_picture import draw_step, step_figure


def _overhang(*supports: Support) -> LegoAssembly:
    """A tower, an arm that sticks out two studs, and a hand on the arm's end."""
    tower = [LegoStep(BRICKS["2x4"], Cell(20, 20, z)) for z in range(1, 10)]
    arm = LegoStep(BRICKS["2x4"], Cell(20, 18, 10), presses=(Press(1, 2),))
    hand = LegoStep(
        BRICKS["2x4"], Cell(20, 15, 11), presses=(Press(1, 2),), supports=supports
    )
    return LegoAssembly(GRID, (), (*tower, arm, hand), {})


def test_the_force_that_is_borne_is_where_the_plain_program_gives_way():
    found = explain_step(_overhang(), 11, SequencingRules())
    assert found.needed == pytest.approx(1.5 * 2 * 3 * 0.85)
    assert found.bears < found.needed
    assert found.bears == found.alone
    sign = np.sign(found.load.force[2])
    for factor, stable in ((0.999, True), (1.001, False)):
        load = Load(
            found.load.body, (0.0, 0.0, sign * factor * found.bears), found.load.points
        )
        loose = frozenset((found.load.body,))
        assert stability(found.bricks, loads=[load], loose=loose).stable == stable
    assert max(found.strain.values()) == pytest.approx(found.report.score)
    assert found.report.score > 1.0


def test_a_support_is_what_makes_the_difference(tmp_path: Path):
    found = explain_step(_overhang(Support(Cell(20, 18, 9), 0)), 11, SequencingRules())
    assert found.holds
    assert found.alone < found.needed < found.bears
    (tmp_path / "step.png").write_bytes(draw_step(found))
    with Image.open(tmp_path / "step.png") as picture:
        assert picture.size == (1000, 550)


def test_the_picture_has_room_for_its_arrows_and_says_what_they_are():
    plain = _overhang(Support(Cell(20, 18, 9), 0))
    steps = tuple(replace(step, temporary=k == 2) for k, step in enumerate(plain.steps))
    for assembly in (plain, replace(plain, steps=steps)):
        found = explain_step(assembly, 11, SequencingRules())
        figure = step_figure(found)
        for axis, axes in enumerate(figure.axes):
            low, high = axes.get_ylim()
            for arrow in axes.texts:
                x, z = arrow.xyann
                assert low < z < high
                assert axes.get_xlim()[0] < x < axes.get_xlim()[1], axis
            hatched = [patch for patch in axes.patches if patch.get_hatch()]
            assert len(hatched) == len(found.temporary) == (assembly is not plain)
        (legend,) = figure.legends
        words = {text.get_text() for text in legend.get_texts()}
        assert {"press", "support", "pressed brick"} <= words
        assert ("temporary" in words) == (assembly is not plain)


def test_steps_that_are_not_there():
    with pytest.raises(ScenarioError, match="steps are 1 to 11"):
        explain_step(_overhang(), 12, SequencingRules())
    with pytest.raises(ScenarioError, match="does not say its grip"):
        explain_step(_overhang(), 1, SequencingRules())
