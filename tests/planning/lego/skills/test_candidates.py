"""Which robot can do what, with which brick, and why not; how deep tools may go into bricks beside it, against a fine sampling."""

import json
from dataclasses import replace
from itertools import pairwise, product

import coal
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from planning.cell.workcell import Clearances, PlacedRobot, Workcell
from planning.errors import InfeasibleStepError
from planning.geometry.exact import hull_shape
from planning.handling.skill_trial import ResolvedSkill
from planning.kinematics.kinematics import frame_pose, joint_poses_of
from planning.lego.bricks.assembly import (
    Cell,
    LegoAssembly,
    LegoStep,
    Plate,
    Press,
    StockBrick,
    Support,
)
from planning.lego.bricks.brick_grips import grip_pose, legal_presses
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.brick_world import BrickWorld, grasp_number, press_from_number
from planning.lego.skills.brick_skills import BrickSkills
from planning.lego.skills.candidates import LegoCandidates, find_candidates
from planning.lego.skills.expansion import lego_work
from planning.lego.skills.targets import DEFAULT_TWIST, PRESSED
from planning.robots.registry import robot_model
from planning.steps.skill import Obstruction, SkillPath
from planning.tasks.assignment import (
    PrimaryCandidate,
    StepChoice,
    SupportCandidate,
    TaskPlan,
)
from planning.tasks.highs_solver import assign_steps
from planning.transforms import from_rpy, translation
from tests.assembly_section import assembly_section
from tests.planning.lego.importers.published_form import DATA, needs_data
from tests.planning.lego.skills.overhang import (
    STEPS,
    STOCK,
    facing_arms,
    found_overhang,
    overhang,
)
from tests.planning.tasks.plan_oracle import objective, plan_violations
from twin.audits.contacts import CONTACT_DEPTH

found = pytest.fixture(scope="module")(found_overhang)


def resolved(option: ResolvedSkill | Obstruction) -> ResolvedSkill:
    assert isinstance(option, ResolvedSkill), option
    return option


def robots_of(found: LegoCandidates, step: int) -> set[tuple[str, str, str | None]]:
    chosen = [found.problem.primaries[p] for p in found.problem.primaries_of[step]]
    return {(c.robot, c.object, c.partner) for c in chosen}


def test_each_robot_takes_the_bricks_that_it_reaches(found: LegoCandidates) -> None:
    # Step 1 is held by the left robot, step 2 by the right one: the other one places.
    reached = {name for _, name, _ in robots_of(found, 1)}
    assert reached == {"near_right", "upper", "lower"}
    assert robots_of(found, 1) == {("right", name, None) for name in reached}
    assert robots_of(found, 2) == {("left", "near_left", None)}
    supports = {(s.step, s.robot) for s in found.problem.supports}
    assert {(1, "left"), (2, "right")} <= supports


def test_only_bricks_of_the_right_type_and_prescription_are_candidates() -> None:
    steps = (replace(STEPS[0], stock="near_right"), *STEPS[1:])
    cell, assembly = overhang(steps=steps)
    found = find_candidates(cell, assembly)
    assert robots_of(found, 1) == {("right", "near_right", None)}
    assert {name for _, name, _ in robots_of(found, 3)} == {"small"}


def test_place_up_pairs_a_receiver_with_a_giver(found: LegoCandidates) -> None:
    assert robots_of(found, 3) == {("right", "small", "left")}


def test_a_brick_under_another_waits_for_it(found: LegoCandidates) -> None:
    for item in found.problem.primaries:
        assert ("upper" in item.after) == (item.object == "lower")


def test_costs_are_joint_distances_from_home(found: LegoCandidates) -> None:
    home = {robot.name: robot.home for robot in found.world.cell.robots}
    other = {"left": "right", "right": "left"}
    for item in found.problem.primaries:
        if item.partner is not None:
            continue
        beside = SupportCandidate(item.step, other[item.robot], 0, 0.0)
        place = resolved(found.skills.place(item.robot, item.step, item.grasp, beside))
        pick = resolved(found.skills.pick(item.robot, item.object, item.grasp))
        attach = pick.path.waypoints[2]
        top = found.world.start_top(item.object)
        kind = found.world.stock[item.object].brick
        tool = frame_pose(found.world.cell.robot(item.robot), attach, "tool")
        assert tool == pytest.approx(
            grip_pose(top, kind, press_from_number(item.grasp)), abs=1e-6
        )
        posts = (attach, place.path.waypoints[2])
        way = sum(float(np.abs(q - home[item.robot]).sum()) for q in posts)
        assert item.cost == pytest.approx(way)


