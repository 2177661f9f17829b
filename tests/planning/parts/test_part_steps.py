"""Two arms lay two rods side by side and a third across them: who can and how, what waits for what.

Orders that are found: against brute force, against what lies on what, and past what blocks.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise, permutations
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from planning.cell.workcell import CellObject, Workcell
from planning.contacts.precedence import StepPrecedence
from planning.errors import InfeasibleStepError
from planning.grips.grip import DOWN, UP, GripRules
from planning.handling.skill_targets import STRIDE, SkillTargets
from planning.kinematics.kinematics import frame_pose
from planning.parts.assembly import (
    PartAssembly,
    PartHandling,
    PlacePart,
    Process,
    Spot,
    Work,
)
from planning.parts.candidates import PartCandidates, find_candidates
from planning.parts.order import find_ordered_candidates, order_steps_by_search
from planning.parts.part_skills import (
    SMALL_STRIDE,
    SMALL_TURN,
    SkillTry,
    pick_targets,
    place_targets,
    process_targets,
)
from planning.parts.part_steps import PartStep
from planning.parts.step_paths import Pairing
from planning.parts.work import part_work
from planning.steps.candidate_collector import CandidateCollector
from planning.steps.skill import Obstruction, Phase
from planning.tasks.assignment import PrimaryCandidate, TaskPlan
from planning.tasks.highs_solver import assign_steps
from planning.tasks.task import TaskKind
from planning.transforms import Transform, from_rpy, translation
from tests.planning.parts.boxes import built, part, two_arms
from tests.planning.tasks.plan_oracle import plan_violations, task_order

Direction = tuple[float, float, float]

ON_TABLE = 0.0125
RODS = {
    "south": ((0.0, -0.5, ON_TABLE), 0.0, (0.0, -0.06, ON_TABLE), 0.0),
    "north": ((0.0, 0.5, ON_TABLE), 0.0, (0.0, 0.06, ON_TABLE), 0.0),
    "across": ((0.15, -0.5, ON_TABLE), 0.0, (0.0, 0.0, 3 * ON_TABLE), np.pi / 2),
    "aside": ((0.15, 0.5, ON_TABLE), 0.0, (0.0, 0.3, ON_TABLE), 0.0),
}


def pose(xyz: tuple[float, float, float], yaw: float) -> Transform:
    return from_rpy(xyz, (0.0, 0.0, yaw))


def rod(name: str, start: Transform) -> CellObject:
    return part(name, (0.2, 0.024, 0.024), start, 0.05)


def two_arms_and_rods() -> Workcell:
    """Return two arms with the rods where they lie at the start."""
    rods = tuple(rod(k, pose(v[0], v[1])) for k, v in RODS.items())
    return replace(two_arms(), objects=rods)


def crossing(*steps: str) -> PartAssembly:
    goals = {k: pose(v[2], v[3]) for k, v in RODS.items()}
    usual = PartHandling(GripRules(positions=3))
    return built(goals, *(steps or ("south", "north", "across", "aside")), usual=usual)


@pytest.fixture(scope="module")
def found() -> PartCandidates:
    return find_candidates(two_arms_and_rods(), crossing())


@pytest.fixture(scope="module")
def plan(found: PartCandidates) -> TaskPlan:
    return assign_steps(found.problem)


def test_what_a_part_touches_is_found_from_the_poses(
    found: PartCandidates,
) -> None:
    across = found.steps[2]
    assert isinstance(across, PartStep)
    assert set(across.at_start) == {"table"}
    assert set(found.steps[0].touched) == {"table"}
    assert set(found.steps[2].touched) == {"south", "north"}
    assert set(found.steps[3].touched) == {"table"}


def test_every_candidate_brings_the_part_from_its_start_to_its_goal(
    found: PartCandidates, plan: TaskPlan
) -> None:
    assert plan_violations(found.problem, plan) == []
    assert {c.robot for c in plan.choices} == {"west", "east"}
    for item, (pick, place) in found.paths.unpaired.items():
        robot, step = found.cell.robot(item.robot), found.steps[item.step - 1]
        assert isinstance(item, PrimaryCandidate)
        assert isinstance(step, PartStep)
        grip = step.grips[item.grasp].pose
        for path, lying in ((pick, step.part.start), (place, step.place)):
            tool = frame_pose(robot, path.contact, "tool")
            np.testing.assert_allclose(tool, lying @ grip, atol=2e-4)


def test_only_parts_that_touch_wait_for_each_other(
    found: PartCandidates, plan: TaskPlan
) -> None:
    work = part_work(found)
    # Whoever does it: give the crossing rod to the other arm than one of those below it.
    steps, first = [], 0
    for choice in plan.choices:
        steps.append(work.expand(plan, choice.step, first))
        first += len(steps[-1].tasks)
    tasks = [task for step in steps for task in step.tasks]
    assert [t.index for t in tasks] == list(range(len(tasks)))
    place = {t.object: t for t in tasks if t.kind == "place-down"}
    expected = {
        (place[lower].index, place["across"].index)
        for lower in ("south", "north")
        if place[lower].robot != place["across"].robot
    }
    dependencies = work.link(steps)
    assert {tuple(pair) for pair in dependencies.tolist()} == expected
    task_order(tasks, dependencies)


def test_a_step_carries_its_part_over_home(
    found: PartCandidates, plan: TaskPlan
) -> None:
    step = part_work(found).expand(plan, 3, 20)
    robot = found.cell.robot(plan[3].robot)
    kinds = [task.kind for task in step.tasks]
    assert kinds == [
        TaskKind.TRANSIT,
        "pick",
        TaskKind.TRANSIT,
        TaskKind.TRANSIT,
        "place-down",
        TaskKind.TRANSIT,
    ]
    np.testing.assert_array_equal(step.tasks[2].path[-1], robot.home)
    np.testing.assert_array_equal(step.tasks[-1].path[-1], robot.home)
    (taken,), (put,) = step.tasks[1].handlings, step.tasks[4].handlings
    assert (taken.holder, put.holder) == (robot.name, None)
    np.testing.assert_allclose(put.pose, found.steps[2].place)
    allowed = {frozenset((c.first, c.second)): c.tasks for c in step.allowed}
    assert allowed[frozenset(("across", f"{robot.name}/tool"))] == {21, 22, 23, 24}
    assert allowed[frozenset(("across", "table"))] == {21}
    assert allowed[frozenset(("across", "south"))] == {24}
    assert not any("arm" in name for pair in allowed for name in pair)


def test_a_step_can_be_done_in_other_ways(
    found: PartCandidates, plan: TaskPlan
) -> None:
    alternatives = part_work(found).alternatives(3, plan, 0)
    (_, first), (other, second) = next(alternatives), next(alternatives)
    assert other[3] != plan[3]
    assert other[1] == plan[1]
    assert [t.kind for t in first.tasks] == [t.kind for t in second.tasks]


def refused() -> Iterator[tuple[str, str, Workcell, PartAssembly]]:
    """Yield what cannot be done, in words, with what is said of it."""
    cell, plain, two = two_arms_and_rods(), crossing(), crossing("south", "north")
    yield "nothing below", r"step 1 \(across\).*in the air", cell, crossing("across")
    there = {**two.goals, "north": pose((0.01, -0.05, ON_TABLE), 0.0)}
    taken = replace(two, goals=there)
    yield "another is there", r"step 2 \(north\).*where south is", cell, taken
    far = rod("south", pose((0.0, -0.95, ON_TABLE), 0.0))
    away = replace(cell, objects=(far, *cell.objects[1:]))
    yield "too far", r"(?s)south.*out of reach", away, crossing("south")
    narrow = replace(crossing("south"), usual=PartHandling(GripRules(opening=0.02)))
    yield "too wide", r"the tool opens to 20\.0 mm", cell, narrow
    # The upper rod comes from above: from below the lower ones are in its way.
    below = r"\(across\) leads through north .*into its place"
    yield "from below", below, cell, led(plain, "across", UP, UP)
    through = r"\(south\) leads through table .*where it starts"
    yield "out below", through, cell, led(plain, "south", DOWN, DOWN)


def led(
    plain: PartAssembly, part: str, insertion: Direction, extraction: Direction
) -> PartAssembly:
    """Return an assembly in which a part goes in and out in other directions."""
    ways = replace(plain.usual, insertion=insertion, extraction=extraction)
    return replace(plain, own={part: ways})


@pytest.mark.parametrize(
    ("words", "cell", "assembly"),
    [pytest.param(*case, id=name) for name, *case in refused()],
)
def test_what_cannot_be_done_is_refused_with_the_reason(
    words: str, cell: Workcell, assembly: PartAssembly
) -> None:
    with pytest.raises(InfeasibleStepError, match=words):
        assign_steps(find_candidates(cell, assembly).problem)


def test_a_part_may_be_led_in_from_above() -> None:
    assert find_candidates(two_arms_and_rods(), led(crossing(), "across", DOWN, UP))


@st.composite
def precedences(draw: st.DrawFn) -> StepPrecedence:
    count = draw(st.integers(1, 6))
    others = st.sets(st.integers(0, count - 1), max_size=3)
    before = tuple(dict.fromkeys(draw(others) - {k}, "so") for k in range(count))
    any_of = tuple(frozenset(draw(others) - {k}) for k in range(count))
    return StepPrecedence(tuple(map(str, range(count))), before, any_of)


def keeps(known: StepPrecedence, order: tuple[int, ...]) -> bool:
    for k, step in enumerate(order):
        done = set(order[:k])
        if not known.before[step].keys() <= done:
            return False
        if known.any_of[step] and not known.any_of[step] & done:
            return False
    return True


@given(precedences())
@settings(max_examples=300)
def test_the_order_is_the_first_of_all_that_keep_what_is_known(
    known: StepPrecedence,
) -> None:
    every = permutations(range(len(known.before)))
    expected = min((order for order in every if keeps(known, order)), default=None)
    assert known.order() == expected
    if expected is None:
        assert known.explained()


SIDE = 0.04


@given(st.permutations(range(6)), st.sets(st.integers(0, 5), max_size=6))
@settings(max_examples=60, deadline=None)
def test_blocks_are_stacked_from_below_whatever_the_list(
    listed: list[int], reversed_: set[int]
) -> None:
    """Two columns of three, whose stock lies in columns too: who is on top is taken first."""
    names = [f"{column}{level}" for column in "ab" for level in range(3)]
    goals, starts = {}, {}
    for k, name in enumerate(names):
        column, level = divmod(k, 3)
        goals[name] = translation(0.2 * column, 0.0, SIDE * (level + 0.5))
        turned = k in reversed_
        starts[name] = (
            translation(0.2 * column, 0.5, SIDE * (2.5 - level))
            if {3 * column, 3 * column + 1, 3 * column + 2} <= reversed_
            else translation(0.2 * column, -0.3 - 0.1 * level - 0.02 * turned, 0.02)
        )
    blocks = (part(n, (SIDE, SIDE, SIDE), starts[n], 0.05) for n in names)
    cell = replace(two_arms(), objects=tuple(blocks))
    order = order_steps_by_search(
        cell, built(goals, *(names[k] for k in listed))
    ).placed
    assert sorted(order) == names
    for first in "ab":
        assert [n for n in order if n[0] == first] == [f"{first}{k}" for k in range(3)]


def test_what_cannot_follow_is_explained() -> None:
    cell, assembly = two_arms_and_rods(), crossing("south", "north", "across")
    south, north, across = assembly.steps
    assert isinstance(south, PlacePart)
    circle = replace(assembly, steps=(replace(south, after=("across",)), north, across))
    with pytest.raises(InfeasibleStepError, match="across rests on south"):
        order_steps_by_search(cell, circle)
    hanging = replace(assembly, steps=(across, replace(south, part="aside", name="b")))
    with pytest.raises(InfeasibleStepError, match="in the air"):
        find_ordered_candidates(cell, hanging)


def test_a_process_comes_after_its_part_and_before_what_covers_it() -> None:
    cell, assembly = two_arms_and_rods(), crossing("across", "north", "south")
    hole = Work(
        process=Process("screw"),
        spot=Spot("south/hole", "south", None, translation(0.0, 0.0, 0.012)),
    )
    order = order_steps_by_search(
        cell, replace(assembly, steps=(*assembly.steps, hole))
    )
    words = [step.words for step in order.steps]
    assert words == [
        "pick and place north",
        "pick and place south",
        "screw south/hole",
        "pick and place across",
    ]


def test_a_part_goes_in_before_walls_between_which_no_hand_fits() -> None:
    """Nothing but a hand in the way tells that the low block comes before the walls."""
    wall = (0.1, 0.024, 0.12)
    goals = {
        "left": translation(0.0, -0.03, 0.0605),
        "right": translation(0.0, 0.03, 0.0605),
        "low": translation(0.0, 0.0, 0.0125),
    }
    objects = (
        part("left", wall, translation(-0.1, -0.4, 0.0605), 0.05),
        part("right", wall, translation(0.1, 0.4, 0.0605), 0.05),
        part("low", (0.1, 0.024, 0.024), translation(-0.1, 0.4, 0.0125), 0.05),
    )
    cell = replace(two_arms(), objects=objects)
    assembly = built(goals, *goals, usual=PartHandling(GripRules(positions=1)))
    assert order_steps_by_search(cell, assembly).placed == ("left", "right", "low")
    found = find_ordered_candidates(cell, assembly)
    assert found.problem.impossible == ()
    assert found.problem.steps[0] == "pick and place low"


GRIP = from_rpy((0.4, 0.1, 0.2), (np.pi, 0.5, 0.3))


@pytest.mark.parametrize("approach", [0.01, 0.03, 0.1])
@pytest.mark.parametrize("leave", [0.05, 1.0])
@pytest.mark.parametrize(
    ("targets", "name"), [(pick_targets, "pick"), (place_targets, "place-down")]
)
def test_ways_are_straight_and_as_long_as_asked_for(
    targets: Callable[[str, Transform, PartHandling], SkillTargets],
    name: str,
    approach: float,
    leave: float,
) -> None:
    """A pick comes along the tool and lifts straight up; a place the other way round."""
    skill = targets("tool", GRIP, PartHandling(approach=approach, leave=leave))
    assert (skill.skill, skill.lead) == (name, 1)
    points = np.array([item.pose[:3, 3] for item in skill.subgoals])
    at = skill.change_at
    assert at is not None
    np.testing.assert_allclose(points[at], GRIP[:3, 3])
    along, up = GRIP[:3, 2], np.array([0.0, 0.0, 1.0])
    came, left = (along, up) if name == "pick" else (-up, -along)
    np.testing.assert_allclose(points[at] - points[0], approach * came, atol=1e-12)
    np.testing.assert_allclose(points[-1] - points[at], leave * left, atol=1e-12)
    for way in (points[: at + 1], points[at:]):
        steps = np.diff(way, axis=0)
        assert np.linalg.norm(steps, axis=1).max() <= STRIDE + 1e-9
        np.testing.assert_allclose(steps, steps[:1].repeat(len(steps), 0))
    for item in skill.subgoals:
        np.testing.assert_allclose(item.pose[:3, :3], GRIP[:3, :3])


_METRES = hnp.arrays(np.float64, 3, elements=st.floats(-0.3, 0.3))
_ANGLES = hnp.arrays(np.float64, 3, elements=st.floats(-3.1, 3.1))
POSES = st.builds(lambda xyz, rpy: from_rpy(xyz, rpy), _METRES, _ANGLES)
PROCESSES = st.builds(
    Process,
    name=st.just("seal"),
    approach=st.floats(0.01, 0.2),
    path=st.lists(POSES, max_size=3).map(tuple),
)


def tip_of(place: Transform, tool: Transform) -> tuple[np.ndarray, np.ndarray]:
    """Return position and z axis of a tool pose in the frame of a place."""
    seen = np.linalg.inv(place) @ tool
    return seen[:3, 3], seen[:3, 2]


@given(PROCESSES, POSES, st.floats(-3.1, 3.1))
def test_the_tool_meets_every_pose_of_the_path_in_its_order(
    process: Process, place: Transform, turn: float
) -> None:
    found = process_targets(process, place, turn)
    way = found.targets.subgoals[found.first : found.last + 1]
    assert {subgoal.name for subgoal in way} == {"seal"}
    k = 0
    for wanted in process.path or (np.eye(4),):
        while True:
            at, z = tip_of(place, way[k].pose)
            met = np.allclose(at, wanted[:3, 3], atol=1e-9)
            if met and np.allclose(z, -wanted[:3, 2], atol=1e-7):
                break
            k += 1
            assert k < len(way), "the path never comes there"


@given(PROCESSES, POSES, st.floats(-3.1, 3.1))
def test_steps_are_small_and_straight(
    process: Process, place: Transform, turn: float
) -> None:
    found = process_targets(process, place, turn)
    subgoals = found.targets.subgoals
    for k, (a, b) in enumerate(pairwise(subgoals)):
        way = float(np.linalg.norm(b.pose[:3, 3] - a.pose[:3, 3]))
        turned = a.pose[:3, :3].T @ b.pose[:3, :3]
        angle = np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1))
        inside = found.first <= k < found.last
        assert way <= (SMALL_STRIDE if inside else STRIDE) + 1e-9
        assert angle <= (SMALL_TURN if inside else 0.0) + 1e-6
    for near, far in ((found.first, 0), (found.last, len(subgoals) - 1)):
        back = subgoals[far].pose[:3, 3] - subgoals[near].pose[:3, 3]
        out = -process.approach * subgoals[near].pose[:3, 2]
        np.testing.assert_allclose(back, out, atol=1e-9)


@given(POSES, st.floats(-3.1, 3.1), st.floats(-3.1, 3.1))
def test_a_turn_is_about_the_axis_of_the_place(
    place: Transform, one: float, other: float
) -> None:
    process = Process("screw")
    first, second = (
        process_targets(process, place, turn).targets.subgoals[-3].pose
        for turn in (one, other)
    )
    between = np.linalg.inv(place) @ second @ np.linalg.inv(first) @ place
    expected = from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, other - one))
    np.testing.assert_allclose(between[:3, :3], expected[:3, :3], atol=1e-9)


def test_what_is_in_the_way_where_a_straight_way_begins_says_which_key_is_its_length() -> (
    None
):
    tried = SkillTry(None, None, None, 0.06, 0.05)  # type: ignore[arg-type]
    words = [
        tried._with_remedy(Obstruction("a and slot touch", "slot", phase)).words
        for phase in (None, Phase.BEFORE, Phase.AFTER)
    ]
    assert words[0] == "a and slot touch"
    assert "begins, 60 mm away" in words[1]
    assert "approach_m makes it longer" in words[1]
    assert "ends, 50 mm away" in words[2]
    assert "leave_m makes it longer" in words[2]


def test_nobody_else_is_told_with_why() -> None:
    item = PrimaryCandidate(1, "left", "web", 0, 0.0)
    steps = [SimpleNamespace(step=SimpleNamespace(words=w)) for w in ("web", "screw")]
    found = CandidateCollector(())
    pairing = Pairing(SimpleNamespace(steps=steps), found)  # type: ignore[arg-type]
    found.reject(2, "left does it", "it is for right only", "left")
    found.reject(
        2, "right grips, 8 mm wide", "the tool would be 4.0 mm in screw", "right"
    )
    why = pairing._holding_rejection(item, 2, None)
    assert why.words == (
        "no other robot can do step 2 (screw) at all: right grips, 8 mm wide: the tool would be 4.0 mm"
        " in screw"
    )
    hit = Obstruction("right/arm and left/arm overlap by 3.0 mm", "left/arm")
    why = pairing._holding_rejection(item, 2, hit)
    assert why.words.endswith("meanwhile: right/arm and left/arm overlap by 3.0 mm")
