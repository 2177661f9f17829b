"""One robot changes its tools at a rack, in random lists of steps and in the shipped gearbox."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import twin
from planning.cell.workcell import PlacedRobot
from planning.errors import InfeasibleStepError
from planning.tasks.task import Task, TaskKind
from scheduling.build_nodes import build_nodes
from scheduling.hand_loads import hand_loads
from scheduling.verification.verify import verify_plan
from tests.twin.operations.operated import operated
from tests.twin.operations.operated import planned as operated_plan
from tests.twin.written import loaded, written
from twin.scenario.sections.scenario import resolve_scenario, restore_scenario
from twin.trial.plan_result import PlanResult, given_plan
from twin.trial.planning import plan_scenario
from twin.trial.run_plan import run_plan_to_folder

TOOLS = ("gripper", "driver", "nozzle")

SCENARIO = """\
version: 1
name: changer
cell:
  tools:
    gripper:
      shapes:
        - {box: [0.06, 0.1, 0.06], pose: {xyz_m: [0, 0, 0.03]}}
        - {box: [0.02, 0.01, 0.06], pose: {xyz_m: [0, 0.045, 0.09]}}
        - {box: [0.02, 0.01, 0.06], pose: {xyz_m: [0, -0.045, 0.09]}}
      tcp: {xyz_m: [0, 0, 0.115]}
      opening_m: 0.08
      rack: {xyz_m: [-0.35, 0.3, 0.2], rpy_deg: [180, 0, 0]}
    driver:
      shapes: [{cylinder: {radius_m: 0.02, length_m: 0.14}, pose: {xyz_m: [0, 0, 0.07]}}]
      tcp: {xyz_m: [0, 0, 0.14]}
      opening_m: 0
      rack: {xyz_m: [-0.2, 0.3, 0.2], rpy_deg: [180, 0, 0], change_s: 3}
    nozzle:
      shapes: [{cylinder: {radius_m: 0.015, length_m: 0.1}, pose: {xyz_m: [0, 0, 0.05]}}]
      tcp: {xyz_m: [0, 0, 0.1]}
      frames: {side: {xyz_m: [0, 0, 0.1]}}
      opening_m: 0
      rack: {xyz_m: [-0.05, 0.3, 0.2], rpy_deg: [180, 0, 0]}
  robots:
    - {name: arm, model: ur5e, tools: [gripper, driver, nozzle], base: {xyz_m: [-0.4, 0, 0]}}
  fixtures:
    - name: table
      size_m: [1.8, 1.2, 0.04]
      pose: {xyz_m: [0, 0, -0.02]}
      frames:
        a: {xyz_m: [0, 0.1, 0.02]}
        b: {xyz_m: [0.1, -0.1, 0.02]}
assembly:
  kind: assembly
  grips: {depth_m: 0.02, positions: 3}
  parts:
    - {name: block, size_m: [0.06, 0.04, 0.04], start: {xyz_m: [-0.1, -0.3, 0.02]}, goal: {xyz_m: [0.05, 0, 0.02]}}
  processes:
    screw: {duration: {kind: fixed, value_s: 1}, tool: driver}
    seal: {duration: {kind: fixed, value_s: 1}, tool: nozzle, frame: side}
    look: {duration: {kind: fixed, value_s: 1}, turns: 2}
  steps: [STEPS]
planning: {speed_model: joint, shortcut_candidates: 200}
execution:
  skills: {pick: {kind: fixed, value_s: 1}, place-down: {kind: fixed, value_s: 1}}
