"""The shipped gearbox: tools of their own, a mesh, pins, and a cover that is held while it is screwed on."""

from __future__ import annotations

from pathlib import Path

import pytest

from planning.tasks.task import HOLD, LEAVE_TOOL, TAKE_TOOL
from scheduling.verification.verify import verify_plan
from tests.twin.scenarios.executed import executed
from twin.scenario.sections.scenario import Scenario, resolved, restored
from twin.trial.plan_result import PlanResult

pytestmark = pytest.mark.expensive

FILE = Path(__file__).parents[3] / "scenarios" / "assembly" / "gearbox.yaml"


@pytest.fixture(scope="module")
def file() -> Path:
    return FILE


def test_it_is_built_and_found_clean(
    scenario: Scenario, planned: PlanResult, tmp_path: Path
) -> None:
    executed(scenario, planned.tpg, tmp_path, base=FILE.parent, recording=True)
    assert verify_plan(planned.tpg).ok


def test_the_driver_screws_while_the_gripper_holds(planned: PlanResult) -> None:
    tasks = planned.tpg.tasks
    assert {t.robot for t in tasks if t.kind == "screw"} == {"right"}
    assert {t.robot for t in tasks if t.kind == HOLD} == {"left"}
    assert {t.robot for t in tasks if t.kind == "pick"} == {"left", "right"}
    assert sum(t.kind == "screw" for t in tasks) == 4
    assert sum(t.kind == HOLD for t in tasks) == 2


def test_the_tool_is_changed_once_after_the_last_part_of_its_arm(
    planned: PlanResult,
) -> None:
    own = [t for t in planned.tpg.tasks if t.robot == "right"]
    kinds = [t.kind for t in own]
    assert [t.object for t in own if t.kind in (LEAVE_TOOL, TAKE_TOOL)] == [
        "right_gripper",
        "driver",
    ]
    last = max(k for k, kind in enumerate(kinds) if kind == "place-down")
    assert (
        last < kinds.index(LEAVE_TOOL) < kinds.index(TAKE_TOOL) < kinds.index("screw")
    )


def test_a_run_remembers_its_scenario(scenario: Scenario) -> None:
    """Shapes with all their defaults filled in are read as they were written."""
    assert restored(resolved(scenario)) == scenario


def test_pins_are_put_in_before_the_gears_on_them(planned: PlanResult) -> None:
    order = [t.object for t in planned.tpg.tasks if t.kind == "place-down"]
    for side in "ab":
        assert order.index(f"pin_{side}") < order.index(f"gear_{side}")
