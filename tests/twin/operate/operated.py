"""A small structure with bricks to spare, planned so that what fails can be planned anew."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from tests.twin.planning.facing_arms import FACING_ARMS
from twin.trial.loaded_scenario import LoadedScenario, load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_to_operate

CLIFF = Path(__file__).parents[3] / "scenarios" / "lego" / "cliff.yaml"

STACK = (
    FACING_ARMS
    + """\
  stock:
    - {name: left_a, brick: 2x4, at: [2, 30, 1]}
    - {name: left_b, brick: 2x4, at: [6, 30, 1]}
    - {name: left_c, brick: 2x4, at: [2, 36, 1]}
    - {name: left_d, brick: 2x4, at: [6, 36, 1]}
    - {name: left_e, brick: 2x4, at: [2, 42, 1]}
    - {name: right_a, brick: 2x4, at: [44, 30, 1]}
    - {name: right_b, brick: 2x4, at: [40, 30, 1]}
    - {name: right_c, brick: 2x4, at: [44, 36, 1]}
    - {name: right_d, brick: 2x4, at: [40, 36, 1]}
    - {name: right_e, brick: 2x4, at: [44, 42, 1]}
  steps:
    - {brick: 2x4, at: [23, 15, 1]}
    - {brick: 2x4, at: [23, 15, 2]}
    - {brick: 2x4, at: [23, 15, 3]}
    - {brick: 2x4, at: [23, 15, 4]}
planning: {shortcut_candidates: 300}
"""
)


@cache
def stack(folder: Path) -> PlanResult:
    """Return the plan of the stack, whose file is written into a folder."""
    file = folder / "stack.yaml"
    file.write_text(STACK)
    return plan_to_operate(load(file))


def failing(plan: PlanResult, **values: object) -> LoadedScenario:
    """Return the scenario of a plan in which picks and places fail now and then."""
    return plan.scenario.varied(dict(values))
