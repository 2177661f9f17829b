"""The task board: an order that is found, a driver that works, grippers that place and hold."""

from __future__ import annotations

from pathlib import Path

import pytest

from planning.tasks.task import HOLD
from scheduling.verification.verify import verify_plan
from tests.twin.scenarios.executed import executed
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult

FILE = Path(__file__).parents[3] / "scenarios" / "assembly" / "taskboard.yaml"


@pytest.fixture(scope="module")
def file() -> Path:
    return FILE


def test_who_does_what_is_by_the_tools(planned: PlanResult) -> None:
    tasks = planned.tpg.tasks
    by_driver = {task.kind for task in tasks if task.robot == "back"}
    assert {"screw", "tighten", "inspect"} < by_driver
    assert not {"pick", "place-down", HOLD} & by_driver
    assert all(
        task.robot == "back"
        for task in tasks
        if task.kind in {"screw", "tighten", "inspect"}
    )
    assert [task.label for task in tasks if task.kind == HOLD] == ["hold cover"] * 2


def test_every_text_of_a_lane_tells_of_one_kind_of_task(planned: PlanResult) -> None:
    """A lane has the colour of its text: an approach must not be called as its process is."""
    kinds: dict[str, set[str]] = {}
    for task in planned.tpg.tasks:
        kinds.setdefault(task.label, set()).add(task.kind)
    assert all(len(found) == 1 for found in kinds.values())


def test_the_order_is_one_in_which_it_can_be_built(planned: PlanResult) -> None:
    step = {task.label: task.step for task in planned.tpg.tasks if task.object}
    step |= {
        task.label: task.step for task in planned.tpg.tasks if task.kind == "inspect"
    }
    assert step["place cover"] < step["screw cover/west"] < step["screw cover/east"]
    assert step["place nut"] < step["tighten nut/top"]
    assert step["inspect board/middle"] == max(step.values()) == 10


def test_it_is_safe_by_the_other_proof_and_its_run_is_clean(
    scenario: Scenario, planned: PlanResult, tmp_path: Path
) -> None:
    assert verify_plan(planned.tpg).problems == ()
    trial = executed(scenario, planned.tpg, tmp_path, base=FILE.parent)
    assert trial.summary["audit"]["violations"] == []
