"""From choices to tasks: what is reached, what is held, who waits, who may touch."""

import networkx as nx
import numpy as np
import pytest

from planning.kinematics.kinematics import frame_pose
from planning.lego.bricks.assembly import Cell, LegoStep, Press, StockBrick
from planning.lego.bricks.brick_grips import grip_pose
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.grid import box_pose
from planning.lego.skills.candidates import LegoCandidates, find_candidates
from planning.lego.skills.expansion import PLACES, SUPPORTS, lego_work
from planning.tasks.assignment import StepChoice, TaskPlan
from planning.tasks.highs_solver import assign_steps
from planning.tasks.task import StepTasks, Task, TaskKind, apply_handlings
from planning.transforms import Transform
from tests.planning.lego.skills.overhang import found_overhang, overhang
from tests.planning.tasks.plan_oracle import task_order


def expand_plan(candidates: LegoCandidates, plan: TaskPlan) -> list[StepTasks]:
    """Return the tasks of all steps, numbered on from 0."""
    out: list[StepTasks] = []
    count = 0
    for choice in plan.choices:
        out.append(lego_work(candidates).expand(plan, choice.step, count))
        count += len(out[-1].tasks)
    return out


found = pytest.fixture(scope="module")(found_overhang)


@pytest.fixture(scope="module")
def plan(found: LegoCandidates) -> TaskPlan:
    return assign_steps(found.problem)


@pytest.fixture(scope="module")
def steps(found: LegoCandidates, plan: TaskPlan) -> list[StepTasks]:
    return expand_plan(found, plan)


@pytest.fixture(scope="module")
def tasks(steps: list[StepTasks]) -> list[Task]:
    return [task for step in steps for task in step.tasks]


@pytest.fixture(scope="module")
def waits(found: LegoCandidates, steps: list[StepTasks]) -> set[tuple[int, int]]:
    return {(int(a), int(b)) for a, b in lego_work(found).link(steps)}


def of_kind(tasks: list[Task], step: int, *kinds: str) -> Task:
    (task,) = [t for t in tasks if t.step == step and t.kind in kinds]
    return task


def test_indices_count_on_and_kinds_are_known(tasks: list[Task]) -> None:
    assert [task.index for task in tasks] == list(range(len(tasks)))
    assert {task.kind for task in tasks} == {*TaskKind.SKILLS} | {TaskKind.TRANSIT}
    assert {task.step for task in tasks} == {1, 2, 3}


def test_objects_never_jump_and_end_exactly_at_their_goals(
    found: LegoCandidates, plan: TaskPlan, tasks: list[Task]
) -> None:
    cell = found.world.cell
    state = cell.start_state()

    def where(name: str) -> Transform:
        at = state.attachments[name]
        if at.holder is None:
            return at.pose
        holder = cell.robot(at.holder)
        return frame_pose(holder, state.configurations[at.holder]) @ at.pose

    changes = 0
    for task in tasks:
        path = np.vstack([state.configurations[task.robot], task.path])
        for k, q in enumerate(path):
            state = state.with_robot(task.robot, q)
            for handling in task.handlings:
                if handling.waypoint == k:
                    before = where(handling.object)
                    state = apply_handlings(state, [handling])
                    changes += 1
                    assert where(handling.object) == pytest.approx(before, abs=1e-5)
    assert changes == 2 + 2 + 3
    for choice in plan.choices:
        step = found.world.step(choice.step)
        goal = box_pose(found.world.assembly.plate, step)
        at = state.attachments[choice.object]
        assert at.holder is None
        assert np.abs(at.pose - goal).max() < 1e-9


def test_robots_start_and_end_at_home(found: LegoCandidates, tasks: list[Task]) -> None:
    for robot in found.world.cell.robots:
        own = [task for task in tasks if task.robot == robot.name]
        assert own[-1].path[-1] == pytest.approx(robot.home)
        for step in (1, 2, 3):
            last = [t for t in own if t.step == step][-1]
            assert last.path[-1] == pytest.approx(robot.home)


def test_the_tool_is_where_the_press_says(
    found: LegoCandidates, plan: TaskPlan, tasks: list[Task]
) -> None:
    place = of_kind(tasks, 1, "place-down")
    (change,) = place.handlings
    robot = found.world.cell.robot(place.robot)
    tool = frame_pose(robot, place.path[change.waypoint - 1], "tool")
    kind = BRICKS["2x4"]
    expected = grip_pose(found.world.goal_top(1), kind, Press(1, 0))
    assert tool == pytest.approx(expected, abs=1e-6)
    assert place.object == plan[1].object


def test_transits_end_where_skills_start(
    found: LegoCandidates, tasks: list[Task]
) -> None:
    """One subgoal further is a centimetre or so: no skill starts with a long motion."""
    at = {robot.name: robot.home for robot in found.world.cell.robots}
    for task in tasks:
        if task.kind != TaskKind.TRANSIT:
            robot = found.world.cell.robot(task.robot)
            start = frame_pose(robot, at[task.robot], "tool")[:3, 3]
            first = frame_pose(robot, task.path[0], "tool")[:3, 3]
            assert 1e-4 < np.linalg.norm(first - start) < 0.02
        at[task.robot] = task.path[-1]


