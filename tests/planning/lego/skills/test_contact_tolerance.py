"""How deep a tool may go into bricks beside the one that it handles, against a fine sampling."""

from itertools import pairwise

import coal
import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from planning.cell.workcell import Clearances, Workcell
from planning.geometry.exact import hull_shape
from planning.kinematics.kinematics import joint_poses_of
from planning.lego.bricks.assembly import (
    BRICKS,
    Cell,
    LegoAssembly,
    LegoStep,
    Plate,
    Press,
    StockBrick,
)
from planning.lego.bricks.brick_world import BrickWorld, grasp_number
from planning.lego.skills.brick_skills import BrickSkills
from planning.lego.skills.candidates import find_candidates
from planning.lego.skills.expansion import lego_work
from planning.lego.skills.targets import DEFAULT_TWIST, PRESSED
from planning.steps.skill import Obstruction, SkillPath
from planning.steps.skill_trial import ResolvedSkill
from planning.tasks.highs_solver import assign_steps
from planning.transforms import translation
from tests.planning.lego.skills.overhang import facing_arms
from twin.audit.contacts import CONTACT_DEPTH

KIND = BRICKS["2x4"]
TOLERANCE = Clearances().contact_tolerance
STEP = LegoStep(KIND, Cell(30, 34, 1))


def world(
    *beside: Cell, tolerance: float = TOLERANCE, **step: object
) -> tuple[Workcell, LegoAssembly]:
    """A brick ``a`` to be picked, and bricks beside it that stay."""
    plate = Plate(translation(0.45, 0.0, 1.1145))
    stock = (
        StockBrick("a", KIND, Cell(20, 20, 1)),
        *(
            StockBrick(f"n{k}", KIND, at, fixed=True)
            for k, at in enumerate(beside, start=1)
        ),
    )
    goal = LegoStep(KIND, Cell(30, 34, 1), **step)  # type: ignore[arg-type]
    assembly = LegoAssembly(plate, stock, (goal,), DEFAULT_TWIST)
    cell = facing_arms(assembly, Clearances(0.001, 0.0, tolerance))
    return cell, assembly


def pick_beside(
    *beside: Cell, side: int = 1, offset: int = 0, robot: str = "left", **more: object
) -> tuple[Workcell, ResolvedSkill | Obstruction]:
    cell, assembly = world(*beside, **more)  # type: ignore[arg-type]
    options = BrickSkills(BrickWorld(cell, assembly))
    press = grasp_number(Press(side, offset))
    return cell, options.pick(robot, "a", press)


def deepest(cell: Workcell, path: SkillPath, name: str) -> float:
    """Greatest overlap of the tool and an object, a tenth of a millimetre of motion apart."""
    robot, item = cell.robot(path.robot), cell.object(name)
    box = coal.Box(*(float(v) for v in item.size))
    at = coal.Transform3s(item.start[:3, :3], item.start[:3, 3])
    parts = [p for p in robot.model.parts if p.group == "tool"]
    deep = -np.inf
    for q_a, q_b in pairwise(path.waypoints):
        for t in np.linspace(0.0, 1.0, 60):
            poses = joint_poses_of(robot, q_a + t * (q_b - q_a))
            for part in parts:
                pose = poses[part.joint + 1]
                there = coal.Transform3s(pose[:3, :3], pose[:3, 3])
                gap = coal.distance(
                    hull_shape(part.body),
                    there,
                    box,
                    at,
                    coal.DistanceRequest(),
                    coal.DistanceResult(),
                )
                deep = max(deep, -gap)
    return deep


ONE_STUD_AWAY = Cell(17, 20, 1)
"""On the side of the lever."""


def test_a_brick_one_stud_away_is_in_nobodys_way() -> None:
    """On the lever's side the tool leans on it, at the ends it passes it a hair's breadth off."""
    for at, leans in (
        (ONE_STUD_AWAY, True),
        (Cell(17, 24, 1), False),
        (Cell(20, 25, 1), None),
        (Cell(23, 20, 1), None),
    ):
        cell, found = pick_beside(at, offset=2)
        assert isinstance(found, ResolvedSkill), (at, found)
        assert found.touched == ({} if leans is None else {"n1": leans})
        if leans is not None:
            limit = PRESSED if leans else TOLERANCE
            assert deepest(cell, found.path, "n1") <= limit
    for robot in ("left", "right"):
        cell, found = pick_beside(ONE_STUD_AWAY, robot=robot)
        assert isinstance(found, ResolvedSkill)
        assert 0.00207 <= deepest(cell, found.path, "n1") <= 0.0027


def test_a_lever_does_not_go_into_the_brick_at_its_side() -> None:
    """The wall is as thick as the gap of a stud: it has no place beside a brick that touches."""
    _, found = pick_beside(Cell(18, 20, 1))
    assert not isinstance(found, ResolvedSkill)
    assert "press" in found.words
    assert found.by == "n1"


def test_leaning_is_no_deeper_than_the_audit_lets_pass() -> None:
    assert PRESSED == CONTACT_DEPTH


@settings(max_examples=25, deadline=None)
@example(-3, 4, 1, 2, TOLERANCE)
@example(-3, 0, 1, 0, TOLERANCE)
@example(2, 0, 4, 1, 0.0)
@given(
    st.integers(-4, 4),
    st.integers(-6, 6),
    st.integers(1, 4),
    st.integers(0, 2),
    st.sampled_from([0.0, TOLERANCE, 0.001]),
)
def test_no_pick_goes_deeper_than_it_says(
    dx: int, dy: int, side: int, offset: int, tolerance: float
) -> None:
    """Oracle: the overlap sampled along the skill, for bricks all around, on every side."""
    if abs(dx) < 2 and abs(dy) < 4:
        dy = 4 if dy >= 0 else -4
    if side in (2, 3):
        offset = 0
    at = Cell(20 + dx, 20 + dy, 1)
    cell, found = pick_beside(at, side=side, offset=offset, tolerance=tolerance)
    if not isinstance(found, ResolvedSkill):
        return
    deep = deepest(cell, found.path, "n1")
    beside = abs(dx) <= 2 and abs(dy) <= 4
    leans = found.touched.get("n1", beside)
    assert deep <= (PRESSED if leans else tolerance) + 1e-6


def test_the_plan_says_who_grazes_and_who_leans() -> None:
    for at, offset, grazing in ((Cell(17, 24, 1), 2, True), (ONE_STUD_AWAY, 0, False)):
        cell, assembly = world(at, presses=(Press(1, offset),))
        found = find_candidates(cell, assembly)
        plan = assign_steps(found.problem)
        tasks = lego_work(found).expand(plan, 1, 0)
        pick = next(task for task in tasks.tasks if task.kind == "pick")
        touched = [c for c in tasks.allowed if {c.first, c.second} & {"n1"}]
        touched = [c for c in touched if f"{pick.robot}/tool" in (c.first, c.second)]
        assert [(c.tasks, c.grazing) for c in touched] == [
            (frozenset([pick.index]), grazing)
        ]
