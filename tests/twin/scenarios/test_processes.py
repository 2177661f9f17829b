"""Two arms place a cover, screw it on while it is held, and seal an edge: from the file to a run."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from planning.errors import ScenarioError
from planning.tasks.task import TaskKind
from planning.transforms import from_rpy, translation
from scheduling.graph.rollout import earliest_times
from scheduling.verification.verify import verify_plan
from tests.twin.program import invoke
from tests.twin.scenarios.cells import cell, panda
from tests.twin.scenarios.executed import executed
from tests.twin.written import loaded
from twin.audits.audit import audit_run
from twin.audits.expectations import (
    Expectations,
    ExpectedProcess,
    scenario_expectations,
)
from twin.checks.finding import CheckContext
from twin.checks.reach import check_reach
from twin.kinds.parts.checks.places import check_goals
from twin.scenario.sections.scenario import Scenario, resolve_scenario, restore_scenario
from twin.scenario.variations import apply_variation
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.run_result import RunResult

DRIVER = ", frames: {driver: {xyz_m: [0, 0, 0.114]}}"
SCENARIO = cell(
    "cover",
    (panda("left", -0.55, DRIVER), panda("right", 0.55, DRIVER)),
    """\
  kind: assembly
  grips: {positions: 3, depth_m: 0.012}
  parts:
    - name: cover
      size_m: [0.16, 0.036, 0.02]
      start: {xyz_m: [-0.3, 0.3, 0.01]}
      goal: {xyz_m: [0, 0, 0.05]}
      frames:
        hole1: {xyz_m: [-0.05, 0, 0.01]}
        hole2: {xyz_m: [0.05, 0, 0.01]}
    - name: pin
      size_m: [0.03, 0.03, 0.06]
      start: {xyz_m: [0.3, 0.3, 0.03]}
      goal: {xyz_m: [0.06, 0.04, 0.07]}
  processes:
    screw: {duration: {kind: lognormal, median_s: 3, p95_s: 4}, frame: driver}
    seal:
      duration: {kind: fixed, value_s: 4}
      frame: driver
      path: [{xyz_m: [-0.04, 0, 0]}, {xyz_m: [0.04, 0, 0]}]
  steps:
    - cover
    - {process: screw, at: {part: cover, frame: hole1}, hold: cover, after: [cover], name: first}
    - {process: screw, at: {part: cover, frame: hole2}, hold: cover, robots: [right], after: [first]}
    - {process: seal, at: {fixture: table, frame: corner}}
    - {place: pin, hold: cover, after: [first]}
planning: {speed_model: joint}
execution:
  skills:
    pick: {kind: fixed, value_s: 1.5}
    place-down: {kind: lognormal, median_s: 1.5, p95_s: 2.0}
  stalls: {rate_per_h: 120, duration_s: [1, 3]}
