"""Gripping takes its time: a tool closes and opens while its robot stands, and what that does to plans and runs."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.tasks.task import Actuation
from scheduling.graph.actuations import actuation_nodes
from scheduling.graph.plan_files import load_plan, save_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.verify import verify_plan
from tests.assembly_section import assembly_section
from tests.twin.recorders.recorded_toys import recorded_run, rows
from tests.twin.scenarios.cells import cell, panda
from tests.twin.scenarios.executed import executed
from tests.twin.simulated import assert_same_ends
from tests.twin.written import checked, written
from twin.activities.activities import robot_activities
from twin.engine.engine import Simulator
from twin.fit.samples import logged_skills
from twin.kinds.parts.section import PartsSection
from twin.reading.scenario_file import load_scenario
from twin.rerun.entities import entity_path, robot_part
from twin.rerun.fingers import finger_motions
from twin.runs.execution_record import Policy
from twin.runs.trajectory import object_placements
from twin.scenario.sections.scenario import Scenario
from twin.studies.replications.timing_graph import timing_graph
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.run_result import RunResult
from twin.trial.simulation import scenario_execution, skill_durations

PARTS = """\
  kind: assembly
  grips: {{positions: 3{grips}}}
  parts:
    - name: south
      size_m: [0.2, 0.024, 0.024]
      start: {{xyz_m: [-0.15, -0.45, 0.0125]}}
      goal: {{xyz_m: [0, -0.06, 0.0125]}}
    - name: north
      size_m: [0.2, 0.024, 0.024]
      start: {{xyz_m: [-0.15, 0.4, 0.0125]}}
      goal: {{xyz_m: [0, 0.06, 0.0125]}}
  steps: [south, north]
{execution}"""
ONE, TWO = (panda("west", -0.5),), (panda("west", -0.5), panda("east", 0.5))


def scenario_text(
    grips: str = "", execution: str = "", robots: tuple[str, ...] = ONE
) -> str:
    more = f", {grips}" if grips else ""
    return cell("gripping", robots, PARTS.format(grips=more, execution=execution))


SCENARIO = scenario_text(
    "close_s: {kind: uniform, low_s: 0.3, high_s: 0.6}, open_s: 0.25", "", TWO
)


def planned_from(folder: Path, text: str) -> tuple[Scenario, TemporalPlanGraph]:
    file = written(folder, text)
    scenario = load_scenario(file)
    return scenario, plan_scenario(scenario, folder).tpg


@pytest.fixture(scope="module")
def alone(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Scenario, TemporalPlanGraph]:
    """One robot, so that its makespan is the sum of all that it does."""
    return planned_from(tmp_path_factory.mktemp("alone"), scenario_text())


def stands(tpg: TemporalPlanGraph) -> Iterator[tuple[int, int, str]]:
    for k, acts in enumerate(actuation_nodes(tpg)):
        yield from ((k, node, item.act) for node, item in acts.items())


def makespan(
    scenario: Scenario, tpg: TemporalPlanGraph, close: float, opening: float
) -> float:
    """Return the makespan of the same plan with other times of the tool."""
    assembly = assembly_section(scenario, PartsSection)
    rules = assembly.grips.changed(close_s=close, open_s=opening)
    other = scenario.changed(assembly=assembly.changed(grips=rules))
    return Simulator(tpg, scenario_execution(other, Path())).run(seed=1).makespan_s


def test_a_pick_is_motion_then_a_stand_then_motion(planned: PlanResult) -> None:
    tpg = planned.tpg
    handled = {(h.robot, h.node): h for h in tpg.handlings}
    found = list(stands(tpg))
    assert sorted(act for *_, act in found) == [
        Actuation.CLOSE,
        Actuation.CLOSE,
        Actuation.OPEN,
        Actuation.OPEN,
    ]
    for k, node, act in found:
        chain = tpg.chains[k]
        at = int(chain.first[node])
        assert np.array_equal(chain.waypoints[at], chain.waypoints[at - 1])
        # Both neighbours are motions of the same skill.
        assert set(chain.task[node - 1 : node + 2]) == {chain.task[node]}
        change = handled[k, node]
        assert change.waypoint == 1
        assert (change.holder == chain.robot) == (act == Actuation.CLOSE)
        nominal = 0.45 if act == Actuation.CLOSE else 0.25
        assert chain.duration[node] == pytest.approx(nominal)


def test_the_other_proof_holds_and_the_audit_is_clean(
    planned: PlanResult, trial: RunResult
) -> None:
    assert verify_plan(planned.tpg).problems == ()
    assert trial.passed
    told = trial.summary["actuations"]
    assert (told["close"]["times"], told["open"]["times"]) == (2, 2)
    assert told["open"]["s"] == pytest.approx(0.5)


def test_gripping_is_an_activity_and_a_skill_is_measured_whole(
    planned: PlanResult, trial: RunResult
) -> None:
    lanes = robot_activities(planned.tpg, trial.history)
    states = [item.state for lane in lanes.values() for item in lane]
    assert states.count(Actuation.CLOSE) == states.count(Actuation.OPEN) == 2
    whole = [skill.skill for skill in logged_skills(trial.files)]
    assert sorted(whole) == ["pick", "pick", "place-down", "place-down"]


@pytest.mark.parametrize("policy", ["asynchronous", "sequential"])
def test_engines_agree(scenario: Scenario, planned: PlanResult, policy: Policy) -> None:
    model = scenario_execution(scenario, Path())
    model = replace(model, policy=policy)
    assert_same_ends(planned.tpg, model, 4, [0, 1, 77])
    assert_same_ends(timing_graph(planned.tpg), model, 4, [0, 1, 77])


def test_the_makespan_of_one_robot_grows_by_what_its_tool_takes(
    alone: tuple[Scenario, TemporalPlanGraph],
) -> None:
    scenario, tpg = alone
    acts = [act for *_, act in stands(tpg)]
    assert acts.count(Actuation.CLOSE) == acts.count(Actuation.OPEN) == 2
    without = makespan(scenario, tpg, 0.0, 0.0)

    @settings(max_examples=25, deadline=None)
    @given(st.floats(0.0, 5.0), st.floats(0.0, 5.0))
    def grows(close: float, opening: float) -> None:
        whole = makespan(scenario, tpg, close, opening)
        assert whole - without == pytest.approx(2 * close + 2 * opening, abs=1e-8)

    grows()


def test_each_grip_of_four_tenths_is_longer_than_one_of_a_millisecond(
    alone: tuple[Scenario, TemporalPlanGraph], tmp_path: Path
) -> None:
    scenario, tpg = alone
    quick, slow = (makespan(scenario, tpg, close, 0.4) for close in (0.001, 0.4))
    assert slow - quick == pytest.approx(2 * 0.399, abs=1e-8)
    # The same where it is planned so, and by default.
    planned = [
        planned_from(tmp_path, scenario_text(f"close_s: {close}"))
        for close in (0.001, 0.4)
    ]
    ends = [
        Simulator(other, scenario_execution(cell_, Path())).run(seed=1).makespan_s
        for cell_, other in planned
    ]
    assert ends == pytest.approx([quick, slow], abs=1e-8)
    default = Simulator(tpg, scenario_execution(scenario, Path())).run(seed=1)
    assert default.makespan_s == pytest.approx(slow, abs=1e-8)


def test_a_time_of_a_whole_skill_counts_and_its_motions_share_it(
    alone: tuple[Scenario, TemporalPlanGraph], tmp_path: Path
) -> None:
    said = (
        "execution:\n  skills: {pick: {kind: fixed, value_s: 6},"
        " place-down: {kind: fixed, value_s: 7}}\n"
    )
    scenario, tpg = planned_from(tmp_path, scenario_text("close_s: 3", said))
    for k, node, _ in stands(tpg):
        assert tpg.chains[k].duration[node] == 0.0
    for tasks, seconds in (("pick", 6.0), ("place-down", 7.0)):
        for task in (task for task in tpg.tasks if task.kind == tasks):
            own = tpg.chains[0].task == task.index
            assert tpg.chains[0].duration[own].sum() == pytest.approx(seconds)
    run = Simulator(tpg, scenario_execution(scenario, Path())).run(seed=1)
    # Whatever was planned: the scenario that is executed says which of the two counts.
    _, other = alone
    again = Simulator(other, scenario_execution(scenario, Path())).run(seed=1)
    assert again.makespan_s == pytest.approx(run.makespan_s, abs=1e-8)
    messages = [item.message for item in checked(tmp_path / "own.yaml").findings]
    assert any("counts in no pick" in message for message in messages)


def test_whole_times_that_leave_no_time_to_move_are_warned_of(tmp_path: Path) -> None:
    said = "execution: {skills: {pick: {kind: fixed, value_s: 0.4}}}\n"
    file = written(tmp_path, scenario_text("", said))
    messages = [item.message for item in checked(file).findings]
    assert any("which alone is 0.4 s" in message for message in messages)


def test_plan_files_keep_what_tools_do(planned: PlanResult, tmp_path: Path) -> None:
    save_plan(planned.tpg, tmp_path)
    assert [t.actuations for t in load_plan(tmp_path).tasks] == [
        t.actuations for t in planned.tpg.tasks
    ]


def test_fingers_close_on_the_rod_in_the_recording(
    scenario: Scenario, planned: PlanResult, tmp_path: Path
) -> None:
    tpg, path = planned.tpg, tmp_path / "run.rrd"
    run, _ = recorded_run(path, tpg, skill_durations(scenario))
    placements = object_placements(tpg, run)
    for k, robot in enumerate(tpg.cell.robots):
        moves = sorted(finger_motions(tpg, run, placements, robot))
        nodes = [(node, act) for chain, node, act in stands(tpg) if chain == k]
        starts = [int(run.start_ns[k][node]) for node, _ in nodes]
        ends = [int(run.end_ns[k][node]) for node, _ in nodes]
        assert [move[0] for move in moves] == starts
        assert [move[1] for move in moves] == ends
        # Rods are 24 mm across, and fingers are held 39.8 mm apart, as they are drawn.
        assert [move[3] for move in moves] == pytest.approx(
            [0.0079] * len(moves), abs=3e-4
        )
        entity = entity_path(robot_part(robot.name), "joints", "panda_finger_joint1")
        shown = {
            t: float(cell[0][1])
            for t, cell in rows(path, entity, "Transform3D:translation")
        }
        for (_, act), start, end in zip(nodes, starts, ends, strict=True):
            wide = (0.02, 0.0121) if act == Actuation.CLOSE else (0.0121, 0.02)
            assert (shown[start], shown[end]) == pytest.approx(wide, abs=3e-4)


def test_disturbed_runs_are_clean(
    scenario: Scenario, planned: PlanResult, tmp_path: Path
) -> None:
    disturbed = scenario.changed(
        execution=scenario.execution.changed(
            stalls=scenario.execution.stalls.changed(count_per_robot=4), latency_s=0.03
        )
    )
    for seed in range(3):
        trial = executed(
            disturbed.changed(seed=seed), planned.tpg, tmp_path / str(seed)
        )
        assert trial.passed
