"""Contacts to which moved bodies snap."""

from dataclasses import replace

import numpy as np
import viser
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from planning.transforms import translation
from twin.planning.build_workcell import build_workcell
from twin.scenario.shipped import shipped_scenarios
from twin.trial.loaded_scenario import load
from twin.view.cell_scene import CellScene
from twin.view.contact_snap import SNAP_M, contact_shift
from twin.view.server import HOST

TABLE = [[-1.0, -1.0, -0.1], [1.0, 1.0, 0.0]]


def test_a_body_near_a_table_stands_on_it_and_against_a_wall() -> None:
    wall = [[0.5, -1.0, 0.0], [0.6, 1.0, 1.0]]
    others = np.array([TABLE, wall])
    box = np.array([[0.4, 0.0, 0.003], [0.498, 0.1, 0.1]])
    np.testing.assert_allclose(contact_shift(box, others), [0.002, 0.0, -0.003])
    np.testing.assert_allclose(
        contact_shift(np.add(box, [-0.2, 0.0, -0.006]), others), [0.0, 0.0, 0.003]
    )
    assert not contact_shift(np.add(box, [-0.2, 0.0, 0.02]), others).any()
    assert not contact_shift(np.add(box, [-0.2, 2.0, 0.0]), others).any()
    assert not contact_shift(box, np.zeros((0, 2, 3))).any()


def test_parts_and_goals_snap_to_what_is_there_then() -> None:
    scenario = load(shipped_scenarios()["tray"])
    cell = build_workcell(scenario.sections, scenario.folder)
    server = viser.ViserServer(HOST, 8395, verbose=False)
    scene = CellScene(server.scene)
    scene.show(replace(cell, robots=()))  # their meshes take long
    # The motor is 0.06 x 0.04 x 0.05, the cover beside it 0.02 high; the table is at z = 0.
    cover = translation(0.3, -0.2, 0.01)
    goals = {"goals/cover": cover, "goals/motor": translation(0.3, -0.163, 0.028)}
    found = scene.snapped("goals/motor", goals["goals/motor"], goals)
    np.testing.assert_allclose(found, translation(0.3, -0.16, 0.025), atol=1e-9)
    # At the start the cover is not there.
    found = scene.snapped("objects/motor", goals["goals/motor"], goals)
    np.testing.assert_allclose(found, translation(0.3, -0.163, 0.025), atol=1e-9)
    np.testing.assert_array_equal(scene.snapped("", cover, goals), cover)
    scene.show_goal("goals/motor", found)
    scene.show_goal("fixtures/tray", found)
    box = scene.box("goals/motor", found)
    assert box is not None
    np.testing.assert_allclose(box[1] - box[0], [0.06, 0.04, 0.05], atol=1e-9)
    server.stop()


def nearest(box: list[list[int]], others: list[list[list[int]]]) -> list[int]:
    """Return the shift of boxes of whole millimetres, found by trying all shifts."""
    shift = [0, 0, 0]
    most = round(1000 * SNAP_M)
    for axis in (2, 0, 1):
        for size in range(most + 1):
            found = [
                sign * size
                for sign in (1, -1)
                if any(_touches(box, shift, axis, sign * size, own) for own in others)
            ]
            if found:
                assume(len(set(found)) == 1)  # as near on either side
                shift[axis] = found[0]
                break
    return shift


def _touches(
    box: list[list[int]], shift: list[int], axis: int, step: int, other: list[list[int]]
) -> bool:
    low, high = ([a + b for a, b in zip(own, shift, strict=True)] for own in box)
    beside = all(
        low[k] < other[1][k] and high[k] > other[0][k] for k in range(3) if k != axis
    )
    return beside and (
        low[axis] + step == other[1][axis] or high[axis] + step == other[0][axis]
    )


@st.composite
def boxes(draw: st.DrawFn) -> list[list[int]]:
    low = [draw(st.integers(-20, 20)) for _ in range(3)]
    return [low, [a + draw(st.integers(1, 20)) for a in low]]


@settings(max_examples=60)
@given(boxes(), st.lists(boxes(), min_size=1, max_size=4))
def test_the_nearest_contact_is_taken(
    box: list[list[int]], others: list[list[list[int]]]
) -> None:
    found = contact_shift(np.array(box) / 1000, np.array(others) / 1000)
    expected = np.array(nearest(box, others)) / 1000
    np.testing.assert_allclose(found, expected, atol=1e-9)