"""

WORK = ("screw", "seal", "look")


def scenario_text(steps: list[str]) -> str:
    """Return a scenario with these steps: the block is placed, or work is done somewhere."""
    spots = "ab"
    written = [
        name
        if name == "block"
        else f"{{process: {name}, at: {{fixture: table, frame: {spots[k % 2]}}}}}"
        for k, name in enumerate(steps)
    ]
    return SCENARIO.replace("STEPS", ", ".join(written))


def planned_steps(steps: list[str], folder: Path) -> PlanResult:
    return plan_scenario(loaded(folder, scenario_text(steps)), folder)


def tools_on(
    arm: PlacedRobot, tasks: Iterable[Task]
) -> Iterator[tuple[Task, str | None]]:
    """Yield every task with the tool that the arm has on it as the task begins.

    Every tool is in one place only: on the arm, or in its rack, and there for whoever takes it.
    """
    racks = {tool.name: tool.rack for tool in arm.tools}
    lies: dict[str, bool] = dict.fromkeys(racks, True)
    on_it: str | None = None
    for task in tasks:
        yield task, on_it
        for handling in task.handlings:
            if handling.object not in racks:
                continue
            if handling.holder is None:
                assert on_it == handling.object
                assert (handling.pose == racks[handling.object]).all()
                on_it, lies[handling.object] = None, True
            else:
                assert on_it is None
                assert lies[handling.object]
                on_it, lies[handling.object] = handling.object, False


def works_with_their_tools(arm: PlacedRobot, tasks: Iterable[Task]) -> list[str]:
    """Return the kinds of all skills in order, after checking the tool of each."""
    needs = {"screw": {"driver"}, "seal": {"nozzle"}, "look": set(TOOLS)}
    needs |= {kind: {"gripper"} for kind in ("pick", "place-down")}
    done: list[str] = []
    for task, tool in tools_on(arm, tasks):
        if task.kind in needs:
            assert tool in needs[task.kind]
            done.append(task.kind)
    return done


def least_changes(steps: list[str]) -> int:
    """Return the fewest changes: a step that any tool can do needs none."""
    needs = {"block": "gripper", "screw": "driver", "seal": "nozzle"}
    needed = [needs[name] for name in steps if name in needs]
    return sum(a != b for a, b in zip(["gripper", *needed], needed, strict=False))


@settings(
    max_examples=6,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    st.lists(st.sampled_from(WORK), min_size=1, max_size=4),
    st.integers(0, 4),
)
def test_every_step_is_done_with_its_tool(
    tmp_path: Path, work: list[str], at: int
) -> None:
    steps = [*work[:at], "block", *work[at:]]
    plan = planned_steps(steps, tmp_path).motions.motion_plan
    done = works_with_their_tools(plan.cell.robots[0], plan.tasks)
    kinds = [task.kind for task in plan.tasks]
    wanted = [
        k for s in steps for k in (("pick", "place-down") if s == "block" else (s,))
    ]
    assert done == wanted
    assert (
        kinds.count(TaskKind.TAKE_TOOL)
        == kinds.count(TaskKind.LEAVE_TOOL)
        == least_changes(steps)
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("changer")


@pytest.fixture(scope="module")
def planned(folder: Path) -> PlanResult:
    return planned_steps(["screw", "block", "seal"], folder)


def audited(planned: PlanResult, folder: Path, name: str, **changed: Any) -> list[str]:
    """Return what the audit finds in a run of a plan with some fields changed."""
    out = folder / name
    out.mkdir()
    tpg = replace(planned.tpg, **changed)
    trial = run_plan_to_folder(given_plan(planned.scenario, tpg), out, recording=False)
    return [
        f"{v['kind']}: {v['first']} {v['detail']}"
        for v in trial.summary["audit"]["violations"]
    ]


def test_a_plan_with_changes_is_clean_and_safe_and_takes_the_time_of_its_racks(
    planned: PlanResult, folder: Path
) -> None:
    assert audited(planned, folder, "good") == []
    assert verify_plan(planned.tpg).ok
    took, plan = {}, planned.motions.motion_plan
    for task, motion in zip(plan.tasks, plan.motions, strict=True):
        if task.kind in (TaskKind.TAKE_TOOL, TaskKind.LEAVE_TOOL):
            took[task.object] = motion.time[-1] - motion.time[0]
    assert took == pytest.approx({"gripper": 2.0, "driver": 3.0, "nozzle": 2.0})


def test_the_audit_finds_work_with_the_wrong_tool(
    planned: PlanResult, folder: Path
) -> None:
    """The arm goes to the racks and changes nothing there: it screws with its gripper."""
    kept = tuple(
        h
        for h in planned.tpg.handlings
        if h.object not in ("driver", "nozzle")
        and not (h.object == "gripper" and (h.node, h.waypoint) > (0, 0))
    )
    found = audited(planned, folder, "kept", handlings=kept)
    assert any("was done with gripper, not driver" in line for line in found)
    assert any("was done with gripper, not nozzle" in line for line in found)


def test_the_audit_finds_two_tools_on_one_robot_and_one_that_is_left_elsewhere(
    planned: PlanResult, folder: Path
) -> None:
    both = tuple(
        h
        for h in planned.tpg.handlings
        if not (h.object == "gripper" and h.holder is None)
    )
    found = audited(planned, folder, "both", handlings=both)
    words = "tool: driver is on arm along with gripper"
    assert any(line.startswith(words) for line in found)
    moved = []
    for handling in planned.tpg.handlings:
        pose = handling.pose.copy()
        if handling.object == "driver" and handling.holder is None:
            pose[0, 3] += 0.01
        moved.append(replace(handling, pose=pose))
    found = audited(planned, folder, "moved", handlings=tuple(moved))
    assert any("tool: driver is 10.00 mm off its rack" in line for line in found)


def test_what_is_written_down_reads_as_the_same_scenario(tmp_path: Path) -> None:
    own = ", change_s: 3}", ", change: {kind: uniform, low_s: 2, high_s: 3}}"
    for changes in ((), (own,)):
        scenario = loaded(tmp_path, scenario_text(["block"]), *changes)
        assert restore_scenario(resolve_scenario(scenario)) == scenario


def test_a_rack_that_is_out_of_reach_is_said(tmp_path: Path) -> None:
    far = "[-0.2, 0.3, 0.2]", "[1.2, 0.3, 0.2]"
    scenario = loaded(tmp_path, scenario_text(["screw"]), far)
    with pytest.raises(
        InfeasibleStepError, match=r"arm cannot change driver at its rack: .*reach"
    ):
        plan_scenario(scenario, tmp_path)


def two_armed() -> str:
    """Return a cell in which a second arm has tools of its own, and holds what the other works at."""
    one = scenario_text(["block"])
    mine = one[one.index("    gripper:") : one.index("  robots:")]
    racks = [line for line in mine.splitlines() if "rack:" in line]
    other = mine
    for name in TOOLS:
        other = other.replace(f"    {name}:", f"    other_{name}:")
    for line in racks:
        other = other.replace(line, line.replace("xyz_m: [-", "xyz_m: ["))
    long = one.replace(mine, mine + other)
    long = long.replace(
        "  fixtures:\n",
        "    - {name: second, model: ur5e, tools: [other_driver, other_gripper],"
        " base: {xyz_m: [0.5, 0, 0], rpy_deg: [0, 0, 180]}}\n  fixtures:\n",
    )
    long = long.replace(
        "{name: block, size_m: [0.06, 0.04, 0.04], start: {xyz_m: [-0.1, -0.3, 0.02]},"
        " goal: {xyz_m: [0.05, 0, 0.02]}}",
        "{name: block, size_m: [0.3, 0.06, 0.04], start: {xyz_m: [-0.2, -0.3, 0.02]},"
        " goal: {xyz_m: [0, 0, 0.02]}, frames: {end: {xyz_m: [-0.12, 0, 0.02]}}}",
    )
    work = "{process: screw, at: {part: block, frame: end}, hold: block}"
    return long.replace("steps: [block]", f"steps: [block, {work}]").replace(
        "execution:\n", "execution:\n  latency_s: 0.05\n"
    )


@pytest.mark.nightly
def test_both_arms_change_for_one_step(tmp_path: Path) -> None:
    """One takes a driver, and the other the gripper with which it holds what is worked at."""
    found = plan_scenario(loaded(tmp_path, two_armed()), tmp_path)
    taken = [
        (t.robot, t.object) for t in found.tpg.tasks if t.kind == TaskKind.TAKE_TOOL
    ]
    assert taken == [("arm", "driver"), ("second", "other_gripper")]
    assert audited(found, tmp_path, "run") == []
    assert verify_plan(found.tpg).ok


def test_what_is_in_hand_is_known_node_by_node(planned: PlanResult) -> None:
    plan = planned.motions.motion_plan
    tpg = build_nodes(plan)
    (loads,) = hand_loads(tpg)
    chain = tpg.chains[0]
    holds = False
    seen = set()
    for task, on_it in tools_on(plan.cell.robots[0], plan.tasks):
        nodes = np.flatnonzero(chain.task == task.index)
        if len(nodes):
            load = loads.after(int(nodes[0]), 0)
            first = [h for h in task.handlings if h.waypoint == 0]
            if not first:
                assert (None if load.tool is None else load.tool.name) == on_it
                assert [part.name for part, _ in load.parts] == ["block"] * holds
            seen.add((on_it, holds))
        for handling in task.handlings:
            if handling.object == "block":
                holds = handling.holder == "arm"
    assert {("driver", False), ("gripper", True), ("nozzle", False)} <= seen
    for node in range(len(chain)):
        waypoints = int(chain.first[node + 1] - chain.first[node]) + 1
        runs = loads.runs(node, waypoints)
        assert [runs[0][0], runs[-1][1]] == [0, waypoints - 1]
        for begin, end, load in runs:
            for waypoint in range(begin, end):
                assert loads.after(node, waypoint) is load


AT_RACKS = """\
  failures:
    leave-tool: {probability: 0.5, retries: 0}
    take-tool: {probability: 0.4, retries: 0}
    place-down: {probability: 0.3, retries: 0}
  recovery: {again: 0, shortcuts: 0}