def test_support_comes_before_the_place_and_leaves_after_it(
    tasks: list[Task], waits: set[tuple[int, int]]
) -> None:
    for step in (1, 2, 3):
        held, placed = of_kind(tasks, step, *SUPPORTS), of_kind(tasks, step, *PLACES)
        assert held.robot != placed.robot
        back = next(t for t in tasks if t.robot == held.robot and t.index > held.index)
        assert (held.index, placed.index) in waits
        assert (placed.index, back.index) in waits


def test_places_and_supports_follow_the_place_before(
    tasks: list[Task], waits: set[tuple[int, int]]
) -> None:
    graph = task_order(tasks, waits)
    for step in (2, 3):
        before = of_kind(tasks, step - 1, *PLACES)
        for kinds in (PLACES, SUPPORTS):
            later = of_kind(tasks, step, *kinds)
            assert nx.has_path(graph, before.index, later.index)


def test_the_receiver_is_ready_and_takes_the_brick_away_after(
    tasks: list[Task], waits: set[tuple[int, int]]
) -> None:
    given = of_kind(tasks, 3, "handover")
    receiver = of_kind(tasks, 3, "place-up").robot
    own = [t for t in tasks if t.step == 3 and t.robot == receiver]
    ready = [t for t in own if t.index < given.index][-1]
    taken = next(t for t in own if t.index > given.index)
    assert (ready.index, given.index) in waits
    assert (given.index, taken.index) in waits
    assert given.handlings[0].holder == receiver
    assert given.object == "small"


def test_stacked_stock_goes_from_the_top() -> None:
    """One robot takes the upper brick, the other one the lower, in two plain steps."""
    stock = (
        StockBrick("upper", BRICKS["2x4"], Cell(23, 38, 2)),
        StockBrick("lower", BRICKS["2x4"], Cell(23, 38, 1)),
    )
    goals = (
        LegoStep(BRICKS["2x4"], Cell(16, 30, 1), presses=(Press(1, 1),), stock="upper"),
        LegoStep(BRICKS["2x4"], Cell(30, 30, 1), presses=(Press(4, 1),), stock="lower"),
    )
    found = find_candidates(*overhang(stock=stock, steps=goals))
    primaries = found.problem.primaries
    left = next(c for c in primaries if (c.step, c.robot) == (1, "left"))
    right = next(c for c in primaries if (c.step, c.robot) == (2, "right"))
    steps = expand_plan(found, TaskPlan((StepChoice(left), StepChoice(right))))
    tasks = [task for step in steps for task in step.tasks]
    first, second = (of_kind(tasks, step, "pick") for step in (1, 2))
    assert (first.object, second.object) == ("upper", "lower")
    pairs = {(int(a), int(b)) for a, b in lego_work(found).link(steps)}
    places = (of_kind(tasks, step, "place-down") for step in (1, 2))
    assert pairs == {
        (first.index, second.index),
        tuple(place.index for place in places),
    }


def test_only_tools_bricks_and_fixtures_may_touch(
    found: LegoCandidates, steps: list[StepTasks]
) -> None:
    cell = found.world.cell
    tools = {f"{robot.name}/tool" for robot in cell.robots}
    known = tools | {o.name for o in cell.objects} | {f.name for f in cell.fixtures}
    for step in steps:
        indices = {task.index for task in step.tasks}
        for contact in step.allowed:
            assert {contact.first, contact.second} <= known
            assert not {contact.first, contact.second} <= tools
            assert contact.tasks <= indices


def test_a_tool_touches_its_brick_from_pick_to_place(
    steps: list[StepTasks], tasks: list[Task]
) -> None:
    for step in (1, 2):
        picked = of_kind(tasks, step, "pick")
        placed = of_kind(tasks, step, "place-down")
        names = {f"{picked.robot}/tool", picked.object}
        allowed = steps[step - 1].allowed
        (contact,) = [c for c in allowed if {c.first, c.second} == names]
        between = tasks[picked.index : placed.index + 1]
        assert {t.index for t in between if t.robot == picked.robot} <= contact.tasks


def test_alternatives_of_a_step_differ_and_come_with_their_plan(
    found: LegoCandidates, plan: TaskPlan
) -> None:
    alternatives = lego_work(found).alternatives(1, plan, 0)
    planned, first = next(alternatives)
    assert planned == plan
    other, second = next(alternatives)
    assert other[1] != plan[1]
    assert other[2] == plan[2]
    assert [t.kind for t in second.tasks] == [t.kind for t in first.tasks]
    assert {t.object for t in second.tasks} >= {other[1].object}
    assert second.tasks[0].index == 0


def test_everything_can_be_planned_in_sequence(
    found: LegoCandidates, plan: TaskPlan
) -> None:
    from planning.motion.sequential import MotionSettings, plan_motions_sequentially
    from planning.motion.speed import L1Speed
    from planning.motion.transit import RrtConnect

    robots = found.world.cell.robots
    speeds = {robot.name: L1Speed(1.0) for robot in robots}
    planners = {
        r.name: RrtConnect(r.model.lower, r.model.upper, speeds[r.name]) for r in robots
    }
    durations = dict.fromkeys(TaskKind.SKILLS, 8.0)
    _, motion = plan_motions_sequentially(
        found.world.cell,
        lego_work(found),
        plan,
        MotionSettings(planners, speeds, 0.05, durations),
    )
    assert len(motion.tasks) == len(motion.motions)
    assert motion.motions[-1].time[-1] > 8.0 * 3