def test_postures_stay_within_limits_and_do_not_flip(found: LegoCandidates) -> None:
    paths: list[SkillPath] = []
    for step, robot in product((1, 2, 3), ("left", "right")):
        option = found.skills.support(robot, step, 0)
        if isinstance(option, ResolvedSkill):
            paths.append(option.path)
    for item in found.problem.primaries:
        picker = item.partner or item.robot
        pick = found.skills.pick(picker, item.object, item.grasp)
        paths.append(resolved(pick).path)
    for path in paths:
        model = found.world.cell.robot(path.robot).model
        every = np.vstack([path.lead, path.path])
        assert (every >= model.lower).all()
        assert (every <= model.upper).all()
        assert np.abs(np.diff(every, axis=0)).max() < 1.3


def test_all_grips_are_tried_where_none_is_prescribed() -> None:
    steps = (replace(STEPS[0], presses=()), *STEPS[1:])
    found = find_candidates(*overhang(steps=steps), alternatives=28)
    tried = {c.grasp for c in found.problem.primaries if c.step == 1}
    assert len(tried) > 2
    some = find_candidates(*overhang(steps=steps), alternatives=2)
    kept = {c.grasp for c in some.problem.primaries if c.step == 1}
    assert kept < tried
    assert tried <= {grasp_number(p) for p in legal_presses(STEPS[0].brick)}
    for press in (Press(1, 0), Press(4, 6)):
        assert press_from_number(grasp_number(press)) == press


def test_a_brick_out_of_reach_is_explained() -> None:
    far = (StockBrick("far", BRICKS["1x8"], Cell(0, 0, 1)),)
    step = LegoStep(BRICKS["1x8"], Cell(40, 0, 1), presses=(Press(1, 3),))
    found = find_candidates(*overhang(stock=STOCK + far, steps=(step,)))
    with pytest.raises(InfeasibleStepError) as caught:
        assign_steps(found.problem)
    text = str(caught.value)
    assert "step 1 (place-down of 1x8 at [40, 0, 1])" in text
    assert "out of reach" in text


def test_a_blocked_goal_waits_until_the_brick_in_the_way_is_used() -> None:
    """Step 2's goal is where the brick of step 1 stands at the start."""
    start = STOCK[0].cell
    first = LegoStep(BRICKS["2x4"], Cell(16, 24, 1), presses=(Press(1, 1),))
    second = LegoStep(BRICKS["2x4"], start, presses=(Press(1, 1),))
    found = find_candidates(*overhang(steps=(first, second)))
    onto = [c for c in found.problem.primaries if c.step == 2 and c.robot == "left"]
    for item in onto:
        assert item.object == "near_left" or "near_left" in item.after
    plan = assign_steps(found.problem)
    assert plan_violations(found.problem, plan) == []
    assert plan[1].object == "near_left" or plan[2].object == "near_left"


