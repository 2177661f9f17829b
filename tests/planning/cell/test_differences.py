"""What differs between two cells is named; equal cells do not differ."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planning.cell.differences import cell_differences
from planning.cell.robot_model import ToolGrip
from planning.cell.shape import Element, Mesh, Shape, box_shape, shape_of
from planning.cell.workcell import Clearances, Workcell
from planning.transforms import from_rpy, translation
from tests.scheduling.mini_world import random_plan

CELL = random_plan(3, 7).cell
Change = Callable[[Workcell], Workcell]


def _robot(**changes: Any) -> Change:
    return lambda cell: replace(
        cell, robots=(replace(cell.robots[0], **changes), *cell.robots[1:])
    )


def _model(**changes: Any) -> Change:
    return lambda cell: replace(
        cell,
        robots=(
            replace(cell.robots[0], model=replace(cell.robots[0].model, **changes)),
            *cell.robots[1:],
        ),
    )


def _object(**changes: Any) -> Change:
    return lambda cell: replace(
        cell, objects=(replace(cell.objects[0], **changes), *cell.objects[1:])
    )


def _wedge(size: np.ndarray) -> Shape:
    """Half of a box."""
    corners = box_shape("w", size).pieces[0].vertices[:6]
    mesh = Mesh(corners, np.zeros((1, 3), int), (corners,), 1.0, np.zeros(3))
    return shape_of("w", [Element(mesh, np.eye(4))])


def test_a_cell_does_not_differ_from_itself() -> None:
    assert cell_differences(CELL, CELL) == []


ROBOT, OBJECT = CELL.robots[0], CELL.objects[0]
MODEL = ROBOT.model


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_robot(base=translation(5.0, 0.0, 0.0) @ ROBOT.base), "its base is 5 m from"),
        (
            _robot(base=ROBOT.base @ from_rpy((0, 0, 0), (0, 0, np.pi / 2))),
            "has turned: its base by 90 degrees",
        ),
        (_robot(home=ROBOT.home + 0.01), "another HOME"),
        (_robot(name="new"), "robot 'new' is not in the plan"),
        (
            _model(grip=ToolGrip((0.0, 0.05), "hand")),
            "a tool that holds in another way",
        ),
        (_model(velocity=MODEL.velocity * 0.5), "other joint limits (velocity)"),
        (_model(flange=translation(0, 0, 0.01) @ MODEL.flange), "its flange is 0.01 m"),
        (_model(parts=MODEL.parts[1:]), "has another arm"),
        (_model(parts=(*MODEL.parts, MODEL.parts[-1])), "has another tool"),
        (_object(shape=box_shape("b", OBJECT.size * 2.0)), "measures"),
        (_object(shape=_wedge(OBJECT.size)), "another shape of the same size"),
        (_object(start=translation(0.0, 0.0, 0.002) @ OBJECT.start), "0.002 m from"),
        (_object(kind="other"), "'other' here"),
        (lambda c: replace(c, objects=c.objects[:-1]), "is not in the cell"),
        (lambda c: replace(c, robots=c.robots[::-1]), "in another order"),
        (lambda c: replace(c, clearances=Clearances(0.5, 0.1)), "clearances"),
    ],
)
def test_what_differs_is_named(change: Change, words: str) -> None:
    assert any(words in text for text in cell_differences(CELL, change(CELL)))


def test_what_comes_up_later_is_the_plans_own() -> None:
    later = replace(OBJECT, name="next", later=True)
    assert not cell_differences(replace(CELL, objects=(*CELL.objects, later)), CELL)