""",
    "{name: table, size_m: [1.6, 1.2, 0.04], pose: {xyz_m: [0, 0, -0.02]},"
    " frames: {corner: {xyz_m: [0.1, 0.3, 0.02]}}}",
    "{name: jig, size_m: [0.18, 0.12, 0.04], pose: {xyz_m: [0, 0, 0.02]}}",
)


def test_the_plan_is_safe_and_a_run_with_stalls_does_what_the_scenario_says(
    planned: PlanResult, trial: RunResult
) -> None:
    """The audit takes its places from the scenario and measures with an engine of its own."""
    assert verify_plan(planned.tpg).problems == ()
    assert trial.passed
    kinds = [task.kind for task in planned.tpg.tasks]
    assert kinds.count("screw") == 2
    assert kinds.count("seal") == 1
    assert kinds.count(TaskKind.HOLD) == 3


def test_pins_and_precedence_are_kept(planned: PlanResult) -> None:
    tasks = {(task.kind, task.step): task for task in planned.tpg.tasks}
    assert tasks["screw", 3].robot == "right"
    assert tasks[TaskKind.HOLD, 3].robot == "left"
    assert tasks[TaskKind.HOLD, 2].robot != tasks["screw", 2].robot
    times = earliest_times(planned.tpg)
    begin, end = {}, {}
    for k, chain in enumerate(planned.tpg.chains):
        for index in set(chain.task.tolist()):
            nodes = (chain.task == index).nonzero()[0]
            begin[index] = times.start[k][nodes[0]]
            end[index] = times.end[k][nodes[-1]]
    for earlier, later in (
        (("place-down", 1), ("screw", 2)),
        (("screw", 2), ("screw", 3)),
        (("screw", 2), ("place-down", 5)),
        ((TaskKind.HOLD, 2), ("screw", 2)),
        ((TaskKind.HOLD, 5), ("place-down", 5)),
    ):
        assert end[tasks[earlier].index] <= begin[tasks[later].index] + 1e-9


def test_processes_take_their_own_time_in_studies_and_plans(
    scenario: Scenario, planned: PlanResult
) -> None:
    models = scenario.execution.skill_models()
    assert models["seal"].mean == pytest.approx(4.0)
    (seal,) = (task for task in planned.tpg.tasks if task.kind == "seal")
    chain = planned.tpg.chains[planned.tpg.chain_index[seal.robot]]
    assert chain.duration[chain.task == seal.index].sum() == pytest.approx(4.0)
    assert len(seal.path) > 5  # the tool moves along its path meanwhile


def moved(process: ExpectedProcess) -> ExpectedProcess:
    return replace(process, pose=translation(0.0, 0.003, 0.0) @ process.pose)


def leaning(process: ExpectedProcess) -> ExpectedProcess:
    lean = from_rpy((0.0, 0.0, 0.0), (0.05, 0.0, 0.0))
    return replace(process, pose=process.pose @ lean)


Change = Callable[[ExpectedProcess], ExpectedProcess]


@pytest.mark.parametrize(
    ("step", "change", "kind", "says"),
    [
        (0, moved, "process", "no nearer than 3.00 mm"),
        (0, leaning, "process", "leans by 2.9 deg"),
        (2, moved, "process", "no nearer than"),
        (1, lambda p: replace(p, robots=("left",)), "process", "was done by right"),
        (2, lambda p: replace(p, hold="cover"), "support", "is not held"),
        (0, lambda p: replace(p, after=("pin",)), "process", "before pin"),
        (2, lambda p: replace(p, process="glue"), "process", "was not done"),
    ],
)
def test_the_audit_finds_what_was_not_done_as_wanted(
    scenario: Scenario,
    trial: RunResult,
    step: int,
    change: Change,
    kind: str,
    says: str,
) -> None:
    """The run is as it was; the scenario is said to have wanted something else."""
    wanted = scenario_expectations(scenario)
    processes = list(wanted.processes)
    processes[step] = change(processes[step])
    other: Expectations = replace(wanted, processes=tuple(processes))
    report = audit_run(trial.files, wanted=other)
    assert [v.kind for v in report.violations] == [kind]
    assert says in report.violations[0].detail


@pytest.mark.nightly
def test_an_order_is_found_for_steps_in_any_order(tmp_path: Path) -> None:
    content = yaml.safe_load(SCENARIO)
    content["assembly"]["order"] = "find"
    content["assembly"]["steps"].reverse()
    scenario = loaded(tmp_path, yaml.safe_dump(content))
    assert list(check_goals(CheckContext(scenario, tmp_path))) == []
    tpg = plan_scenario(scenario).tpg
    executed(scenario, tpg, tmp_path / "run")


def test_places_of_work_out_of_reach_are_found_before_planning(
    scenario: Scenario, tmp_path: Path
) -> None:
    assert list(check_reach(CheckContext(scenario, tmp_path))) == []
    far = "{xyz_m: [0.1, 0.3, 0.02]}", "{xyz_m: [0.1, 1.5, 0.02]}"
    (found,) = check_reach(CheckContext(loaded(tmp_path, SCENARIO, far), tmp_path))
    assert found.error
    assert found.at == ("assembly", "steps", 3)
    assert "no robot reaches table/corner" in found.message


def test_durations_can_be_given_and_varied_in_either_place(
    scenario: Scenario, tmp_path: Path
) -> None:
    own = "  skills:\n", "  skills:\n    seal: {kind: fixed, value_s: 9}\n"
    given = loaded(tmp_path, SCENARIO, own)
    assert given.execution.skill_models()["seal"].mean == 9.0
    for key in ("skills.seal.value_s", "assembly.processes.seal.duration.value_s"):
        other = apply_variation(scenario, {key: 7.0})
        assert other.execution.skill_models()["seal"].mean == 7.0
    assert apply_variation(scenario, {"seed": 3}).execution == scenario.execution
    with pytest.raises(ScenarioError, match="no skill 'seel'"):
        apply_variation(scenario, {"skills.seel.value_s": 7.0})


def test_what_is_written_down_reads_as_the_same_scenario(scenario: Scenario) -> None:
    assert restore_scenario(resolve_scenario(scenario)) == scenario


def test_validate_counts_the_steps(file: Path) -> None:
    result = invoke("validate", file, code=0)
    assert "ok (2 robots, 5 steps, 2 parts)" in result.output