def test_an_arm_that_stands_in_the_way_is_an_obstruction(
    found: LegoCandidates, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same place with the other arm at its support, and with that arm right there."""
    support = resolved(found.skills.support("left", 1, 0))
    grasp, left = grasp_number(Press(1, 0)), SupportCandidate(1, "left", 0, 0.0)
    resolved(found.skills.place("right", 1, grasp, left))
    own = resolved(found.skills.place("left", 1, grasp, None))
    stuck = replace(support.path, path=own.path.path[1:2])
    again = BrickSkills(found.world)
    monkeypatch.setattr(again, "support", lambda *_: replace(support, path=stuck))
    blocked = again.place("right", 1, grasp, left)
    assert isinstance(blocked, Obstruction)
    assert blocked.by is not None
    assert blocked.by.startswith("left/")


@needs_data
def test_the_published_cliff_gets_the_published_robots() -> None:
    from planning.lego.importers.apex_mr.importer import import_apex_mr
    from twin.kinds.lego.kind import build_lego
    from twin.kinds.lego.section import LegoSection
    from twin.planning.build_workcell import build_workcell
    from twin.scenario.sections.scenario import Scenario

    content = import_apex_mr(DATA, "cliff")
    scenario = Scenario.model_validate_json(json.dumps(content))
    lego = build_lego(assembly_section(scenario, LegoSection))
    found = find_candidates(build_workcell(scenario), lego)
    plan = assign_steps(found.problem)
    published = json.loads((DATA / "steps/cliff_seq.json").read_text())
    names = {0: None, 1: "left", 2: "right"}
    assert [(c.robot, c.support and c.support.robot) for c in plan.choices] == [
        (names[step["robot_id"]], names[step["sup_robot_id"]])
        for step in published.values()
    ]


OPEN = (
    replace(
        STEPS[0],
        presses=(),
        supports=(Support(Cell(23, 21, 7), 0), Support(Cell(24, 21, 7), 3)),
    ),
    LegoStep(BRICKS["2x4"], Cell(16, 24, 1)),
)
"""A step with two supports, one for each arm, and one without; any grip will do for both."""


def every_way(found: LegoCandidates, step: int) -> list[StepChoice]:
    """Return all ways of a step with all grips and supports, one by one, nothing left out."""
    skills, world = found.skills, found.world
    home = {robot.name: robot.home for robot in world.cell.robots}

    def cost(option: ResolvedSkill) -> float:
        return float(np.abs(option.path.contact - home[option.path.robot]).sum())

    helps: list[SupportCandidate | None] = [None]
    if world.step(step).supports:
        helps = [
            SupportCandidate(step, robot, pose, cost(option))
            for robot in home
            for pose in range(len(world.step(step).supports))
            for option in [skills.support(robot, step, pose)]
            if isinstance(option, ResolvedSkill) and not skills.after(option)
        ]
    out = []
    for robot, press in product(home, legal_presses(world.step(step).brick)):
        grasp = grasp_number(press)
        beside = {
            support: place
            for support in helps
            if support is None or support.robot != robot
            for place in [skills.place(robot, step, grasp, support)]
            if isinstance(place, ResolvedSkill)
        }
        for stock in world.usable_stock(step):
            pick = skills.pick(robot, stock, grasp)
            if not isinstance(pick, ResolvedSkill) or not beside:
                continue
            nearest = min(beside.values(), key=cost)
            after = (skills.after(nearest) | skills.after(pick)) - {stock}
            whole = cost(nearest) + cost(pick)
            item = PrimaryCandidate(
                step, robot, stock, grasp, whole, None, frozenset(after)
            )
            out += [StepChoice(item, support) for support in beside]
    return out


def test_the_cheapest_of_all_grips_and_supports_is_found() -> None:
    """What is left out unseen is never in a plan that is cheaper than the one found."""
    found = find_candidates(*overhang(steps=OPEN))
    kinds = [every_way(found, 1), every_way(found, 2)]
    grips = {(c.step, c.robot, c.object, c.grasp) for way in kinds for c in way}
    kept = {(c.step, c.robot, c.object, c.grasp) for c in found.problem.primaries}
    assert kept < grips, "nothing was left out, so that nothing is tested"
    assert len({c.support for c in kinds[0]}) >= 2
    assert {s.pose for s in found.problem.supports} == {0, 1}
    plans = (TaskPlan(pair) for pair in product(*kinds) if _allowed(pair))
    least = min(objective(found.problem, plan) for plan in plans)
    assert objective(found.problem, assign_steps(found.problem)) == pytest.approx(least)


def _allowed(pair: tuple[StepChoice, ...]) -> bool:
    first, second = pair
    used_once = first.object != second.object
    return (
        used_once and not first.primary.after and second.primary.after <= {first.object}
    )


def test_no_skill_costs_less_than_its_bound() -> None:
    found = find_candidates(*overhang(steps=OPEN))
    skills, checked = found.skills, 0
    for item in found.problem.primaries:
        pick = skills.least_pick(item.robot, item.object, item.grasp)
        place = skills.least_place(item.robot, item.step, item.grasp)
        assert pick + place <= item.cost + 1e-9
        assert 0.0 < skills.near_place(item.robot, item.step, item.grasp) <= place
        checked += 1
    assert checked > 20


def _three_arms(*stations: tuple[str, Cell]) -> LegoCandidates:
    """Return six bricks in a row between three arms, and a station at some places."""
    stock = tuple(
        StockBrick(name, BRICKS["2x4"], at, station=True) for name, at in stations
    )
    steps = tuple(LegoStep(BRICKS["2x4"], Cell(23, 14 + 4 * k, 1)) for k in range(6))
    plate = Plate(translation(0.44, 0.0, 1.1145))
    assembly = LegoAssembly(plate, stock, steps, DEFAULT_TWIST)
    cell = facing_arms(assembly)
    front = from_rpy((0.44, -0.44, 0.9246), (0, 0, np.pi / 2))
    gp4 = robot_model("gp4")
    third = PlacedRobot("front", gp4, front, gp4.home)
    return find_candidates(replace(cell, robots=(*cell.robots, third)), assembly)


LEFT, RIGHT = ("a", Cell(3, 17, 1)), ("b", Cell(43, 17, 1))


def test_three_arms_around_a_plate_take_turns() -> None:
    found = _three_arms(LEFT, RIGHT, ("c", Cell(17, 3, 1, turned=True)))
    robots = [choice.robot for choice in assign_steps(found.problem).choices]
    assert all(len(set(robots[k : k + 3])) == 3 for k in range(4)), robots


def test_an_arm_that_reaches_no_brick_leaves_the_others_as_they_were() -> None:
    found = _three_arms(("a", Cell(3, 40, 1)), ("b", Cell(43, 40, 1)))
    problem = found.problem
    assert problem.capable_robots == ("left", "right")
    two = replace(problem, robots=("left", "right"))
    assert assign_steps(problem) == assign_steps(two)
    robots = [choice.robot for choice in assign_steps(problem).choices]
    assert all(a != b for a, b in pairwise(robots)), robots


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