"""


@pytest.fixture(scope="module")
def failing(folder: Path) -> PlanResult:
    """A plan whose attempts to change tools fail for good, so that their steps are given up."""
    text = scenario_text(["screw", "seal", "block"]) + AT_RACKS
    return operated_plan(written(folder, text, name="failing.yaml"))


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10_000))
@example(2)  # the flange is bare when a step is given up
@example(7)
def test_a_plan_after_a_failure_begins_with_what_is_on_the_flange(
    failing: PlanResult, seed: int
) -> None:
    done, _ = operated(failing, seed)
    works_with_their_tools(failing.tpg.cell.robots[0], done.tpg.tasks)
    whys = set(done.given_up.values())
    assert all(why.endswith("failed 1 times") for why in whys), "for no other reason"


@pytest.mark.parametrize(
    "seed",
    [
        32,  # nothing has changed when the first step is given up
        pytest.param(48, marks=pytest.mark.nightly),  # the flange is bare then
    ],
)
def test_what_is_left_of_a_run_begins_with_what_is_on_the_flange(
    failing: PlanResult, folder: Path, seed: int
) -> None:
    """It has taken the nozzle without a driver before, other than in the first plan."""
    case, out = failing.scenario.varied({"seed": seed}), folder / f"left{seed}"
    run = twin.operate(case, out=out, recording=False, audit=False)
    assert run.summary["operation"]["given_up"].keys() == {"1"}
    (seal,) = (task.index for task in run.tpg.tasks if task.kind == "seal")
    _, end_ns = run.node_times_ns[0]
    t_s = end_ns[run.tpg.chains[0].task == seal][-1] / 1e9 + 0.1
    left = twin.plan(world=twin.RunMoment(run, t_s)).tpg.tasks
    arm = failing.tpg.cell.robots[0]
    assert works_with_their_tools(arm, left) == ["pick", "place-down"]
