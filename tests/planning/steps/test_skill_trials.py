"""A skill tried in a scene that is cleared as it goes, against one built anew every time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.shape import box_shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    Clearances,
    PlacedRobot,
    Workcell,
)
from planning.kinematics.kinematics import frame_pose
from planning.robots.registry import robot_model
from planning.steps.skill import Obstruction, SkillContacts, SkillPath
from planning.steps.skill_scene import SkillScene
from planning.steps.skill_trial import SkillTrial, find_obstruction
from planning.transforms import readonly, translation

MODEL = robot_model("gp4")
ROBOT = PlacedRobot("arm", MODEL, readonly(np.eye(4)), MODEL.home)
OTHER = PlacedRobot("other", MODEL, readonly(translation(0.9, 0, 0)), MODEL.home)
CELL = Workcell((ROBOT, OTHER), (), (), Clearances(0.001, 0.0))
NONE: frozenset[frozenset[str]] = frozenset()
GRIP = frozenset({frozenset({"arm/tool", "part"})})
WAY = MODEL.home + np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.2, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ]
)


def item(name, pose):
    size = readonly([0.016, 0.032, 0.0096])
    return (
        CellObject(name, "2x4", box_shape(name, size), readonly(pose)),
        Attachment(None, readonly(pose)),
    )


def scene_on_the_way(where, *, change):
    """Bricks around the tool on its way, and a part that is gripped half-way through."""
    objects = {}
    for k, (share, x, y, z) in enumerate(where):
        leg = min(int(share), 2)
        q = WAY[leg] + (share - leg) * (WAY[leg + 1] - WAY[leg])
        pose = frame_pose(ROBOT, q, "tool") @ translation(x, y, z)
        objects[f"b{k}"] = item(f"b{k}", pose)
    handed = None
    if change:
        objects["part"] = item("part", frame_pose(ROBOT, WAY[2], "tool"))
        handed = ("part", Attachment("arm", readonly(translation(0.0, 0.0, 0.12))))
    contacts = SkillContacts(NONE, GRIP, GRIP)
    home = {"arm": MODEL.home, "other": MODEL.home}
    path = SkillPath("pick", "arm", WAY[:1], WAY[1:], 2 if change else None)
    return SkillScene(CELL, objects, home, contacts, handed), path


def clear_by_hand(path, scene, loose):
    """Take away one obstacle after another, and start all over again each time."""
    gone = []
    while True:
        found = find_obstruction(path, scene)
        if found is None or found.by not in loose:
            return found, gone
        gone.append(found.by)
        kept = {k: v for k, v in scene.objects.items() if k != found.by}
        scene = replace(scene, objects=kept)


bricks = st.lists(
    st.tuples(
        st.floats(0.0, 3.0),
        st.floats(-0.06, 0.06),
        st.floats(-0.06, 0.06),
        st.floats(-0.04, 0.04),
    ),
    min_size=1,
    max_size=8,
)


@settings(max_examples=40, deadline=None)
@given(bricks, st.booleans(), st.sets(st.integers(0, 7)))
def test_going_on_is_starting_all_over_again(where, change, fast):
    scene, path = scene_on_the_way(where, change=change)
    loose = {f"b{k}" for k in range(8) if k not in fast}
    trial = SkillTrial(path, scene)
    assert trial.found == find_obstruction(path, scene)
    expected, gone = clear_by_hand(path, scene, loose)
    assert trial.take_away(loose) == expected
    assert trial.gone == gone


@pytest.mark.parametrize("change", [False, True])
def test_what_is_in_the_way_is_found_and_taken_away(change):
    scene, path = scene_on_the_way([(0.5, 0, 0, 0), (2.5, 0, 0, 0)], change=change)
    trial = SkillTrial(path, scene)
    assert isinstance(trial.found, Obstruction)
    assert trial.found.by == "b0"
    assert trial.take_away({"b0"}) is not None
    assert trial.take_away({"b0", "b1"}) is None
    assert trial.gone == ["b0", "b1"]
