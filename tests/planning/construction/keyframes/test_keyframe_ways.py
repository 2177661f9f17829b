"""Straight ways of skills: free where there is room, however parallel the faces are."""

from __future__ import annotations

import numpy as np

from planning.cell.workcell import Attachment, PlacedRobot, Workcell
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.problem.models import pavilion
from planning.construction.problem.reach_sampler import ReachSampler
from planning.construction.problem.site import (
    build_problem,
    ground_fixture,
    part_objects,
)
from planning.construction.problem.supply_layout import Spiral
from planning.construction.world.fixed_world import FixedWorld, with_part_at_rest
from planning.construction.world.skill_motion import skill_motion
from planning.robots.registry import robot_model
from planning.transforms import read_only_copy


def test_a_cassette_goes_straight_to_its_foot_above_a_wide_floor() -> None:
    # Its edges are parallel to the floor's: simplices of the two are flat again and again.
    part, beside = (
        next(p for p in pavilion() if p.name == name)
        for name in ("cassette1_15", "cassette2_16")
    )
    model = robot_model("mobile-manipulator")
    home = read_only_copy((-10.0, 0.0, *model.home[2:]))
    cell = Workcell(
        (PlacedRobot("mover", model, np.eye(4), home),),
        (ground_fixture(),),
        part_objects((part, beside), Spiral(5.0)),
    )
    problem = build_problem(cell, (part, beside))
    world = with_part_at_rest(FixedWorld(cell), beside.name, beside.goal)
    own = problem.part(part.name)
    pose = problem.held_in_flange("mover", own, 0, 0.0)
    tool = frozenset({frozenset(("mover/tool", part.name))})
    checker = SpaceTimeChecker(
        world, "mover", held={part.name: Attachment("mover", pose)}, allowed=tool
    )
    at = problem.tool_pose(own, own.goal, 0, 0.0)
    drawn = ReachSampler(cell.robot("mover")).sample(at, np.random.default_rng(1), 12)
    alternatives = (0.1 * own.insertion, -0.1 * own.insertion)
    motions = [
        skill_motion(cell.robot("mover"), "tool", q, alternatives, model.velocity, 3.0)
        for q in drawn
        if checker.configuration_free(q, 0.0)
    ]
    assert len(motions) >= 4
    for motion in motions:
        assert motion is not None
        lift = motion.before
        for a, b in zip(lift, lift[1:], strict=False):
            assert checker.motion_free(a, 0.0, b, 1.0)
