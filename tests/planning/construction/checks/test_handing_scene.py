"""Two robots at one part: they are free just where a slow engine finds room around both."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.construction.problem.problem import Hold
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.problem.site import build_problem
from planning.construction.step_scenes import HandingScene, StepScenes
from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.timeline import RobotTimeline
from planning.transforms import Array
from scheduling.witness.parts import ConvexPart, measure
from scheduling.witness.robot import WitnessRobot
from tests.planning.construction.toy_sites import toy_part, toy_problem

BEAM = toy_part("beam", (0.7, 0.2, 0.1), (0.0, 0.0, 0.05))
PROBLEM = build_problem(
    toy_problem((BEAM,), 3).cell, (BEAM,), offsets=(0.0, 0.25, -0.25)
)
PART = PROBLEM.parts[0]
GIVER, TAKER, OTHER = PROBLEM.team
LEAST = PROBLEM.cell.clearances.robot_robot
HELD = "beam"

bounds = cache(lambda: ReachBounds(PROBLEM))


@cache
def reference(name: str) -> WitnessRobot:
    return WitnessRobot(PROBLEM.cell.robot(name))


def parts(name: str, hold: Hold | None = None) -> list[ConvexPart]:
    """A robot's bodies, and the beam where it has it."""
    own = list(reference(name).parts)
    if hold is not None:
        pose = PROBLEM.held_in_flange(name, PART, *hold)
        own += reference(name).loads(HELD, PROBLEM.object(PART).shape, pose)
    return own


def gap(a: str, q_a: Array, b: str, q_b: Array, hold: Hold | None = None) -> float:
    """Least distance of two robots, the first of which has the beam by a hold; tools may touch it."""
    least = np.inf
    for one in parts(a, hold):
        for two in parts(b):
            if one.entity == HELD and two.entity == f"{b}/tool" and b != OTHER:
                continue
            frames = (
                reference(robot).joint_frame(q, body.joint)
                for robot, q, body in ((a, q_a, one), (b, q_b, two))
            )
            least = min(least, measure(one, next(frames), two, next(frames)))
    return least


@dataclass(frozen=True)
class Scene:
    """Two robots about where one would hand the beam to the other, and a third one beside them.

    Attributes:
        near, far: checks with the third robot there, and with it far away.
        hold: how the giver has the beam.
        at: where each robot is.
        way: where the giver comes from.
    """

    near: HandingScene
    far: HandingScene
    hold: Hold
    at: dict[str, Array]
    way: Array

    def room(self, q_giver: Array) -> float:
        """Return how much room there is between the two, and between both and the third."""
        taker, other = self.at[TAKER], self.at[OTHER]
        return min(
            gap(GIVER, q_giver, TAKER, taker, self.hold),
            gap(GIVER, q_giver, OTHER, other, self.hold),
            gap(TAKER, taker, OTHER, other),
        )


def near_a_meeting(seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    drawn = None
    while drawn is None:
        first, second = Hold(1, rng.uniform(-3, 3)), Hold(2, rng.uniform(-3, 3))
        drawn = bounds().draw_meeting((GIVER, TAKER), PART, (first, second), rng)
    q_giver, q_taker = (
        q + np.append(rng.uniform(-0.1, 0.1, 3), rng.uniform(-0.05, 0.05, len(q) - 3))
        for q in drawn.q
    )
    q_other = np.array(PROBLEM.cell.robot(OTHER).home)
    q_other[:2] = q_giver[:2] + rng.uniform(-2.0, 2.0, 2)
    away = np.array(q_other)
    away[:2] += 50.0
    near, far = (
        StepScenes(
            PROBLEM,
            FixedWorld(
                PROBLEM.cell, {OTHER: RobotTimeline(OTHER, np.zeros(1), q[None])}
            ),
            PART,
            (GIVER, TAKER),
        ).handing(GIVER, TAKER, GIVER, first)
        for q in (q_other, away)
    )
    at = {GIVER: q_giver, TAKER: q_taker, OTHER: q_other}
    return Scene(near, far, first, at, q_giver + rng.uniform(-0.3, 0.3, len(q_giver)))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 100_000))
def test_both_are_free_where_there_is_room_around_both_and_only_there(
    seed: int,
) -> None:
    scene = near_a_meeting(seed)
    q_giver, q_taker = scene.at[GIVER], scene.at[TAKER]
    room = scene.room(q_giver)
    free = scene.near.free(q_giver, q_taker, 5.0)
    if free:
        assert room >= LEAST - 2e-5
    # Each of them alone, among what lies still and its own links.
    alone = scene.far.giver.configuration_free(
        q_giver, 5.0
    ) and scene.far.taker.configuration_free(q_taker, 5.0)
    if alone and room >= LEAST + 0.002:
        assert free
    assert alone or not free


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 100_000))
def test_a_giver_that_is_called_apart_keeps_its_distance_all_the_way(seed: int) -> None:
    scene = near_a_meeting(seed)
    taker, path = scene.at[TAKER], np.array([scene.way, scene.at[GIVER]])
    room = [
        gap(GIVER, path[0] + share * (path[1] - path[0]), TAKER, taker, scene.hold)
        for share in np.linspace(0.0, 1.0, 15)
    ]
    if scene.far.apart(path, taker):
        assert min(room) >= LEAST - 2e-5
    else:
        assert min(room) < LEAST + 0.05


def test_scenes_of_handovers_are_both_free_and_not() -> None:
    scenes = [near_a_meeting(seed) for seed in range(40)]
    free = [s.near.free(s.at[GIVER], s.at[TAKER], 5.0) for s in scenes]
    assert 5 < sum(free) < 35
