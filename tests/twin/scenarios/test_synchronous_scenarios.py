"""Scenarios planned in slots, from their files to clean runs under either policy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planning.tasks.task import TaskKind
from scheduling.graph.plan_files import load_plan, save_plan
from scheduling.graph.rollout import earliest_times
from scheduling.verification.verify import verify_plan
from tests.shipped_runs import ShippedRuns
from twin.durations.nanoseconds import NANOSECONDS
from twin.host.progress import StageWatch
from twin.planning.pipeline import plan_synchronously
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.scenario import Scenario, resolve_scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.run_plan import run_plan_to_folder

FOLDER = Path(__file__).parents[3] / "scenarios" / "multi_arm"
NAMES = ("rearrangement", "multi_goal")


@pytest.fixture(scope="module", params=NAMES)
def planned(request: pytest.FixtureRequest) -> tuple[Scenario, PlanResult]:
    scenario = load_scenario(FOLDER / f"{request.param}.yaml")
    planning = scenario.planning.model_copy(update={"shortcut_candidates": 0})
    scenario = scenario.model_copy(update={"planning": planning})
    return scenario, plan_scenario(scenario, FOLDER)


def test_robots_do_move_at_once(planned: tuple[Scenario, PlanResult]) -> None:
    scenario, plan = planned
    robots = len(scenario.cell.robots)
    counts = np.bincount(plan.tpg.slots)
    assert counts.max() == robots
    assert plan.turns is not None
    alone = sum(float(np.sum(chain.duration)) for chain in plan.turns.chains)
    slots = plan_synchronously(plan.motions, StageWatch()).motion_plan
    together = max(float(motion.time[-1]) for motion in slots.motions)
    assert 40.0 < together < 100.0
    assert together < 0.5 * alone


@pytest.mark.nightly
@pytest.mark.parametrize("policy", ["asynchronous", "synchronous"])
def test_stalled_runs_are_clean(
    planned: tuple[Scenario, PlanResult], policy: str, tmp_path: Path
) -> None:
    scenario, plan = planned
    content = resolve_scenario(scenario)
    content["execution"]["policy"] = policy
    content["execution"]["stalls"]["count_per_robot"] = 2
    changed = type(scenario).model_validate(content, strict=False)
    changed_plan = replace(plan, scenario=LoadedScenario(changed))
    trial = run_plan_to_folder(changed_plan, tmp_path, recording=False)
    assert trial.passed
    assert trial.summary["makespan_s"] < trial.summary["makespan_sequential_s"]
    if policy == "synchronous":
        assert trial.record is not None
        order = np.argsort(plan.tpg.slots, kind="stable")
        tasks = [plan.tpg.tasks[k].index for k in order]
        slot = dict(zip(tasks, plan.tpg.slots[order].tolist(), strict=True))
        last = 0
        for number in range(int(plan.tpg.slots.max()) + 1):
            starts, ends = [], []
            for k, chain in enumerate(plan.tpg.chains):
                own = np.array([slot[t] for t in chain.task.tolist()]) == number
                starts += trial.record.start_ns[k][own].tolist()
                ends += trial.record.end_ns[k][own].tolist()
            assert not starts or min(starts) >= last
            last = max([last, *ends])
        assert last == round(trial.summary["makespan_s"] * NANOSECONDS)


def test_the_proof_apart_agrees(planned: tuple[Scenario, PlanResult]) -> None:
    if len(planned[1].tpg.cell.robots) > 3:
        pytest.skip("takes too long for the tests")
    assert verify_plan(planned[1].tpg).ok


def test_slots_are_saved_with_the_plan(
    planned: tuple[Scenario, PlanResult], tmp_path: Path
) -> None:
    save_plan(planned[1].tpg, tmp_path)
    assert np.array_equal(load_plan(tmp_path).slots, planned[1].tpg.slots)


LEGO = FOLDER.parent / "lego"


@pytest.fixture(scope="module")
def jointly() -> tuple[Scenario, PlanResult]:
    """Return the cliff with all transits of a slot planned as one robot."""
    scenario = load_scenario(LEGO / "cliff.yaml")
    update = {
        "coordination": "synchronous",
        "joint_planning": "always",
        "shortcut_candidates": 0,
    }
    planning = scenario.planning.model_copy(update=update)
    scenario = scenario.model_copy(update={"planning": planning})
    return scenario, plan_scenario(scenario, LEGO)


@pytest.mark.nightly
def test_joint_paths_pass_the_proof_apart(jointly: tuple[Scenario, PlanResult]) -> None:
    assert verify_plan(jointly[1].tpg).problems == ()


def test_joint_paths_pass_the_audit_slot_by_slot(
    jointly: tuple[Scenario, PlanResult], tmp_path: Path
) -> None:
    scenario, plan = jointly
    execution = scenario.execution.model_copy(update={"policy": "synchronous"})
    changed = scenario.model_copy(update={"execution": execution})
    changed_plan = replace(plan, scenario=LoadedScenario(changed))
    assert run_plan_to_folder(changed_plan, tmp_path, recording=False).passed


def test_slots_of_a_shipped_plan_are_planned_jointly(
    jointly: tuple[Scenario, PlanResult],
) -> None:
    plan = jointly[1]
    slots = plan_synchronously(plan.motions, StageWatch(), always_jointly=True)
    number = dict(
        zip(
            (task.index for task in plan.tpg.tasks),
            slots.slot_of_task.tolist(),
            strict=True,
        )
    )
    joint = {number[group[0]]: set(group) for group in slots.jointly_planned}
    seen = 0
    for k in range(int(slots.slot_of_task.max()) + 1):
        moving = {
            task.index: task.kind == TaskKind.TRANSIT
            for task, motion in zip(
                plan.tpg.tasks, slots.motion_plan.motions, strict=True
            )
            if number[task.index] == k and np.any(np.diff(motion.path, axis=0))
        }
        free = {index for index, transit in moving.items() if transit}
        if len(moving) > 1 and free:
            assert joint.pop(k) == free
            seen += 1
    assert not joint
    assert seen > 10


@pytest.mark.nightly
def test_one_task_after_another_ends_as_soon_as_slots_with_sidesteps() -> None:
    """With this seed, the last arm waits for the busiest one on a way that is straight already."""
    scenario = load_scenario(FOLDER / "multi_goal.yaml")

    def ends(**keys: object) -> tuple[float, float]:
        update = {"coordination": "sequential", **keys}
        planning = scenario.planning.model_copy(update=update)
        changed = scenario.model_copy(update={"planning": planning, "seed": 2})
        tpg = plan_scenario(changed, FOLDER).tpg
        alone = max(float(np.sum(chain.duration)) for chain in tpg.chains)
        return float(earliest_times(tpg).makespan), alone

    without, alone = ends(sidestep_candidates=0)
    assert without > 1.05 * alone
    sooner, alone = ends()
    assert sooner == pytest.approx(alone, rel=1e-3)


@pytest.mark.nightly
def test_a_structure_with_sidesteps_is_built_sooner_and_proved_apart(
    shipped: ShippedRuns, tmp_path: Path
) -> None:
    before = shipped("lego/cliff")
    scenario = before.scenario
    planning = scenario.planning.model_copy(update={"sidestep_candidates": 100})
    changed = scenario.model_copy(update={"planning": planning})
    plan = plan_scenario(changed, LEGO)
    sooner = (
        earliest_times(plan.tpg).makespan / earliest_times(before.planned.tpg).makespan
    )
    assert sooner < 0.9999
    assert verify_plan(plan.tpg).problems == ()
    assert run_plan_to_folder(plan, tmp_path, recording=False).passed
